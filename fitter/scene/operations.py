"""Operations of compiled programs: deterministic, unlike a clock.

A picture is rendered by kernels without loops (but that over a mesh's triangles), called a number of times
that the plan decides. Counted are XLA's floating-point operations plus transcendentals of each kernel, for a
ray, times its calls; raw tables are evaluated outside, and not counted.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from fitter.scene import kernels
from fitter.scene.assembly import Scene
from fitter.scene.integrate import Integrator, Points
from fitter.scene.kernels import Hit, Shapes
from fitter.scene.materials import ModelMaterial
from fitter.scene.regions import Region
from fitter.scene.settings import Settings

#: Rays that are followed to see which kernels are called.
_RAYS = 1024
_BLOCK = 64


def of_picture(scene: Scene, settings: Settings, region: Region) -> float:
    """Operations a sample of a pixel of a region, all calls of all kernels."""
    counting = _Counting(scene, settings, np.dtype(np.float32))
    pixel = np.linspace(0, len(region.pixels) - 1, _RAYS).astype(np.intp)
    counting.batch(region.pixels[pixel], (0,))
    return counting.operations / _RAYS


def of_material(one: ModelMaterial) -> float:
    """Operations of one evaluation of a material, for a pair of directions."""
    w = jnp.ones((_RAYS, 3), jnp.float32)
    kernel, given = one.value_call(w, w)
    return cost(kernel, *given) / _RAYS


def cost(kernel: Any, *given: Any) -> float:
    """Floating-point operations and transcendentals of a compiled kernel on arguments of these shapes."""
    leaves, tree = jax.tree.flatten(given)
    return _cost(kernel, tree, tuple(_like(leaf) for leaf in leaves))


def _like(leaf: Any) -> Any:
    """What decides about the program: an array's shape and type, any other argument itself."""
    return (leaf.shape, str(leaf.dtype)) if hasattr(leaf, "dtype") else leaf


@lru_cache(maxsize=4096)
def _cost(kernel: Any, tree: Any, leaves: tuple[Any, ...]) -> float:
    arrays = [jnp.zeros(*leaf) if isinstance(leaf, tuple) else leaf for leaf in leaves]
    lowered = kernel.lower(*jax.tree.unflatten(tree, arrays))
    found = getattr(lowered, "lowered", lowered).cost_analysis() or {}
    return float(found.get("flops", 0.0)) + float(found.get("transcendentals", 0.0))


class _Counting(Integrator):
    """Follows rays and adds up what their kernels cost."""

    def __init__(self, scene: Scene, settings: Settings, dtype: np.dtype[np.floating]) -> None:
        super().__init__(scene, settings, dtype)
        self.operations = 0.0

    def points(self, hit: Hit, d: Array) -> Points:
        """As of a batch that meets every material."""
        found = super().points(hit, d)
        return found._replace(present=list(range(len(self.settings.materials))))

    def call(self, kernel: Any, *given: Any) -> Any:
        self.operations += self._cost(kernel, given)
        return kernel(*given)

    def _cost(self, kernel: Any, given: tuple[Any, ...]) -> float:
        shapes = given[0]
        if kernel not in (kernels.nearest, kernels.hidden) or len(shapes.corner) <= _BLOCK:
            return cost(kernel, *given)
        # The body of a loop is counted once: one block of triangles with all else, the others alone.
        blocks = len(shapes.corner) // _BLOCK
        few = shapes._replace(**{name: getattr(shapes, name)[:_BLOCK] for name in _TRIANGLES})
        alone = few._replace(
            **{name: getattr(shapes, name)[:0] for name in Shapes._fields if name not in _TRIANGLES}
        )
        return cost(kernel, few, *given[1:]) + (blocks - 1) * cost(
            kernels.hidden, alone, *given[1:4], given[1][:, 0]
        )


_TRIANGLES = ("corner", "edge_1", "edge_2", "triangle_frame")
