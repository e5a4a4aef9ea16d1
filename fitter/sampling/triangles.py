"""The envelope of a slice of a scattered table: linear densities on triangles of the projected disk.

cos(theta) dw = dx dy, so f+ cos(theta) is, on the disk, linear on each triangle; where scans are blended,
on each triangle of their common mesh (:mod:`fitter.sampling.mesh`).

By inversion: a triangle and one of its corners, with probability proportional to the mass of that corner's
hat, then barycentric coordinates from the Dirichlet(2, 1, 1) density, which is proportional to the hat:
together exactly the sum. By rejection: a triangle by its largest corner value, which bounds a linear
function, a point uniform in it, accepted with probability value / bound.
"""

from __future__ import annotations

from functools import cached_property, partial

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
        self._mesh = mesh = _common(part)
        mesh = Mesh(mesh.corners, mesh.values[..., : self._channels])
        integral = float(mesh.integrals().sum(axis=0) @ weights)
        if not integral > 0:
            raise empty_slice()
        self._exact = method == "inversion"
        if not self._exact:
            # A common mesh may have more triangles than that to begin with.
            mesh = _refined(mesh, weights, acceptance, max(cells, 4 * len(mesh.corners)))
        value = mesh.values @ weights
        hats = mesh.areas[:, None] * (value / 3 if self._exact else value.max(axis=1, keepdims=True))
        keep = hats.sum(axis=1) > 0
        value, hats, corners = value[keep], hats[keep], mesh.corners[keep]
        self._bound = value.max(axis=1) * (1 + _ROUNDING)
        every = mesh.values[keep][:, :, : self._channels if self._channels > 1 else 0]
        c, s = np.cos(part.rotation), np.sin(part.rotation)
        x, y = corners[..., 0], corners[..., 1]
        turned = [c * x - s * y, s * x + c * y, value / integral, *np.moveaxis(every, 2, 0)]
        self._corners = np.stack(turned, axis=2)
        # By inversion an item is a corner of a triangle, else a triangle.
        boxes = AliasTable(hats.T.reshape(-1)).boxes
        self.kernel = Kernel(partial(triangles.fill, *boxes, self._corners, 1 + _ROUNDING, self._exact))
        drawn = float(hats.sum())
        self.integral, self.acceptance = integral, min(integral / drawn, 1.0)
        self._method: Method = method

    @property
    def info(self) -> SliceInfo:
        """What is known of the slice; what drawing does not need is computed when it is asked for."""
        return self._info

    @cached_property
    def _info(self) -> SliceInfo:
        raw = self._mesh.integrals()[:, self._channels :].sum(axis=0) @ self._weights
        return SliceInfo(
            integral=self.integral, integral_error=0.0, clamped_share=1.0 - float(raw) / self.integral,
            coverage=min(float(self._mesh.areas.sum()) / np.pi, 1.0),
            blind=max(1.0 - _solid_angle(self._mesh) / (2 * np.pi), 0.0), cells=len(self._corners),
            acceptance=self.acceptance, extrapolated=self._slice.extrapolated, method=self._method,
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
        item = rng.integers(0, len(self._corners), count)
        share = rng.dirichlet((0.2, 0.2, 0.2), count)
        x, y = np.einsum("kc,kcd->dk", share, self._corners[item, :, :2])
        inside = x * x + y * y <= 1
        wo = np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0.0))], axis=1)
        # A point on a side may be found in the triangle beyond it, by the tolerance of that search.
        slack = _SIDE * float(self._bound.max())
        return self.values(wo[inside]) @ self._weights, self._bound[item[inside]] + slack


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
