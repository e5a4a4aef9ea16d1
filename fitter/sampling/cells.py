"""The envelope of a slice of a grid: cells in (theta_o, azimuth), each with its own proved majorant.

cos(theta) dw = dx dy on the projected disk = d(sin^2 theta)/2 dphi, so a candidate drawn uniformly in
(sin^2 theta, phi) within a cell, the cell chosen by majorant x area and the candidate accepted with
probability f+/majorant, has density proportional to f+ cos(theta) exactly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.errors import FitError, TableError
from fitter.sampling.envelope import Candidates, SliceInfo
from fitter.sampling.majorants import Field

FloatArray = NDArray[np.float64]

# Gauss-Legendre points per direction: to steer the refinement, and for the integral.
_STEER = 2
_FINAL = 4
_FINAL_EXACT = 8
_ROUNDS = 60
_CHUNK = 1 << 18


class CellEnvelope:
    """Cells refined until the expected acceptance reaches ``acceptance`` or there are ``cells`` of them."""

    def __init__(self, field: Field, acceptance: float, cells: int) -> None:
        self._field = field
        theta, phi = field.edges()
        grid = np.meshgrid(np.arange(len(theta) - 1), np.arange(len(phi) - 1), indexing="ij")
        i, j = (index.reshape(-1) for index in grid)
        rectangles = np.stack([theta[i], theta[i + 1], phi[j], phi[j + 1]], axis=1)
        rectangles, majorant = self._refine(rectangles, acceptance, cells)
        self._finish(rectangles, majorant)

    def _refine(
        self, rectangles: FloatArray, acceptance: float, most: int
    ) -> tuple[FloatArray, FloatArray]:
        """Halve the cells that waste most, measured by area x majorant minus the estimated mass."""
        majorant = self._field.bound(rectangles)
        mass = _quadrature(self._field, rectangles, _STEER)
        for _ in range(_ROUNDS):
            total, envelope = float(mass.sum()), _areas(rectangles) * majorant
            allowed = total * (1 / acceptance - 1)
            waste = envelope - mass
            if float(waste.sum()) <= allowed or len(rectangles) >= most:
                break
            # Splitting only what is above its fair share lets the work go where the field is steep.
            fair = max(0.5 * allowed, 1e-9 * float(envelope.sum())) / len(rectangles)
            split = waste > fair
            room = most - len(rectangles)
            if np.count_nonzero(split) > room:
                worst = np.argpartition(waste, -room)[-room:]
                split = np.zeros(len(rectangles), bool)
                split[worst] = True
            if not split.any():
                break
            fresh = _halves(rectangles[split])
            rectangles = np.concatenate([rectangles[~split], fresh])
            majorant = np.concatenate([majorant[~split], self._field.bound(fresh)])
            mass = np.concatenate([mass[~split], _quadrature(self._field, fresh, _STEER)])
        return rectangles, majorant

    def _finish(self, rectangles: FloatArray, majorant: FloatArray) -> None:
        field = self._field
        points = _FINAL_EXACT if field.exact else _FINAL
        mass = _quadrature(field, rectangles, points)
        integral = float(mass.sum())
        if not integral > 0:
            raise TableError(
                "nothing can be drawn: the table's values are all zero or missing at this incidence",
                code="slice-empty", cause="a blind region, a masked slice or an incidence out of range",
                remedy="choose another incidence; the table's info lists its domain",
            )  # fmt: skip
        error = 0.0
        if not field.exact:
            error = float(np.abs(mass - _quadrature(field, rectangles, points - 1)).sum()) / integral
        clamped = 0.0
        if field.clamps:
            clamped = 1.0 - float(_quadrature(field, rectangles, points, clamped=False).sum()) / integral
        coverage = float(_quadrature(field, rectangles, _STEER, measured=True).sum()) / np.pi
        keep = majorant > 0
        self._theta0, self._theta1, self._phi0, self._phi1 = rectangles[keep].T
        self._sin2 = np.sin(self._theta0) ** 2, np.sin(self._theta1) ** 2
        self._cos2 = np.cos(self._theta0) ** 2, np.cos(self._theta1) ** 2
        self._majorant = majorant[keep]
        self._cumulative = np.cumsum(self._majorant * _areas(rectangles[keep]))
        self.info = SliceInfo(
            integral=integral, integral_error=error, clamped_share=clamped, coverage=coverage,
            cells=int(keep.sum()), acceptance=integral / float(self._cumulative[-1]),
            extrapolated=field.extrapolated,
        )  # fmt: skip

    def draw(self, rng: np.random.Generator, m: int) -> Candidates:
        """``m`` candidates in the sample's frame."""
        random = rng.random((4, m))
        cell = np.searchsorted(self._cumulative, random[0] * self._cumulative[-1], side="right")
        cell = np.minimum(cell, len(self._cumulative) - 1)
        # sin^2 and cos^2 drawn together: arcsin alone would lose half the digits at the horizon.
        sin2 = self._sin2[0][cell] + random[1] * (self._sin2[1][cell] - self._sin2[0][cell])
        cos2 = self._cos2[0][cell] + random[1] * (self._cos2[1][cell] - self._cos2[0][cell])
        theta = np.clip(np.arctan2(np.sqrt(sin2), np.sqrt(cos2)), self._theta0[cell], self._theta1[cell])
        phi = self._phi0[cell] + random[2] * (self._phi1[cell] - self._phi0[cell])
        density = self._field.density(theta, phi)
        majorant = self._majorant[cell]
        if np.any(density > majorant):
            raise FitError(
                "the interpolant exceeds its bound: the draws would not be exact", code="majorant-violated",
                cause="a defect of this library", remedy="report it with the table and the incidence",
            )  # fmt: skip
        accepted = random[3] * majorant < density  # False where the density is NaN: not measured there
        return Candidates(
            directions.vector_from_spherical(theta, phi + self._field.rotation), accepted, density
        )

    def values(self, wo: FloatArray) -> FloatArray:
        """(M, C) f+ of every channel at directions (M, 3), 0 outside the measured part."""
        theta, phi = directions.spherical_from_vector(wo)
        found = self._field.values(theta, phi - self._field.rotation)
        return np.where((wo[:, 2] > 0)[:, None], np.nan_to_num(found, nan=0.0), 0.0)


def _areas(rectangles: FloatArray) -> FloatArray:
    """Projected areas: d(sin^2 theta)/2 dphi, the difference of squares written without cancellation."""
    theta0, theta1, phi0, phi1 = rectangles.T
    return 0.5 * np.sin(theta1 - theta0) * np.sin(theta1 + theta0) * (phi1 - phi0)


def _halves(rectangles: FloatArray) -> FloatArray:
    """Both halves of each, cut across the longer side as seen on the sphere."""
    theta0, theta1, phi0, phi1 = rectangles.T
    tall = theta1 - theta0 >= np.sin(theta1) * (phi1 - phi0)
    theta, phi = 0.5 * (theta0 + theta1), 0.5 * (phi0 + phi1)
    first = np.stack([theta0, np.where(tall, theta, theta1), phi0, np.where(tall, phi1, phi)], axis=1)
    second = np.stack([np.where(tall, theta, theta0), theta1, np.where(tall, phi0, phi), phi1], axis=1)
    return np.concatenate([first, second])


def _quadrature(
    field: Field, rectangles: FloatArray, points: int, *, clamped: bool = True, measured: bool = False
) -> FloatArray:
    """(K,) integral of the field (or of 1 where ``measured``) times cos(theta) over each cell."""
    x, weight = np.polynomial.legendre.leggauss(points)
    # Bilinear fields are linear in azimuth on a cell: its midpoint is exact.
    y, across = (np.zeros(1), np.full(1, 2.0)) if field.exact else (x, weight)
    total = np.zeros(len(rectangles))
    per = max(1, _CHUNK // (points * len(y)))
    for start in range(0, len(rectangles), per):
        theta0, theta1, phi0, phi1 = (side[:, None, None] for side in rectangles[start : start + per].T)
        theta = 0.5 * (theta0 + theta1) + 0.5 * (theta1 - theta0) * x[None, :, None]
        phi = 0.5 * (phi0 + phi1) + 0.5 * (phi1 - phi0) * y[None, None, :]
        theta, phi = np.broadcast_arrays(theta, phi)
        value = field.density(theta.reshape(-1), phi.reshape(-1), clamped=clamped).reshape(theta.shape)
        value = np.isfinite(value).astype(np.float64) if measured else np.nan_to_num(value, nan=0.0)
        jacobian = 0.25 * (theta1 - theta0) * (phi1 - phi0) * 0.5 * np.sin(2 * theta)
        part = np.einsum("kij,i,j->k", value * jacobian, weight, across)
        total[start : start + per] = part
    return total
