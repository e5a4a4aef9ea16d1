"""Pairs (wi, wo) of a grid in half and difference angles, by f+ cos(theta_i) cos(theta_o).

With h the half vector, dwi dwo = 4 cos(theta_d) sin(theta_d) dtheta_d dphi_d dw_h (S. Rusinkiewicz 1998), so
in (cos theta_h, sin^2 theta_d, phi_d) the measure is flat and the boxes of the grid are boxes. On a box f+
is trilinear in the angles, so at most its largest corner, and cos(theta_i) cos(theta_o) = cos^2 h cos^2 d -
sin^2 h sin^2 d cos^2 phi_d is at most its value with the smallest h, d and |cos phi_d| of the box.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.sampling.alias import AliasTable
from fitter.sampling.axes import Axis, fractions_at_ends, multilinear
from fitter.sampling.drawing import violated
from fitter.sampling.envelope import empty_slice
from fitter.sampling.grid import GridInterpolant
from fitter.sampling.half_difference import packed, unpacked
from fitter.sampling.joint import estimated
from fitter.sampling.majorants import ROUNDING
from fitter.sampling.proposing import Candidates, Proposing

FloatArray = NDArray[np.float64]

# Boxes at most; more are not worth their memory (100 bytes each).
_MOST = 6_000_000
# How often boxes are halved in theta_h and theta_d while fewer candidates are accepted than asked for.
_ROUNDS = 2


class HalfDifferenceJoint(Proposing):
    """Boxes of the grid, halved in theta_h and theta_d while few candidates are accepted."""

    def __init__(self, grid: GridInterpolant, weights: FloatArray, acceptance: float) -> None:
        self._grid = grid
        self._clamped = np.maximum(grid.value, 0.0)
        self._value = self._clamped @ weights
        self._value[~grid.mask] = np.nan
        edges = [_edges(axis) for axis in grid.axes]
        for _ in range(_ROUNDS + 1):
            self._prepare(edges)
            if self.info.acceptance >= acceptance or 4 * np.prod([len(e) for e in edges]) > _MOST:
                break
            edges[:2] = (np.sort(np.concatenate([e, 0.5 * (e[1:] + e[:-1])])) for e in edges[:2])

    def _prepare(self, edges: list[FloatArray]) -> None:
        h, d, p = edges
        axes = self._grid.axes
        places = [
            axis.locate(_wrapped(axis, 0.5 * (e[1:] + e[:-1]))) for axis, e in zip(axes, edges, strict=True)
        ]
        ends = [
            fractions_at_ends(axis, place, 0.5 * np.diff(e))
            for axis, place, e in zip(axes, places, edges, strict=True)
        ]
        most: FloatArray | None = None
        for corner in product((0, 1), repeat=3):
            found = self._value.reshape(self._grid.grid.shape)
            for k, (place, end) in enumerate(zip(places, corner, strict=True)):
                low, high = np.take(found, place.low, axis=k), np.take(found, place.high, axis=k)
                high -= low
                high *= ends[k][end].reshape([-1 if i == k else 1 for i in range(3)])
                found = low + high
                found[(slice(None),) * k + (~place.measured,)] = np.nan
            # NaN where any corner is masked.
            most = found if most is None else np.maximum(most, found, out=most)
        assert most is not None
        cos_h, cos_d = np.cos(h[:-1])[:, None, None], np.cos(d[:-1])[None, :, None]
        sin_h, sin_d = np.sin(h[:-1])[:, None, None], np.sin(d[:-1])[None, :, None]
        steep = np.maximum((cos_h * cos_d) ** 2 - (sin_h * sin_d * _least_cosine(p)) ** 2, 0.0)
        bound = np.nan_to_num(most * steep * (1 + ROUNDING), nan=0.0)
        # 4 cos d sin d dd dphi_d dw_h, with dw_h = d(-cos h) dphi_h.
        size = 2 * np.diff(-np.cos(h))[:, None, None] * np.diff(np.sin(d) ** 2)[:, None] * np.diff(p)
        mass = (bound * size).reshape(-1)
        self._boxes = np.flatnonzero(mass > 0)
        if not len(self._boxes):
            raise empty_slice()
        self._alias = AliasTable(mass[self._boxes])
        self._bound = bound.reshape(-1)[self._boxes]
        self._edges, self._shape = edges, bound.shape
        # phi_h is free, and the half turn of phi_d that the grid leaves out is the reciprocal pair.
        self._turns = max(round(2 * np.pi / float(p[-1] - p[0])), 1)
        self.info = estimated(self, float(mass.sum()) * 2 * np.pi * self._turns)

    def draw(self, rng: np.random.Generator, m: int) -> Candidates:
        """``m`` pairs."""
        chosen = self._alias.choose(rng.random(m))
        u = rng.random((6, m))
        i, j, k = np.unravel_index(self._boxes[chosen], self._shape)
        h, d, p = self._edges
        # sin^2(h/2) = (1 - cos h)/2: nothing is lost near the normal.
        low, high = np.sin(0.5 * h[i]) ** 2, np.sin(0.5 * h[i + 1]) ** 2
        theta_h = np.clip(2 * np.arcsin(np.sqrt(low + u[0] * (high - low))), h[i], h[i + 1])
        low, high = np.sin(d[j]) ** 2, np.sin(d[j + 1]) ** 2
        theta_d = np.clip(np.arcsin(np.sqrt(low + u[1] * (high - low))), d[j], d[j + 1])
        phi_d = p[k] + u[2] * (p[k + 1] - p[k])
        places = [
            axis.locate(_wrapped(axis, x))
            for axis, x in zip(self._grid.axes, (theta_h, theta_d, phi_d), strict=True)
        ]
        phi_d += np.floor(u[3] * self._turns) * (2 * np.pi / self._turns)
        wi, wo = directions.vectors_from_half_difference(theta_h, theta_d, phi_d, (2 * u[4] - 1) * np.pi)
        density = multilinear(places, self._grid.grid.shape, self._value.take)
        field = np.where((wi[:, 2] > 0) & (wo[:, 2] > 0), density * wi[:, 2] * wo[:, 2], 0.0)
        bound = self._bound[chosen]
        if np.any(field > bound):
            raise violated()
        return Candidates((*wi.T, *wo.T), u[5] * bound < field, density, packed(places))

    def channels(self, place: tuple[NDArray[Any], ...]) -> FloatArray:
        """(m, C) f+ of every channel."""
        return multilinear(unpacked(place), self._grid.grid.shape, lambda i: self._clamped.take(i, axis=0))


def _edges(axis: Axis) -> FloatArray:
    """Edges of the boxes along one axis, over all that was measured."""
    if axis.name != "phi_d":
        return axis.breakpoints(0.0, np.pi / 2)
    if axis.period is not None:
        return axis.breakpoints(float(axis.nodes[0]), float(axis.nodes[0]) + axis.period)
    low, high = axis.extent
    return axis.breakpoints(low, high) if np.isfinite(low) else np.linspace(0.0, 2 * np.pi, 9)


def _wrapped(axis: Axis, x: FloatArray) -> FloatArray:
    if axis.name != "phi_d":
        return x
    start = axis.nodes[0]
    return start + np.mod(x - start, axis.period or 2 * np.pi)


def _least_cosine(edges: FloatArray) -> FloatArray:
    """Smallest |cos| on each interval: 0 where it holds an odd multiple of a quarter turn."""
    low, high = edges[:-1], edges[1:]
    ends = np.minimum(np.abs(np.cos(low)), np.abs(np.cos(high)))
    crosses = np.floor(high / np.pi + 0.5) > np.floor(low / np.pi + 0.5)
    return np.where(crosses, 0.0, ends)
