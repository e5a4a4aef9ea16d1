"""Fields: one slice of a table on a chart of the hemisphere, with a proved upper bound on any cell.

A chart maps a rectangle of coordinates (a, b) onto the hemisphere; a cell is a rectangle a0 <= a <= a1, b0 <=
b <= b1 of it. A field is f+ cos(theta_o) per unit of the chart's own measure: f+ is the interpolant of the
values clamped at 0, its channels weighted. The bounds are theorems, see each ``bound``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# Covers the rounding of the interpolation (a few sums of products) on top of the bound itself.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Point:
    """Points (M,) of a chart. field : NaN outside the measured domain. wo : components in the sample's frame.

    density : weighted f+ in 1/sr. place : where they lie, for :meth:`Field.channels`.
    """

    field: FloatArray
    wo: tuple[FloatArray, FloatArray, FloatArray]
    density: FloatArray
    place: tuple[NDArray[Any], ...]


class Field(Protocol):
    """One slice of a table on a chart."""

    extrapolated: bool
    clamps: bool

    def edges(self) -> tuple[FloatArray, FloatArray]:
        """Edges in both coordinates of the cells to begin with."""
        ...

    def bound(self, cells: FloatArray) -> FloatArray:
        """(K,) upper bounds of the field on cells (K, 4) = a0, a1, b0, b1; 0 where unmeasured."""
        ...

    def measures(self, cells: FloatArray) -> FloatArray:
        """(K,) the chart's measure of each cell."""
        ...

    def measure(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """The chart's measure per da db."""
        ...

    def tall(self, cells: FloatArray) -> BoolArray:
        """(K,) whether a cell is better cut across its first coordinate than across the second."""
        ...

    def columns(self, cells: FloatArray) -> tuple[FloatArray, ...]:
        """What :meth:`draw` needs to know of each cell, each (K,)."""
        ...

    def draw(self, columns: tuple[FloatArray, ...], u: FloatArray, v: FloatArray) -> Point:
        """Points in cells, uniform by the chart's measure for uniform numbers u and v."""
        ...

    def field(self, a: FloatArray, b: FloatArray, *, clamped: bool = True) -> FloatArray:
        """(M,) the field, NaN outside the measured domain."""
        ...

    def gain(self, a: FloatArray, b: FloatArray, weight: FloatArray) -> float:
        """What interpolation adds to the integral that these points and weights (M,) make up, estimated."""
        ...

    def solid_angle(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """(M,) solid angle per unit of the chart's measure."""
        ...

    def directions(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """(M, 3) in the sample's frame."""
        ...

    def place(self, a: FloatArray, b: FloatArray) -> tuple[NDArray[Any], ...]:
        """What :meth:`channels` needs to know of points, as :class:`Point` has it."""
        ...

    def channels(self, place: tuple[NDArray[Any], ...]) -> FloatArray:
        """(M, C) f+ of every channel in 1/sr; NaN outside the measured domain."""
        ...

    def coordinates(self, wo: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of directions (M, 3) in the sample's frame."""
        ...
