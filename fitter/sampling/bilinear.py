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

from functools import partial

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.kernels import bilinear
from fitter.sampling.alias import AliasTable
from fitter.sampling.arcs import moments
from fitter.sampling.drawing import Kernel
from fitter.sampling.envelope import Method, SliceInfo, empty_slice, no_inversion
from fitter.sampling.refining import worth_halving
from fitter.sampling.spherical import SphericalField

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: Covers the rounding of the interpolation (a few sums of products).
ROUNDING = 1e-9
_QUARTER = np.pi / 4
# Cells are at most so tall (radians): the series of the inversion need it.
_TALLEST = 0.13
_ROUNDS = 40
# Gauss-Legendre points per direction of fields that are powers: to steer the refinement, and in the end.
_STEER = 2
_FINAL = 5


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
        rectangles, corners = self._refine(field.cells(_TALLEST), acceptance, cells)
        self._finish(rectangles, corners, method)

    def _refine(self, rectangles: FloatArray, acceptance: float, most: int) -> tuple[FloatArray, FloatArray]:
        field = self._field
        corners = field.corners(rectangles)
        measured = np.isfinite(corners).all(axis=1)
        rectangles, corners = rectangles[measured], corners[measured]
        if self._exact:
            return rectangles, corners
        mass = self._mass(rectangles, corners, _STEER)
        for _ in range(_ROUNDS):
            split = worth_halving(_envelope(rectangles, corners), mass, acceptance, most)
            if split is None:
                break
            fresh = self._halves(rectangles[split], corners[split])
            found = field.corners(fresh)
            rectangles = np.concatenate([rectangles[~split], fresh])
            corners = np.concatenate([corners[~split], found])
            mass = np.concatenate([mass[~split], self._mass(fresh, found, _STEER)])
        return rectangles, corners

    def _halves(self, rectangles: FloatArray, corners: FloatArray) -> FloatArray:
        """Both halves of each, cut across theta where that is what the envelope loses by."""
        theta0, theta1, phi0, phi1 = rectangles.T
        theta, phi = 0.5 * (theta0 + theta1), 0.5 * (phi0 + phi1)
        if self._field.linear:
            tall = np.ones(len(rectangles), bool)
        else:
            mean = corners.mean(axis=1)
            # What the bilinear interpolant exceeds the field by half-way along theta, and along azimuth.
            along = 0.5 * (self._field.density(theta, phi0) + self._field.density(theta, phi1))
            across = 0.5 * (self._field.density(theta0, phi) + self._field.density(theta1, phi))
            steep = mean * np.abs(np.cos(2 * theta)) * (theta1 - theta0)
            tall = np.nan_to_num(mean - along + 0.5 * steep) >= np.nan_to_num(mean - across)
        first = np.stack([theta0, np.where(tall, theta, theta1), phi0, np.where(tall, phi1, phi)], axis=1)
        second = np.stack([np.where(tall, theta, theta0), theta1, np.where(tall, phi0, phi), phi1], axis=1)
        return np.concatenate([first, second])

    def _mass(
        self, rectangles: FloatArray, corners: FloatArray, points: int, *, clamped: bool = True
    ) -> FloatArray:
        """(K,) integral of the field times cos(theta) over each cell: exact where it is bilinear."""
        if self._field.linear:
            low, high = moments(rectangles[:, 0], rectangles[:, 1] - rectangles[:, 0])
            width = 0.5 * (rectangles[:, 3] - rectangles[:, 2])
            return width * (low * (corners[:, 0] + corners[:, 1]) + high * (corners[:, 2] + corners[:, 3]))
        x, weight = np.polynomial.legendre.leggauss(points)
        theta0, theta1, phi0, phi1 = (side[:, None, None] for side in rectangles.T)
        theta = 0.5 * (theta0 + theta1) + 0.5 * (theta1 - theta0) * x[None, :, None]
        phi = 0.5 * (phi0 + phi1) + 0.5 * (phi1 - phi0) * x[None, None, :]
        theta, phi = np.broadcast_arrays(theta, phi)
        value = self._field.density(theta.reshape(-1), phi.reshape(-1), clamped=clamped).reshape(theta.shape)
        jacobian = 0.25 * (theta1 - theta0) * (phi1 - phi0) * 0.5 * np.sin(2 * theta)
        return np.einsum("kij,i,j->k", value * jacobian, weight, weight)

    def _finish(self, rectangles: FloatArray, corners: FloatArray, method: Method) -> None:
        field = self._field
        mass = self._mass(rectangles, corners, _FINAL)
        integral = float(mass.sum())
        if not integral > 0:
            raise empty_slice()
        error = clamped = 0.0
        if not field.linear:
            error = float(np.abs(mass - self._mass(rectangles, corners, _FINAL - 1)).sum()) / integral
        if field.clamps:
            raw = field.corners(rectangles, clamped=False)
            clamped = 1.0 - float(self._mass(rectangles, raw, _FINAL, clamped=False).sum()) / integral
        theta0, theta1, phi0, phi1 = rectangles.T
        sphere = np.sin(0.5 * (theta1 - theta0)) * np.sin(0.5 * (theta1 + theta0)) * (phi1 - phi0) / np.pi
        disk = np.sin(theta1 - theta0) * np.sin(theta1 + theta0) * (phi1 - phi0) / (2 * np.pi)
        envelope = mass if self._exact else _envelope(rectangles, corners)
        keep = envelope > 0
        theta0, theta1, phi0, phi1 = rectangles[keep].T
        self._theta, self._height = theta0.copy(), theta1 - theta0
        self._phi, self._width = phi0.copy(), phi1 - phi0
        self._corner = corners[keep].T
        self._steepest = 2 * _steepest(theta0, theta1)
        every = np.zeros((0, 4, len(theta0)))
        if field.linear and field.count > 1:
            every = field.corners_of_channels(rectangles[keep])
        columns = [
            self._theta, self._height, self._phi + field.rotation, self._width, self._steepest, *self._corner,
            np.sin(2 * theta0), np.cos(2 * theta0), mass[keep] / (0.5 * self._width * self._height),
            *every.reshape(-1, len(theta0)),
        ]  # fmt: skip
        self.kernel = Kernel(
            partial(
                bilinear.fill, *AliasTable(envelope[keep]).boxes, np.stack(columns, axis=1),
                *field.powers(rectangles[keep]), 1 + ROUNDING, self._exact, integral,
            )
        )  # fmt: skip
        self.integral, self.acceptance = integral, integral / float(envelope.sum())
        self.info = SliceInfo(
            integral=integral, integral_error=error, clamped_share=clamped, coverage=float(disk.sum()),
            blind=max(1.0 - float(sphere.sum()), 0.0), cells=int(keep.sum()),
            acceptance=self.acceptance, extrapolated=field.extrapolated, method=method,
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
        cell = rng.integers(0, len(self._theta), count)
        s, t = rng.random((2, count))
        s, t = (np.where(rng.random(count) < 0.4, np.round(x), x) for x in (s, t))
        f00, f01, f10, f11 = (corner[cell] for corner in self._corner)
        envelope = (1 - s) * ((1 - t) * f00 + t * f01) + s * ((1 - t) * f10 + t * f11)
        theta, phi = self._theta[cell] + s * self._height[cell], self._phi[cell] + t * self._width[cell]
        # Of two cells that share a side, the one that the rounding chooses may be the other one.
        density = self._field.density(theta, phi)
        steep = 0.5 * np.sin(2 * theta)
        return density * steep, envelope * (1 + ROUNDING) * 0.5 * self._steepest[cell] * (1 + 1e-15)


def _steepest(theta0: FloatArray, theta1: FloatArray) -> FloatArray:
    """Largest sin(theta) cos(theta) between the angles."""
    nearest = np.clip(_QUARTER, theta0, theta1)
    return 0.5 * np.sin(2 * nearest) * (1 + 1e-15)


def _envelope(rectangles: FloatArray, corners: FloatArray) -> FloatArray:
    """(K,) integral of the envelope over each cell."""
    theta0, theta1, phi0, phi1 = rectangles.T
    return (theta1 - theta0) * (phi1 - phi0) * corners.mean(axis=1) * _steepest(theta0, theta1)
