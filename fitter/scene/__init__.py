"""Scenes: shapes, lights and materials, planned (which effects can be left out, proved) and rendered."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fitter.scene.assembly import Scene, load_scene, scene
    from fitter.scene.comparison import Comparison, compare
    from fitter.scene.planning import Plan, plan
    from fitter.scene.rendering import Picture, render
    from fitter.scene.spec import SceneSpec, scene_spec

__all__ = [
    "Comparison", "Picture", "Plan", "Scene", "SceneSpec", "compare", "load_scene", "plan", "render", "scene",
    "scene_spec",
]  # fmt: skip

# On first use: a specification needs no JAX.
_LAZY = {
    "Scene": "assembly", "load_scene": "assembly", "scene": "assembly", "Comparison": "comparison",
    "compare": "comparison", "Plan": "planning", "plan": "planning", "Picture": "rendering",
    "render": "rendering", "SceneSpec": "spec", "scene_spec": "spec",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module 'fitter.scene' has no attribute {name!r}")
    found = getattr(importlib.import_module(f"fitter.scene.{_LAZY[name]}"), name)
    globals()[name] = found
    return found
