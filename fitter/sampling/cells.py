"""The envelope of a slice on a chart of the hemisphere: cells, each with its own proved majorant.

A candidate drawn uniformly by the chart's measure within a cell, the cell chosen by majorant x measure and
the candidate accepted with probability field / majorant, has density proportional to the field exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from fitter.sampling.alias import AliasTable
from fitter.sampling.envelope import Envelope, Method, SliceInfo, empty_slice, no_inversion
from fitter.sampling.majorants import Field
from fitter.sampling.refining import worth_halving

FloatArray = NDArray[np.float64]

# Gauss-Legendre points per direction: to steer the refinement, and for the integral, which on measured
# tables is then within 2e-5 of one by eight points; what is stated is some 1e-4, the sum of what cancels.
_STEER = 2
_FINAL = 3
_ROUNDS = 60
# How often cells on the rim of the measured domain are cut for the integral.
_RIM = 4
_CHUNK = 1 << 14


@dataclass(frozen=True)
class ChartSlice:
    """One incidence ``wi`` (3,) of a table that is drawn from on a chart.

    kind : of table, in words. field : of this slice and of channel weights.
    """

    wi: FloatArray
    extrapolated: bool
    kind: str
    field: Callable[[ChartSlice, FloatArray], Field]
    preferred: Method = "rejection"

    def envelope(self, weights: FloatArray, acceptance: float, cells: int, method: Method) -> Envelope:
        if method == "inversion":
            raise no_inversion(self.kind)
        return CellEnvelope(self.field(self, weights), acceptance, cells)


class CellEnvelope:
    """Cells refined until the expected acceptance reaches ``acceptance`` or there are ``cells`` of them."""

    def __init__(self, field: Field, acceptance: float, cells: int) -> None:
        self._field = field
        a, b = field.edges()
        grid = np.meshgrid(np.arange(len(a) - 1), np.arange(len(b) - 1), indexing="ij")
        i, j = (index.reshape(-1) for index in grid)
        rectangles = np.stack([a[i], a[i + 1], b[j], b[j + 1]], axis=1)
        rectangles, majorant = self._refine(rectangles, acceptance, cells)
        self._finish(rectangles, majorant)

    def _refine(self, rectangles: FloatArray, acceptance: float, most: int) -> tuple[FloatArray, FloatArray]:
        """Halve the cells that waste most, measured by measure x majorant minus the estimated mass."""
        field = self._field
        majorant = field.bound(rectangles)
        mass = self._quadrature(rectangles, _STEER)
        for _ in range(_ROUNDS):
            split = worth_halving(field.measures(rectangles) * majorant, mass, acceptance, most)
            if split is None:
                break
            fresh = _halves(rectangles[split], field.tall(rectangles[split]))
            rectangles = np.concatenate([rectangles[~split], fresh])
            majorant = np.concatenate([majorant[~split], field.bound(fresh)])
            mass = np.concatenate([mass[~split], self._quadrature(fresh, _STEER)])
        return rectangles, majorant

    def _finish(self, rectangles: FloatArray, majorant: FloatArray) -> None:
        field = self._field
        # On the rim of the measured domain the field breaks off: there the integral needs smaller cells.
        self._fine = self._rimmed(rectangles)
        self._mass = self._quadrature(self._fine, _FINAL)
        self.integral = float(self._mass.sum())
        if not self.integral > 0:
            raise empty_slice()
        keep = majorant > 0
        self._cells, self._majorant = rectangles[keep], majorant[keep]
        envelope = self._majorant * field.measures(self._cells)
        self.acceptance = min(self.integral / float(envelope.sum()), 1.0)
        self.kernel = field.kernel(AliasTable(envelope), self._cells, self._majorant, self.integral)

    @property
    def info(self) -> SliceInfo:
        """What is known of the slice; what drawing does not need is computed when it is asked for."""
        return self._info

    @cached_property
    def _info(self) -> SliceInfo:
        field = self._field
        coarse, disk, sphere = self._covered(self._fine)
        error = float(np.abs(self._mass - coarse).sum()) / self.integral
        clamped = 0.0
        if field.clamps:
            clamped = 1.0 - float(self._quadrature(self._fine, _FINAL, clamped=False).sum()) / self.integral
        return SliceInfo(
            integral=self.integral, integral_error=error, clamped_share=clamped,
            coverage=min(disk / np.pi, 1.0), blind=max(1.0 - sphere / (2 * np.pi), 0.0),
            cells=len(self._majorant), acceptance=self.acceptance, extrapolated=field.extrapolated,
            method="rejection",
        )  # fmt: skip

    def _rimmed(self, rectangles: FloatArray) -> FloatArray:
        """The cells, those of which a part is measured cut in four again and again."""
        whole: list[FloatArray] = []
        ends = np.array([-1.0, 1.0])
        for _ in range(_RIM):
            _, known = self._field.integrals(rectangles, ends, ends)
            rim = (known > 0) & (known < 4)
            whole.append(rectangles[~rim])
            tall = np.ones(int(rim.sum()), bool)
            rectangles = _halves(_halves(rectangles[rim], tall), ~np.concatenate([tall, tall]))
        return np.concatenate([*whole, rectangles])

    def values(self, wo: FloatArray) -> FloatArray:
        """(M, C) f+ of every channel at directions (M, 3), 0 outside the measured part."""
        found = self._field.channels(self._field.place(*self._field.coordinates(wo)))
        return np.where((wo[:, 2] > 0)[:, None], np.nan_to_num(found, nan=0.0), 0.0)

    def attack(self, rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
        """``(field, bound)`` at ``count`` points chosen to break the bound: sides and corners of cells."""
        cell = rng.integers(0, len(self._majorant), count)
        s, t = rng.random((2, count))
        s, t = (np.where(rng.random(count) < 0.4, np.round(x), x) for x in (s, t))
        a0, a1, b0, b1 = self._cells[cell].T
        return self._field.field(a0 + s * (a1 - a0), b0 + t * (b1 - b0)), self._majorant[cell]

    def energy_error(self) -> float:
        """Relative size of what interpolation adds to the integral, estimated."""
        points = [(a, b, weight) for a, b, weight in self._points(self._fine, _STEER)]
        return abs(sum(self._field.gain(*some) for some in points)) / self.integral

    def _points(
        self, rectangles: FloatArray, points: int
    ) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
        """Gauss-Legendre points and weights, the chart's measure included, cell by cell."""
        x, weight = _gauss(points)
        per = max(1, _CHUNK // points**2)
        for start in range(0, len(rectangles), per):
            a0, a1, b0, b1 = (side[:, None, None] for side in rectangles[start : start + per].T)
            a = 0.5 * (a0 + a1) + 0.5 * (a1 - a0) * x[None, :, None]
            b = 0.5 * (b0 + b1) + 0.5 * (b1 - b0) * x[None, None, :]
            size = 0.25 * (a1 - a0) * (b1 - b0) * np.outer(weight, weight)
            a, b = (np.broadcast_to(side, size.shape).reshape(-1) for side in (a, b))
            yield a, b, size.reshape(-1) * self._field.measure(a, b)

    def _quadrature(self, rectangles: FloatArray, points: int, *, clamped: bool = True) -> FloatArray:
        """(K,) integral of the field over each cell."""
        return self._field.integrals(rectangles, *_gauss(points), clamped=clamped)[0]

    def _covered(self, rectangles: FloatArray) -> tuple[FloatArray, float, float]:
        """As :meth:`_quadrature`, by the points that steer; what was measured, on the disk and the sphere."""
        disk = sphere = 0.0
        parts: list[FloatArray] = [np.zeros(0)]
        for a, b, weight in self._points(rectangles, _STEER):
            value = self._field.field(a, b)
            size = np.where(np.isfinite(value), self._field.solid_angle(a, b) * weight, 0.0)
            sphere += float(size.sum())
            disk += float(size @ self._field.directions(a, b)[:, 2])
            parts.append((np.nan_to_num(value, nan=0.0) * weight).reshape(-1, _STEER**2).sum(axis=1))
        return np.concatenate(parts), disk, sphere


@cache
def _gauss(points: int) -> tuple[FloatArray, FloatArray]:
    return np.polynomial.legendre.leggauss(points)


def _halves(rectangles: FloatArray, tall: NDArray[np.bool_]) -> FloatArray:
    """Both halves of each, cut across the first coordinate where ``tall``."""
    a0, a1, b0, b1 = rectangles.T
    a, b = 0.5 * (a0 + a1), 0.5 * (b0 + b1)
    first = np.stack([a0, np.where(tall, a, a1), b0, np.where(tall, b1, b)], axis=1)
    second = np.stack([np.where(tall, a, a0), a1, np.where(tall, b0, b), b1], axis=1)
    return np.concatenate([first, second])
