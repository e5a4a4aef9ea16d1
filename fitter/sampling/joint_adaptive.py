"""Pairs (wi, wo) of a table in an adaptive parameterisation, by f+ cos(theta_i) cos(theta_o).

Cells are boxes of (theta_i, phi_i, u, v), u and v the half vector's as in
:class:`fitter.sampling.adaptive.AdaptiveField`; the measure is d(sin^2 theta_i)/2 dphi_i du dv, and what is
bounded is the slice's field. Between stored incidences the warp's distributions and the data are linear in
the weights of the stored ones, those in theta_i and in phi_i. So the place in the uniform square is a
fraction of linear functions of each weight, monotone in it, and its extremes over a box are at corners; so is
the largest blend of the data's own maxima.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.errors import TableError
from fitter.sampling.adaptive import SLACK, AdaptiveInterpolant, nearest_cosine
from fitter.sampling.alias import AliasTable
from fitter.sampling.drawing import violated
from fitter.sampling.envelope import empty_slice
from fitter.sampling.joint import estimated
from fitter.sampling.majorants import ROUNDING
from fitter.sampling.maxima import BilinearMaximum
from fitter.sampling.proposing import Candidates, Proposing
from fitter.sampling.refining import worth_halving
from fitter.sampling.warp import lookup, lookup_blend

FloatArray = NDArray[np.float64]

# Cells for each one of a slice's envelope.
_MORE = 16
_COLUMNS = 16
_ROUNDS = 40
# Cells that are bounded at a time.
_CHUNK = 1 << 14
# An arc of theta_i counts as so much shorter than one of the half vector: in half vectors a lobe stays put.
_SLOWER = 0.1


class AdaptiveJoint(Proposing):
    """Cells halved until the expected acceptance reaches ``acceptance`` or there are 16 ``cells`` of them."""

    def __init__(
        self, table: AdaptiveInterpolant, weights: FloatArray, acceptance: float, cells: int
    ) -> None:
        adaptive = table.adaptive
        if len(adaptive.theta_i) < 2:
            raise TableError(
                "the table has one incidence: nothing is known of others", code="too-few-incidences",
                remedy="draw for that incidence alone",
            )  # fmt: skip
        self._adaptive, self._quantity = adaptive, table.quantity
        self._channels = np.maximum(adaptive.data.astype(np.float64), 0.0)
        self._data = np.tensordot(self._channels, weights, ((1,), (0,)))[:, None]
        self._ndf = np.asarray(adaptive.ndf, np.float64) if adaptive.jacobian else np.full((2, 2), 4.0)
        self._sigma = np.asarray(adaptive.sigma, np.float64) if adaptive.jacobian else np.ones((2, 2))
        known = np.nan_to_num(self._data[:, 0], nan=0.0)
        self._most = BilinearMaximum(known), BilinearMaximum(self._ndf), BilinearMaximum(-self._sigma)
        boxes, bound = self._refine(self._begin(), acceptance, _MORE * cells)
        envelope = bound * _measures(boxes)
        keep = envelope > 0
        if not keep.any():
            raise empty_slice()
        self._bound, self._alias = bound[keep], AliasTable(envelope[keep])
        t0, t1, *rest = boxes[keep].T
        change = np.sin(t1 - t0) * np.sin(t1 + t0)
        low, high = np.stack(rest[::2]), np.stack(rest[1::2])
        self._columns = np.sin(t0) ** 2, np.cos(t0) ** 2, change, low, high - low
        copies = adaptive.folds if adaptive.folds in (2, 4) else 1
        self.info = estimated(self, float(envelope.sum()) * copies)

    def _begin(self) -> FloatArray:
        """(K, 8) theta_i, phi_i, u and v, each from and to: none crosses a stored incidence or a row of the
        warp."""
        adaptive = self._adaptive
        end = {2: 0.0, 4: -np.pi / 2}.get(adaptive.folds, np.pi)
        phi = adaptive.phi_i[(adaptive.phi_i > -np.pi) & (adaptive.phi_i < end)]
        edges = (
            adaptive.theta_i, np.concatenate([[-np.pi], phi, [end]]), np.linspace(0, 1, _COLUMNS + 1),
            np.linspace(0, 1, adaptive.warp.shape[0]),
        )  # fmt: skip
        index = np.meshgrid(*(np.arange(len(e) - 1) for e in edges), indexing="ij")
        sides = [(e[i.reshape(-1)], e[i.reshape(-1) + 1]) for e, i in zip(edges, index, strict=True)]
        return np.stack([side for pair in sides for side in pair], axis=1).astype(np.float64)

    def _refine(self, boxes: FloatArray, acceptance: float, most: int) -> tuple[FloatArray, FloatArray]:
        bound, mass = self._bounds(boxes), self._mass(boxes)
        for _ in range(_ROUNDS):
            split = worth_halving(_measures(boxes) * bound, mass, acceptance, max(most, len(boxes)))
            if split is None:
                break
            fresh = self._halves(boxes[split])
            boxes = np.concatenate([boxes[~split], fresh])
            bound = np.concatenate([bound[~split], self._bounds(fresh)])
            mass = np.concatenate([mass[~split], self._mass(fresh)])
        return boxes, bound

    def _halves(self, boxes: FloatArray) -> FloatArray:
        """Both halves of each, cut across its longest side."""
        t0, t1, p0, p1, u0, u1, v0, v1 = boxes.T
        turning = (
            0.0 if self._adaptive.isotropic and len(self._adaptive.phi_i) == 1 else np.sin(t1) * (p1 - p0)
        )
        sides = [
            _SLOWER * (t1 - t0), _SLOWER * turning + 0 * t0, np.pi * u1 * (u1 - u0),
            np.sin(0.5 * np.pi * u1**2) * 2 * np.pi * (v1 - v0),
        ]  # fmt: skip
        k, rows = 2 * np.argmax(sides, axis=0), np.arange(len(boxes))
        middle = 0.5 * (boxes[rows, k] + boxes[rows, k + 1])
        first, second = boxes.copy(), boxes.copy()
        first[rows, k + 1] = middle
        second[rows, k] = middle
        return np.concatenate([first, second])

    def _bounds(self, boxes: FloatArray) -> FloatArray:
        return np.concatenate([self._some(boxes[k : k + _CHUNK]) for k in range(0, len(boxes), _CHUNK)])

    def _some(self, boxes: FloatArray) -> FloatArray:
        adaptive = self._adaptive
        t0, t1, p0, p1, u0, u1, v0, v1 = boxes.T
        # Azimuths of pi and -pi are one: what is asked for is the end of the cell's own side.
        azimuths = (p0 + 1e-12, p1 - 1e-12) if len(adaptive.phi_i) > 1 else (p0,)
        blends = [
            adaptive.blend(directions.vector_from_spherical(t, p)) for t, p in product((t0, t1), azimuths)
        ]
        places = [adaptive.warp.inverse(blend, u, v) for blend in blends for u in (u0, u1) for v in (v0, v1)]
        s, t = (np.stack(column) for column in zip(*places, strict=True))
        box = [f(x, axis=0) + w for x in (s, t) for f, w in ((np.min, -SLACK), (np.max, SLACK))]
        most, ndf, sigma = self._most
        value = np.max(
            [
                np.sum(
                    [weight * most(box[0], box[1], box[2], box[3], node) for node, weight in blend], axis=0
                )
                for blend in blends
            ],
            axis=0,
        )
        along, lowest = self._along(boxes)
        x0, x1 = np.sqrt(t0 * (2 / np.pi)), np.sqrt(t1 * (2 / np.pi))
        y0, y1 = p0 / (2 * np.pi) + 0.5, p1 / (2 * np.pi) + 0.5
        least = -sigma(x0, x1, y0, y1)
        value *= ndf(u0, u1, v0, v1) * along * (2 * np.pi**2) * u1 * np.sin(u1 * u1 * (np.pi / 2)) / least
        highest = 2 * along * np.cos(u0 * u0 * (np.pi / 2)) - lowest
        if self._quantity != "ccbrdf":
            value *= np.clip(highest, 0.0, 1.0)
        value[highest < -1e-9] = 0.0
        return np.maximum(value, 0.0) * (1 + ROUNDING)

    def _along(self, boxes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(K,) the largest wi.m, and the least cosine of theta_i."""
        t0, t1, p0, p1, *half = boxes.T
        theta, spread = 0.5 * (t0 + t1), 0.5 * (t1 - t0)
        turn = np.zeros_like(theta)
        if not self._adaptive.isotropic:
            turn = 0.5 * (p0 + p1)
            spread = spread + np.sin(t1) * 0.5 * (p1 - p0)
        wi = directions.vector_from_spherical(theta, turn)
        return nearest_cosine(np.stack(half, axis=1), 0.0, wi, spread), np.cos(t1)

    def _mass(self, boxes: FloatArray) -> FloatArray:
        """(K,) of the field, by two points along u and along v at the middle of the incidences."""
        t0, t1, p0, p1, u0, u1, v0, v1 = boxes.T
        points = 0.5 - 0.5 / np.sqrt(3), 0.5 + 0.5 / np.sqrt(3)
        theta, phi = 0.5 * (t0 + t1), 0.5 * (p0 + p1)
        total = np.zeros(len(boxes))
        for a, b in product(points, points):
            found = self._field(theta, phi, u0 + a * (u1 - u0), v0 + b * (v1 - v0))[0]
            total += 0.25 * np.nan_to_num(found, nan=0.0)
        return total * _measures(boxes)

    def _field(
        self, theta: FloatArray, phi: FloatArray, u: FloatArray, v: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, tuple[Any, ...]]:
        """Field (NaN below the horizon), density, wi, wo (M, 3), and for :meth:`channels`."""
        adaptive = self._adaptive
        wi = directions.vector_from_spherical(theta, phi)
        turn = phi if adaptive.isotropic else 0.0
        m = directions.vector_from_spherical(u * u * (np.pi / 2), (2 * v - 1) * np.pi + turn)
        along = np.einsum("mi,mi->m", m, wi)
        wo = 2 * along[:, None] * m - wi
        blend = adaptive.blend(wi)
        s, t = adaptive.warp.inverse(blend, u, v)
        at = np.sqrt(theta * (2 / np.pi)), np.mod(phi / (2 * np.pi) + 0.5, 1.0)
        factor = lookup(self._ndf, u, v) / (4 * lookup(self._sigma, *at))
        if self._quantity == "ccbrdf":
            factor /= np.where(wo[:, 2] > 0, wo[:, 2], np.inf)
        elif self._quantity == "reflectance_factor":
            factor /= np.pi
        density = lookup_blend(self._data, blend, s, t)[:, 0] * factor
        field = density * wo[:, 2] * along * (8 * np.pi**2) * u * np.sin(u * u * (np.pi / 2))
        field[(wo[:, 2] <= 0) | (along <= 0)] = np.nan
        kept = (s, t, factor, *(column for pair in blend for column in pair))
        return field, density, wi, wo, kept

    def draw(self, rng: np.random.Generator, m: int) -> Candidates:
        """``m`` pairs."""
        cell = self._alias.choose(rng.random(m))
        u = rng.random((6, m))
        sin2, cos2, change, low, width = (column.take(cell, axis=-1) for column in self._columns)
        change *= u[0]
        theta = np.arctan2(np.sqrt(sin2 + change), np.sqrt(np.maximum(cos2 - change, 0.0)))
        phi, a, b = low + u[1:4] * width
        field, density, wi, wo, place = self._field(theta, phi, a, b)
        bound = self._bound.take(cell)
        if np.any(field > bound):
            raise violated()
        sign = np.ones((3, m))
        if self._adaptive.folds in (2, 4):  # which of the surface's copies
            sign[1] = np.where(u[4] < 0.5, -1.0, 1.0)
            sign[0] = sign[1]
            if self._adaptive.folds == 4:
                sign[0] = np.where(2 * u[4] % 1 < 0.5, -1.0, 1.0)
        return Candidates((*(wi.T * sign), *(wo.T * sign)), u[5] * bound < field, density, place)

    def channels(self, place: tuple[NDArray[Any], ...]) -> FloatArray:
        """(m, C) f+ of every channel."""
        s, t, factor, *blend = place
        pairs = list(zip(blend[::2], blend[1::2], strict=True))
        return lookup_blend(self._channels, pairs, s, t) * factor[:, None]


def _measures(boxes: FloatArray) -> FloatArray:
    """(K,) the measure of each box."""
    t0, t1, p0, p1, u0, u1, v0, v1 = boxes.T
    return 0.5 * np.sin(t1 - t0) * np.sin(t1 + t0) * (p1 - p0) * (u1 - u0) * (v1 - v0)
