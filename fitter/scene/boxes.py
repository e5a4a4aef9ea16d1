"""Boxes of surface points times points of lamps, and what is enclosed over them.

A box is a rectangle (a, b) of coordinates on one primitive (of its frame on rectangles and triangles; on
spheres a = cos of the angle from the centre's direction to the camera, b = azimuth about it), times, of area
lamps, a rectangle (s, t) in [-1, 1]^2, and of an environment all directions (s = cos theta, t = azimuth).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from fitter.scene.intervals import Interval

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
Vector = tuple[Interval, Interval, Interval]
T = TypeVar("T")


@dataclass(frozen=True)
class Boxes:
    """B boxes: of primitive and lamp (B,), low and high (B, 4) in a, b, s, t."""

    primitive: IntArray
    lamp: IntArray
    low: FloatArray
    high: FloatArray

    def __len__(self) -> int:
        return len(self.lamp)

    def take(self, index: NDArray[Any]) -> Boxes:
        return Boxes(self.primitive[index], self.lamp[index], self.low[index], self.high[index])

    def join(self, other: Boxes) -> Boxes:
        return Boxes(
            np.concatenate([self.primitive, other.primitive]), np.concatenate([self.lamp, other.lamp]),
            np.concatenate([self.low, other.low]), np.concatenate([self.high, other.high]),
        )  # fmt: skip

    def middle(self) -> Boxes:
        """The boxes' centres, as boxes of no size."""
        mid = 0.5 * (self.low + self.high)
        return replace(self, low=mid, high=mid)

    def side(self, k: int) -> Interval:
        return Interval(self.low[:, k], self.high[:, k])


@dataclass(frozen=True)
class Angles:
    """Enclosures of what a reflectance depends on, (B,) each: cosines of light and viewer with the normal,
    their dot product, their components along two tangents, ``axis`` (cos, sin) of where the sample's y axis
    lies between those, and the irradiance on a surface facing the light over the lamp's level. ``seen``:
    neither unlit, nor turned away, nor outside the picture for certain."""

    lz: Interval
    vz: Interval
    dot: Interval
    l: tuple[Interval, Interval]
    v: tuple[Interval, Interval]
    axis: tuple[Interval, Interval]
    arriving: Interval
    seen: NDArray[np.bool_]
    point: Vector
    kept: dict[Hashable, Any] = field(default_factory=dict[Hashable, Any], compare=False)

    def once(self, key: Hashable, make: Callable[[], T]) -> T:
        """What is made of these angles, kept: sets of effects have most of it in common."""
        if key not in self.kept:
            self.kept[key] = make()
        return cast(T, self.kept[key])

    def take(self, index: NDArray[Any]) -> Angles:
        return replace(self, **{name: taken(getattr(self, name), index) for name in _PARTS}, kept={})


_PARTS = tuple(one.name for one in fields(Angles) if one.name != "kept")


def taken(x: Any, index: NDArray[Any]) -> Any:
    """Some of an array, an interval, or a tuple of them."""
    if isinstance(x, tuple):
        return tuple(taken(one, index) for one in x)
    return Interval(x.lo[index], x.hi[index]) if isinstance(x, Interval) else x[index]
