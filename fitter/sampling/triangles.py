"""The envelope of a slice of a scattered table: linear densities on triangles of the projected disk.

cos(theta) dw = dx dy, so f+ cos(theta) is, on the disk, linear on each triangle; where scans are blended,
on each triangle of their common mesh (:mod:`fitter.sampling.mesh`).

By inversion: a triangle and one of its corners, with probability proportional to the mass of that corner's
hat, then barycentric coordinates from the Dirichlet(2, 1, 1) density, which is proportional to the hat:
together exactly the sum. By rejection: a triangle by its largest corner value, which bounds a linear
function, a point uniform in it, accepted with probability value / bound.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import triangles
from fitter.sampling.alias import AliasTable
from fitter.sampling.curvature import gain_of_triangles
from fitter.sampling.drawing import Kernel
from fitter.sampling.envelope import Method, SliceInfo, empty_slice
from fitter.sampling.mesh import Mesh, halved, overlay
from fitter.sampling.refining import worth_halving
from fitter.sampling.scattered import ScatteredSlice

FloatArray = NDArray[np.float64]

# A polygon inscribed in the disk stands for it where a shifted scan reaches beyond the horizon.
_HORIZON = 720
# Triangles smaller than this (of points on a line) hold nothing.
_SMALLEST = 1e-16
_ROUNDS = 40
_ROUNDING = 1e-9
# How far beyond a side, in barycentric coordinates, the search for a triangle takes a point to be in it.
_SIDE = 4e-9


class TriangleEnvelope:
    """Exact, with exact integral. ``acceptance`` and ``cells`` concern the rejection only."""

    def __init__(
        self, part: ScatteredSlice, weights: FloatArray, acceptance: float, cells: int, method: Method
    ) -> None:
        self._slice, self._weights = part, weights
        self._channels = len(weights)
        mesh = _common(part)
        raw = mesh.integrals()[:, self._channels :].sum(axis=0) @ weights
        mesh = Mesh(mesh.corners, mesh.values[..., : self._channels])
        integral = float(mesh.integrals().sum(axis=0) @ weights)
        if not integral > 0:
            raise empty_slice()
        region, sphere = float(mesh.areas.sum()), _solid_angle(mesh)
        self._exact = method == "inversion"
        if not self._exact:
            # A common mesh may have more triangles than that to begin with.
            mesh = _refined(mesh, weights, acceptance, max(cells, 4 * len(mesh.corners)))
        value = mesh.values @ weights
        hats = mesh.areas[:, None] * (value / 3 if self._exact else value.max(axis=1, keepdims=True))
        keep = hats.sum(axis=1) > 0
        value, hats, corners = value[keep], hats[keep], mesh.corners[keep]
        self._bound = value.max(axis=1) * (1 + _ROUNDING)
        every = mesh.values[keep]
        if self._exact:  # an item for every corner of every triangle, that corner first
            order = np.array([[0, 1, 2], [1, 2, 0], [2, 0, 1]])
            corners, value, every = (
                x[:, order].reshape(-1, 3, *x.shape[2:]) for x in (corners, value, every)
            )
        self._point = _columns(np.concatenate([corners, value[..., None]], axis=2))
        items = (*self._point, *(_columns(every) if self._channels > 1 else ()))
        self.kernel = Kernel(
            partial(
                triangles.fill, *AliasTable(hats.reshape(-1)).boxes,
                np.stack([one for column in items for one in column], axis=1), 1 + _ROUNDING, self._exact,
                (float(np.cos(part.rotation)), float(np.sin(part.rotation))), integral,
            )
        )  # fmt: skip
        drawn = float(hats.sum())
        self.integral, self.acceptance = integral, min(integral / drawn, 1.0)
        self.info = SliceInfo(
            integral=integral, integral_error=0.0, clamped_share=1.0 - float(raw) / integral,
            coverage=min(region / np.pi, 1.0), blind=max(1.0 - sphere / (2 * np.pi), 0.0),
            cells=int(keep.sum()), acceptance=self.acceptance, extrapolated=part.extrapolated,
            method=method,
        )  # fmt: skip

    def energy_error(self) -> float:
        """Relative size of what interpolation adds to the integral, estimated."""
        found = sum(
            part.weight
            * gain_of_triangles(
                part.scan.points, part.scan.clamped @ self._weights, part.scan.triangulation.simplices
            )
            for part in self._slice.parts
        )
        return abs(found) / self.integral

    def values(self, wo: FloatArray) -> FloatArray:
        """(M, C) f+ of every channel at directions (M, 3), 0 outside the measured part."""
        turn = self._slice.rotation
        x = np.cos(turn) * wo[:, 0] + np.sin(turn) * wo[:, 1]
        y = np.cos(turn) * wo[:, 1] - np.sin(turn) * wo[:, 0]
        points = np.stack([x, y], axis=1)
        values = np.zeros((len(points), self._channels))
        inside = wo[:, 2] >= 0
        for piece in self._slice.parts:
            found, here = piece.scan.evaluate(points - piece.shift, piece.scan.clamped)
            values += piece.weight * found
            inside &= here
        return np.where(inside[:, None], values, 0.0)

    def attack(self, rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
        """``(field cos, bound)`` at ``count`` points chosen to break the bound: corners and sides."""
        item = rng.integers(0, len(self._point[0][0]), count)
        share = rng.dirichlet((0.2, 0.2, 0.2), count)
        x, y, _ = (_mixed(column, item, share[:, 1], share[:, 2]) for column in self._point)
        inside = x * x + y * y <= 1
        turn = self._slice.rotation
        wo = np.stack(
            [
                np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y,
                np.sqrt(np.maximum(1 - x * x - y * y, 0.0)),
            ], axis=1,
        )  # fmt: skip
        # A point on a side may be found in the triangle beyond it, by the tolerance of that search.
        slack = _SIDE * float(self._bound.max())
        return self.values(wo[inside]) @ self._weights, self._bound[item[inside]] + slack


def _columns(items: FloatArray) -> tuple[tuple[FloatArray, FloatArray, FloatArray], ...]:
    """Of (n, 3, K): for each of the K, its value at the first corner and its changes to the other two."""
    first = items[:, 0]
    return tuple(
        (first[:, k].copy(), items[:, 1, k] - first[:, k], items[:, 2, k] - first[:, k])
        for k in range(items.shape[2])
    )


def _mixed(
    column: tuple[FloatArray, FloatArray, FloatArray],
    item: NDArray[np.intp],
    second: FloatArray,
    third: FloatArray,
) -> FloatArray:
    found = column[0].take(item)
    found += second * column[1].take(item)
    found += third * column[2].take(item)
    return found


def _common(part: ScatteredSlice) -> Mesh:
    """The slice on one mesh: values clamped at 0, then as measured, of every channel."""
    mesh: Mesh | None = None
    for piece in part.parts:
        simplices = piece.scan.triangulation.simplices
        values = piece.weight * np.concatenate([piece.scan.clamped, piece.scan.value], axis=1)
        one = Mesh((piece.scan.points + piece.shift)[simplices], values[simplices])
        one = Mesh(one.corners[one.areas > _SMALLEST], one.values[one.areas > _SMALLEST])
        mesh = one if mesh is None else overlay(mesh, one)
    assert mesh is not None
    # Where wi is a convex combination of the scans' incidences the region can't leave the disk: |p - s_k|
    # <= 1 for shifts s_k that average to 0 gives |p| <= 1. Only a single shifted scan can.
    if len(mesh.corners) and float(np.hypot(*mesh.corners.reshape(-1, 2).T).max()) > 1.0 + 1e-9:
        angle = 2 * np.pi * np.arange(_HORIZON) / _HORIZON
        rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        fan = np.stack([np.zeros_like(rim), rim, np.roll(rim, -1, axis=0)], axis=1)
        mesh = overlay(mesh, Mesh(fan, np.zeros((_HORIZON, 3, mesh.values.shape[2]))))
    return mesh


def _refined(mesh: Mesh, weights: FloatArray, acceptance: float, most: int) -> Mesh:
    """Triangles halved where the largest corner exceeds the mean most, until the acceptance is reached."""
    for _ in range(_ROUNDS):
        value = mesh.values @ weights
        areas = mesh.areas
        split = worth_halving(areas * value.max(axis=1), areas * value.mean(axis=1), acceptance, most)
        if split is None:
            break
        mesh = halved(mesh, split)
    return mesh


def _solid_angle(mesh: Mesh) -> float:
    """Of the region on the sphere: spherical triangles over the corners, by L'Huilier's theorem.

    Straight sides on the disk are no great circles; of neighbours the difference cancels.
    """
    corners = mesh.corners
    z = np.sqrt(np.maximum(1.0 - (corners**2).sum(axis=2), 0.0))
    w = np.concatenate([corners, z[..., None]], axis=2)
    side = [np.linalg.norm(w[:, k] - w[:, (k + 1) % 3], axis=1) for k in range(3)]
    a, b, c = (2 * np.arcsin(np.minimum(0.5 * length, 1.0)) for length in side)
    s = 0.5 * (a + b + c)
    product = np.tan(0.5 * s) * np.tan(0.5 * (s - a)) * np.tan(0.5 * (s - b)) * np.tan(0.5 * (s - c))
    return float(4 * np.arctan(np.sqrt(np.maximum(product, 0.0))).sum())
