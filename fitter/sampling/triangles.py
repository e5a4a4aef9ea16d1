"""The envelope of a slice of a scattered table: linear densities on triangles of the projected disk.

cos(theta) dw = dx dy, so f+ cos(theta) is, on the disk, a sum over scans of functions that are linear on
each triangle. A candidate takes a (scan, triangle, corner) with probability proportional to its exact mass
and then barycentric coordinates from the Dirichlet(2, 1, 1) density, which is proportional to that corner's
hat: together exactly the sum. Only what falls outside the region that all scans of the blend cover is
rejected.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.errors import TableError
from fitter.sampling.envelope import Candidates, SliceInfo
from fitter.sampling.scattered import ScatteredSlice

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# A polygon inscribed in the disk stands for it where shifted scans reach beyond the horizon.
_HORIZON = 720
_EDGE = 1e-12


class TriangleEnvelope:
    """Exact, with exact integral, for piecewise linear slices."""

    def __init__(self, part: ScatteredSlice, weights: FloatArray) -> None:
        self._slice = part
        self._weights = weights
        corners: list[FloatArray] = []
        values: list[FloatArray] = []
        raw: list[FloatArray] = []
        for piece in part.parts:
            simplices = piece.scan.triangulation.simplices
            corners.append((piece.scan.points + piece.shift)[simplices])
            values.append(piece.weight * (piece.scan.clamped @ weights)[simplices])
            raw.append(piece.weight * (piece.scan.value @ weights)[simplices])
        self._corners = np.concatenate(corners)
        self._value = np.concatenate(values)
        area = _area(self._corners)
        self._cumulative = np.cumsum((area[:, None] * self._value / 3).reshape(-1))
        drawn = float(self._cumulative[-1])
        self._beyond: FloatArray | None = None
        # One scan as measured: every draw is inside. Else the region all scans cover, cut at the horizon.
        self._whole = len(part.parts) == 1 and not np.any(part.parts[0].shift)
        if self._whole:
            integral, region = drawn, float(area.sum())
            signed = float((area * np.concatenate(raw).mean(axis=1)).sum())
        else:
            polygon = self._region()
            integral = _integral(self._corners, self._value, polygon)
            signed = _integral(self._corners, np.concatenate(raw), polygon)
            region = _polygon_area(polygon)
        if not integral > 0:
            raise TableError(
                "nothing can be drawn: the table's values are all zero or missing at this incidence",
                code="slice-empty", cause="a blind region, or neighbouring scans that cover different parts",
                remedy="choose another incidence; the table's info lists its domain",
            )  # fmt: skip
        self.info = SliceInfo(
            integral=integral, integral_error=0.0, clamped_share=1.0 - signed / integral,
            coverage=region / np.pi, cells=len(self._corners), acceptance=integral / drawn,
            extrapolated=part.extrapolated,
        )  # fmt: skip

    def _region(self) -> FloatArray:
        hulls = [piece.scan.hull + piece.shift for piece in self._slice.parts]
        polygon = hulls[0]
        for hull in hulls[1:]:
            polygon = _clip(polygon, hull)
        # Where wi is a convex combination of the scans' incidences the region can't leave the disk: |p - s_k|
        # <= 1 for shifts s_k that average to 0 gives |p| <= 1. Only a single shifted scan can.
        if len(polygon) and float(np.hypot(*polygon.T).max()) > 1.0:
            angle = 2 * np.pi * np.arange(_HORIZON) / _HORIZON
            self._beyond = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            polygon = _clip(polygon, self._beyond)
        return polygon

    def draw(self, rng: np.random.Generator, m: int) -> Candidates:
        """``m`` candidates in the sample's frame."""
        random = rng.random((4, m))
        chosen = np.searchsorted(self._cumulative, random[0] * self._cumulative[-1], side="right")
        triangle, corner = np.divmod(np.minimum(chosen, len(self._cumulative) - 1), 3)
        # Spacings of three ordered uniform numbers are Dirichlet(1, 1, 1, 1); two of them added: (2, 1, 1).
        ordered = np.sort(random[1:], axis=0)
        share = np.empty((m, 3))
        rows = np.arange(m)
        share[rows, corner] = ordered[1]
        share[rows, (corner + 1) % 3] = ordered[2] - ordered[1]
        share[rows, (corner + 2) % 3] = 1.0 - ordered[2]
        points = np.einsum("mi,mij->mj", share, self._corners[triangle])
        if self._whole:
            density = np.einsum("mi,mi->m", share, self._value[triangle])
            accepted = np.ones(m, bool)
        else:
            values, accepted = self._evaluate(points)
            density = values @ self._weights
        # Rounding may put a draw from a sliver at the rim outside the disk, by a part in 1e16.
        z2 = np.maximum((1.0 - points[:, 0]) * (1.0 + points[:, 0]) - points[:, 1] ** 2, 0.0)
        turn = self._slice.rotation
        x = np.cos(turn) * points[:, 0] - np.sin(turn) * points[:, 1]
        y = np.sin(turn) * points[:, 0] + np.cos(turn) * points[:, 1]
        return Candidates(np.stack([x, y, np.sqrt(z2)], axis=1), accepted, density)

    def _evaluate(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        values = np.zeros((len(points), len(self._weights)))
        inside = np.ones(len(points), bool)
        for piece in self._slice.parts:
            found, here = piece.scan.evaluate(points - piece.shift, piece.scan.clamped)
            values += piece.weight * found
            inside &= here
        if self._beyond is not None:
            inside &= np.hypot(points[:, 0], points[:, 1]) <= 1.0
            rim = np.flatnonzero(inside & (np.hypot(points[:, 0], points[:, 1]) > np.cos(np.pi / _HORIZON)))
            inside[rim] = (_distances(points[rim], self._beyond) <= _EDGE).all(axis=1)
        return values, inside

    def values(self, wo: FloatArray) -> FloatArray:
        """(M, C) f+ of every channel at directions (M, 3), 0 outside the measured part."""
        turn = self._slice.rotation
        x = np.cos(turn) * wo[:, 0] + np.sin(turn) * wo[:, 1]
        y = np.cos(turn) * wo[:, 1] - np.sin(turn) * wo[:, 0]
        values, inside = self._evaluate(np.stack([x, y], axis=1))
        return np.where((inside & (wo[:, 2] >= 0))[:, None], values, 0.0)


def _area(corners: FloatArray) -> FloatArray:
    """(T,) areas of triangles (T, 3, 2)."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _polygon_area(polygon: FloatArray) -> float:
    if len(polygon) < 3:
        return 0.0
    x, y = polygon.T
    return 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))


def _distances(points: FloatArray, polygon: FloatArray) -> FloatArray:
    """(M, E) by how much points (M, 2) lie outside each edge of a counter-clockwise convex polygon."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    length = np.hypot(*edge.T)
    edge = edge[length > 0] / length[length > 0, None]
    start = polygon[length > 0]
    offset = start[:, 0] * edge[:, 1] - start[:, 1] * edge[:, 0]
    return points[:, :1] * edge[:, 1] - points[:, 1:2] * edge[:, 0] - offset


def _clip(polygon: FloatArray, convex: FloatArray) -> FloatArray:
    """Part of a polygon (n, d) inside a convex one (m, 2), Sutherland-Hodgman; columns beyond 2 go along."""
    edge = np.roll(convex, -1, axis=0) - convex
    for start, along in zip(convex, edge, strict=True):
        if len(polygon) == 0:
            break
        outside = (polygon[:, 0] - start[0]) * along[1] - (polygon[:, 1] - start[1]) * along[0]
        if (outside <= 0).all():
            continue
        kept: list[FloatArray] = []
        for k in range(len(polygon)):
            d0, d1 = float(outside[k - 1]), float(outside[k])
            if (d0 > 0) != (d1 > 0):
                kept.append(polygon[k - 1] + d0 / (d0 - d1) * (polygon[k] - polygon[k - 1]))
            if d1 <= 0:
                kept.append(polygon[k])
        polygon = np.array(kept).reshape(-1, polygon.shape[1])
    return polygon


def _integral(corners: FloatArray, value: FloatArray, region: FloatArray) -> float:
    """Of linear functions, corner values (T, 3), over triangles (T, 3, 2) within a convex region."""
    if len(region) < 3:
        return 0.0
    outside = _distances(corners.reshape(-1, 2), region).reshape(len(corners), 3, -1) > _EDGE
    inner = ~outside.any(axis=(1, 2))
    total = float((_area(corners[inner]) * value[inner].mean(axis=1)).sum())
    # A triangle with all corners beyond one edge has no part inside.
    for k in np.flatnonzero(~inner & ~np.any(outside.all(axis=1), axis=1)):
        piece = _clip(np.concatenate([corners[k], value[k, :, None]], axis=1), region)
        for i in range(1, len(piece) - 1):
            fan = piece[[0, i, i + 1]]
            total += float(_area(fan[None, :, :2])[0] * fan[:, 2].mean())
    return total
