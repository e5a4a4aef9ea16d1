"""Fields: one slice of a table on a chart of the hemisphere, with a proved upper bound on any cell.

A chart maps a rectangle of coordinates (a, b) onto the hemisphere; a cell is a rectangle a0 <= a <= a1, b0 <=
b <= b1 of it. A field is f+ cos(theta_o) per unit of the chart's own measure: f+ is the interpolant of the
values clamped at 0, its channels weighted. The bounds are theorems, see each ``bound``.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fitter.sampling.alias import AliasTable
from fitter.sampling.drawing import Kernel

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: Cells at a time where kernels work on cells, and from how many on in threads.
AT_ONCE, MANY = 1 << 10, 1 << 12
# Covers the rounding of the interpolation (a few sums of products) on top of the bound itself.
ROUNDING = 1e-9


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

    def integrals(
        self, cells: FloatArray, x: FloatArray, share: FloatArray, *, clamped: bool = True
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """(K,) integral of the field over cells (K, 4) by points ``x`` (n,) in [-1, 1] along both sides and
        their weights, and at how many of the points it was measured."""
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

    def kernel(self, alias: AliasTable, cells: FloatArray, majorant: FloatArray, integral: float) -> Kernel:
        """Draws from cells (K, 4), chosen by ``alias``, a candidate accepted by field / majorant (K,)."""
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
        """What :meth:`channels` needs to know of points."""
        ...

    def channels(self, place: tuple[NDArray[Any], ...]) -> FloatArray:
        """(M, C) f+ of every channel in 1/sr; NaN outside the measured domain."""
        ...

    def coordinates(self, wo: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of directions (M, 3) in the sample's frame."""
        ...
