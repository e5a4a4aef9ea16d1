"""Fields: one slice of a grid as a function of (theta_o, azimuth), with a proved upper bound on any cell.

A cell is a rectangle theta0 <= theta <= theta1, phi0 <= phi <= phi1. Azimuths are relative to the incident
one where the grid is isotropic. A field is f+, the interpolant of the values clamped at 0, its channels
weighted. The bounds are theorems, see each ``bound``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from fitter.sampling.axes import Axis, Place, corners

if TYPE_CHECKING:
    from fitter.sampling.grid import SphericalSlice

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# Covers the rounding of the interpolation (a few sums of products) on top of the bound itself.
ROUNDING = 1e-9


class Field(Protocol):
    """One slice of a grid. ``exact`` True where the quadrature of the cells is exact but for rounding."""

    rotation: float
    extrapolated: bool
    exact: bool
    clamps: bool

    def edges(self) -> tuple[FloatArray, FloatArray]:
        """Edges in theta and in azimuth of the cells to begin with."""
        ...

    def bound(self, cells: FloatArray) -> FloatArray:
        """(K,) upper bounds of the field on cells (K, 4) = theta0, theta1, phi0, phi1; 0 where unmeasured."""
        ...

    def density(self, theta: FloatArray, phi: FloatArray, *, clamped: bool = True) -> FloatArray:
        """(M,) weighted value, NaN outside the measured domain."""
        ...

    def values(self, theta: FloatArray, phi: FloatArray) -> FloatArray:
        """(M, C) f+ of every channel; NaN outside the measured domain."""
        ...


class SphericalField:
    """Bilinear in (theta_o, azimuth); its cells never straddle a node."""

    exact = True

    def __init__(self, part: SphericalSlice, weights: FloatArray) -> None:
        self.rotation, self.extrapolated = part.rotation, part.extrapolated
        self._theta, self._phi = part.outgoing
        self._shape = (len(self._theta.nodes), len(self._phi.nodes))
        hole = np.where(part.usable, 0.0, np.nan)
        self._channels = part.clamped + hole[:, None]
        self._weighted = part.clamped @ weights + hole
        self._raw = part.raw @ weights + hole
        self.clamps = bool(np.any(part.raw != part.clamped))

    def edges(self) -> tuple[FloatArray, FloatArray]:
        return self._theta.breakpoints(0.0, np.pi / 2), self._phi.breakpoints(-np.pi, np.pi)

    def _places(self, theta: FloatArray, phi: FloatArray) -> tuple[Place, Place]:
        start = self._phi.nodes[0]
        wrapped = start + np.mod(phi - start, self._phi.period or 2 * np.pi)
        return self._theta.locate(theta), self._phi.locate(wrapped)

    def bound(self, cells: FloatArray) -> FloatArray:
        """Largest of the four corner values.

        Within one cell of the grid the field is bilinear in (theta, azimuth), so on any rectangle inside it
        it is linear along each side: its maximum over the rectangle is at a corner. Cells begin at the grid's
        nodes and are only ever halved, so each lies inside one cell of the grid.
        """
        theta0, theta1, phi0, phi1 = cells.T
        places = self._places(0.5 * (theta0 + theta1), 0.5 * (phi0 + phi1))
        ends = [
            _fractions_at_ends(axis, place, 0.5 * length)
            for axis, place, length in zip(
                (self._theta, self._phi), places, (theta1 - theta0, phi1 - phi0), strict=True
            )
        ]
        most = np.zeros(len(cells))
        for s in ends[0]:
            for t in ends[1]:
                corner = (places[0]._replace(fraction=s), places[1]._replace(fraction=t))
                most = np.fmax(most, self._blend(corner, self._weighted))
        return np.where(places[0].measured & places[1].measured, most, 0.0) * (1 + ROUNDING)

    def _blend(self, places: tuple[Place, Place], nodes: FloatArray) -> FloatArray:
        total: FloatArray | float = 0.0
        for index, weight in corners(places, self._shape):
            total = total + (weight if nodes.ndim == 1 else weight[:, None]) * nodes[index]
        return np.asarray(total)

    def density(self, theta: FloatArray, phi: FloatArray, *, clamped: bool = True) -> FloatArray:
        places = self._places(theta, phi)
        found = self._blend(places, self._weighted if clamped else self._raw)
        return np.where(places[0].measured & places[1].measured, found, np.nan)

    def values(self, theta: FloatArray, phi: FloatArray) -> FloatArray:
        places = self._places(theta, phi)
        found = self._blend(places, self._channels)
        return np.where((places[0].measured & places[1].measured)[:, None], found, np.nan)


def _fractions_at_ends(axis: Axis, place: Place, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    width = axis.nodes[place.high] - axis.nodes[place.low]
    if axis.period is not None:
        width = np.mod(width, axis.period)
    step = np.where(width > 0, half / np.where(width > 0, width, 1.0), 0.0)
    return np.clip(place.fraction - step, 0.0, 1.0), np.clip(place.fraction + step, 0.0, 1.0)
