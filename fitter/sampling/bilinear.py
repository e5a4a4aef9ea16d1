"""The envelope of a slice of a grid in incoming and outgoing angles: bilinear pieces, chosen by mass.

A cell is a rectangle in (theta_o, azimuth) inside one cell of the grid. Candidates follow the bilinear
interpolant of the field's values at the cell's corners, drawn by inverting its marginal and conditional
distributions, and the largest sin(theta) cos(theta) of the cell: the envelope is their product.

It dominates. (1) Where the field is bilinear the two are equal. Where it is the k-th power, k >= 1, of a
bilinear function g >= 0, it is convex in theta and in azimuth, each by itself, and so is a sum of such with
weights >= 0; then f(s, t) <= (1 - s) f(0, t) + s f(1, t), and each of f(0, t), f(1, t) is at most linear
between corners: the field is nowhere above the bilinear interpolant of its corners. (2) sin cos = sin(2
theta)/2 is largest at 45 degrees if the cell holds it, else at the end that is nearer to it.
"""

from __future__ import annotations

from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.kernels import bilinear
from fitter.sampling.alias import AliasTable
from fitter.sampling.arcs import moments
from fitter.sampling.drawing import Kernel, in_lines
from fitter.sampling.envelope import Method, SliceInfo, empty_slice, no_inversion
from fitter.sampling.refining import worth_halving
from fitter.sampling.spherical import SphericalField

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

#: Covers the rounding of the interpolation (a few sums of products).
ROUNDING = 1e-9
_QUARTER = np.pi / 4
# Cells are at most so tall and so wide (radians): the series of the inversion, and of sines, need it.
_TALLEST, _WIDEST = 0.13, 0.26
_ROUNDS = 40
# Gauss-Legendre points per direction of fields that are powers: to steer the refinement, and in the end.
_STEER = 2
_FINAL = 5


class _Sides:
    """Intervals of one angle, start (R,) and length (R,), which cells share: rows of them, or columns."""

    def __init__(self, edges: FloatArray) -> None:
        self.start, self.length = edges[:-1], np.diff(edges)

    def halves(self, which: IndexArray) -> tuple[IndexArray, IndexArray]:
        """The lower and the upper half of each interval of ``which`` (K,), added to those there are."""
        used, where = np.unique(which, return_inverse=True)
        count, start, half = len(self.start), self.start[used], 0.5 * self.length[used]
        self.start = np.concatenate([self.start, start, start + half])
        self.length = np.concatenate([self.length, half, half])
        return count + where, count + len(used) + where


class BilinearEnvelope:
    """Cells halved until the expected acceptance reaches ``acceptance`` or there are ``cells`` of them.

    With ``method`` "inversion" (bilinear fields only) theta follows its exact marginal distribution, its
    equation solved to rounding, and every candidate is accepted.
    """

    def __init__(self, field: SphericalField, acceptance: float, cells: int, method: Method) -> None:
        self._field = field
        if method == "inversion" and not field.linear:
            raise no_inversion("an incidence whose lobe is narrow against the grid")
        self._exact = method == "inversion"
        edges = field.edges(_TALLEST, _WIDEST)
        self._rows, self._columns = (_Sides(some) for some in edges)
        row, column = (some.reshape(-1) for some in np.indices([len(some) - 1 for some in edges]))
        corners = field.corners_of_grid(*edges)
        measured = np.flatnonzero(np.isfinite(corners.sum(axis=0)))
        row, column, corners = row[measured], column[measured], corners[:, measured]
        if not self._exact:
            row, column, corners = self._refine(row, column, corners, acceptance, cells)
        self._finish(row, column, corners, method)

    def _rectangles(self, row: IndexArray, column: IndexArray) -> FloatArray:
        """(K, 4) theta0, theta1, phi0, phi1 of cells."""
        theta, phi = self._rows.start[row], self._columns.start[column]
        return np.stack([theta, theta + self._rows.length[row], phi, phi + self._columns.length[column]], 1)

    def _refine(
        self, row: IndexArray, column: IndexArray, corners: FloatArray, acceptance: float, most: int
    ) -> tuple[IndexArray, IndexArray, FloatArray]:
        mass = self._mass(row, column, corners, _STEER)
        for _ in range(_ROUNDS):
            split = worth_halving(self._envelope(row, column, corners), mass, acceptance, most)
            if split is None:
                break
            fresh = self._halves(row[split], column[split], corners[:, split])
            found = self._field.corners(self._rectangles(*fresh)).T
            row, column = (
                np.concatenate([old[~split], new]) for old, new in zip((row, column), fresh, strict=True)
            )
            corners = np.concatenate([corners[:, ~split], found], axis=1)
            mass = np.concatenate([mass[~split], self._mass(*fresh, found, _STEER)])
        return row, column, corners

    def _halves(
        self, row: IndexArray, column: IndexArray, corners: FloatArray
    ) -> tuple[IndexArray, IndexArray]:
        """Rows and columns of both halves of each, cut across theta where that is what the envelope loses
        by."""
        tall = np.ones(len(row), bool)
        if not self._field.linear:
            theta0, theta1, phi0, phi1 = self._rectangles(row, column).T
            theta, phi = 0.5 * (theta0 + theta1), 0.5 * (phi0 + phi1)
            mean = corners.mean(axis=0)
            # What the bilinear interpolant exceeds the field by half-way along theta, and along azimuth.
            along = 0.5 * (self._field.density(theta, phi0) + self._field.density(theta, phi1))
            across = 0.5 * (self._field.density(theta0, phi) + self._field.density(theta1, phi))
            steep = mean * np.abs(np.cos(2 * theta)) * (theta1 - theta0)
            tall = np.nan_to_num(mean - along + 0.5 * steep) >= np.nan_to_num(mean - across)
        rows, columns = np.stack([row, row]), np.stack([column, column])
        rows[:, tall], columns[:, ~tall] = self._rows.halves(row[tall]), self._columns.halves(column[~tall])
        return rows.reshape(-1), columns.reshape(-1)

    def _mass(
        self,
        row: IndexArray,
        column: IndexArray,
        corners: FloatArray,
        points: int,
        *,
        clamped: bool = True,
    ) -> FloatArray:
        """(K,) integral of the field times cos(theta) over each cell: exact where it is bilinear."""
        if self._field.linear:
            low, high = moments(self._rows.start, self._rows.length)
            found = low.take(row) * (corners[0] + corners[1])
            found += high.take(row) * (corners[2] + corners[3])
            return found * (0.5 * self._columns.length).take(column)
        x, weight = np.polynomial.legendre.leggauss(points)
        theta0, theta1, phi0, phi1 = (side[:, None, None] for side in self._rectangles(row, column).T)
        theta = 0.5 * (theta0 + theta1) + 0.5 * (theta1 - theta0) * x[None, :, None]
        phi = 0.5 * (phi0 + phi1) + 0.5 * (phi1 - phi0) * x[None, None, :]
        theta, phi = np.broadcast_arrays(theta, phi)
        value = self._field.density(theta.reshape(-1), phi.reshape(-1), clamped=clamped).reshape(theta.shape)
        jacobian = 0.25 * (theta1 - theta0) * (phi1 - phi0) * 0.5 * np.sin(2 * theta)
        return np.einsum("kij,i,j->k", value * jacobian, weight, weight)

    def _envelope(self, row: IndexArray, column: IndexArray, corners: FloatArray) -> FloatArray:
        """(K,) integral of the envelope over each cell."""
        start, length = self._rows.start, self._rows.length
        found = (0.25 * length * _steepest(start, start + length)).take(row)
        found *= self._columns.length.take(column)
        return found * corners.sum(axis=0)

    def _finish(self, row: IndexArray, column: IndexArray, corners: FloatArray, method: Method) -> None:
        field = self._field
        mass = self._mass(row, column, corners, _FINAL)
        integral = float(mass.sum())
        if not integral > 0:
            raise empty_slice()
        envelope = mass if self._exact else self._envelope(row, column, corners)
        self._all = row, column, corners, mass
        keep = np.flatnonzero(envelope > 0)
        row, column, corners = row[keep], column[keep], corners[:, keep]
        self._row, self._column, self._corner = row, column, corners
        every = np.zeros((0, len(row)))
        if field.linear and field.count > 1:
            every = field.corners_of_channels(self._rectangles(row, column)).reshape(-1, len(row))
        theta, height = self._rows.start, self._rows.length
        phi, width = self._columns.start + 0.5 * self._columns.length + field.rotation, self._columns.length
        middle, (low, high) = theta + 0.5 * height, moments(theta, height)
        self._steepest = 2 * _steepest(theta, theta + height)
        rows = (
            np.cos(middle), np.sin(middle), 0.5 * height, self._steepest, np.sin(2 * theta),
            np.cos(2 * theta), low / height, high / height,
        )  # fmt: skip
        powers = field.powers(np.zeros((0, 4)) if field.linear else self._rectangles(row, column))
        self.kernel = Kernel(
            partial(
                bilinear.fill, *AliasTable(envelope[keep]).boxes,
                in_lines([*corners, *every], 4 + len(every)),
                np.stack([row, column], axis=1).astype(np.int32),
                np.stack(rows, axis=1), np.stack([np.cos(phi), np.sin(phi), 0.5 * width], axis=1),
                *powers, 1 + ROUNDING, self._exact, integral,
            )
        )  # fmt: skip
        self.integral, self.acceptance = integral, integral / float(envelope.sum())
        self._method: Method = method

    @property
    def info(self) -> SliceInfo:
        """What is known of the slice; what drawing does not need is computed when it is asked for."""
        return self._info

    @cached_property
    def _info(self) -> SliceInfo:
        field, (row, column, corners, mass) = self._field, self._all
        error = clamped = 0.0
        if not field.linear:
            error = float(np.abs(mass - self._mass(row, column, corners, _FINAL - 1)).sum()) / self.integral
        if field.clamps:
            raw = field.corners(self._rectangles(row, column), clamped=False).T
            raw = self._mass(row, column, raw, _FINAL, clamped=False)
            clamped = 1.0 - float(raw.sum()) / self.integral
        theta0, theta1, phi0, phi1 = self._rectangles(row, column).T
        sphere = np.sin(0.5 * (theta1 - theta0)) * np.sin(0.5 * (theta1 + theta0)) * (phi1 - phi0) / np.pi
        disk = np.sin(theta1 - theta0) * np.sin(theta1 + theta0) * (phi1 - phi0) / (2 * np.pi)
        return SliceInfo(
            integral=self.integral, integral_error=error, clamped_share=clamped,
            coverage=min(float(disk.sum()), 1.0), blind=max(1.0 - float(sphere.sum()), 0.0),
            cells=len(self._row), acceptance=self.acceptance, extrapolated=field.extrapolated,
            method=self._method,
        )  # fmt: skip

    def energy_error(self) -> float:
        """What the integral is known to for interpolation alone, relative."""
        return self._field.energy_error

    def values(self, wo: FloatArray) -> FloatArray:
        """(M, C) f+ of every channel at directions (M, 3), 0 outside the measured part."""
        theta, phi = directions.spherical_from_vector(wo)
        found = self._field.values(theta, phi - self._field.rotation)
        return np.where((wo[:, 2] > 0)[:, None], np.nan_to_num(found, nan=0.0), 0.0)

    def attack(self, rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
        """``(field cos, bound)`` at ``count`` points made to break the bound: sides and corners of cells."""
        cell = rng.integers(0, len(self._row), count)
        s, t = rng.random((2, count))
        s, t = (np.where(rng.random(count) < 0.4, np.round(x), x) for x in (s, t))
        f00, f01, f10, f11 = (corner[cell] for corner in self._corner)
        envelope = (1 - s) * ((1 - t) * f00 + t * f01) + s * ((1 - t) * f10 + t * f11)
        row, column = self._row[cell], self._column[cell]
        theta = self._rows.start[row] + s * self._rows.length[row]
        phi = self._columns.start[column] + t * self._columns.length[column]
        # Of two cells that share a side, the one that the rounding chooses may be the other one.
        density = self._field.density(theta, phi)
        steep = 0.5 * np.sin(2 * theta)
        return density * steep, envelope * (1 + ROUNDING) * 0.5 * self._steepest[row] * (1 + 1e-15)


def _steepest(theta0: FloatArray, theta1: FloatArray) -> FloatArray:
    """Largest sin(theta) cos(theta) between the angles."""
    nearest = np.clip(_QUARTER, theta0, theta1)
    return 0.5 * np.sin(2 * nearest) * (1 + 1e-15)
