"""Scenes: a description of shapes, lights and materials, rendered."""

from __future__ import annotations

from fitter.scene.plan import Plan, plan
from fitter.scene.render import Picture, render
from fitter.scene.scene import Scene, load_scene, scene
from fitter.scene.spec import SceneSpec, scene_spec

__all__ = ["Picture", "Plan", "Scene", "SceneSpec", "load_scene", "plan", "render", "scene", "scene_spec"]
