"""process: the residuals of one channel as a Gaussian process over directions, judged by what it leaves out.

Scaled residuals are correlated as Matern's with smoothness 3/2 and independent beside (C. Rasmussen,
C. Williams, "Gaussian Processes for Machine Learning", 2006, ch. 2 and 5). What the parameters' uncertainty
does to the values is a part of the same process, linear in them.

A process says where every sample would lie that it was not told, alone (new directions) or with its whole
scan (new scans), and is judged by the interval score of that (T. Gneiting, A. Raftery 2007, eq. 43).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, special
from scipy.spatial import KDTree

from fitter.posterior.correlated import distances, matern
from fitter.student import coverage_factor

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]
#: So many neighbours of unit size are added to them.
PRIOR = 2.0
#: Left-out samples of like value whose misses set the width, at least and as a share of all.
ALIKE, ALIKE_SHARE = 40, 0.1
#: Fewer left-out samples judge nothing.
FEWEST = 4
#: Bands are judged at this level.
JUDGED_AT = 0.95
#: A new value is at most this many times the largest that was measured, or that the model expects: even if
#: values had no mean, P(y > t) = 1/t, one in 2 n would lie beyond.
LARGEST = 2.0
#: Added to a unit diagonal before it is factorised.
JITTER = 1e-8


@dataclass(frozen=True)
class Scale:
    """Makes residuals of one channel comparable: (y - f) / sqrt((r f)^2 + e^2), or with ``asinh``
    (asinh(y/e) - asinh(f/e)) / r, which is relative even where the two differ by orders of magnitude."""

    relative: float
    floor: float
    asinh: bool = False

    def size(self, f: FloatArray) -> FloatArray:
        """What a scaled residual of 1 is, to first order, in 1/sr, at fitted values f."""
        if self.asinh:
            return self.relative * np.hypot(f, self.floor)
        return np.hypot(self.relative * f, self.floor)

    def scaled(self, y: FloatArray, f: FloatArray) -> FloatArray:
        if self.asinh:
            return (np.arcsinh(y / self.floor) - np.arcsinh(f / self.floor)) / self.relative
        return (y - f) / self.size(f)

    def value(self, z: FloatArray, f: FloatArray) -> FloatArray:
        """The y of scaled residuals z."""
        if self.asinh:
            there = np.arcsinh(f / self.floor) + self.relative * z
            return self.floor * np.sinh(np.clip(there, -600.0, 600.0))  # as far as float64 reaches
        return f + self.size(f) * z


@dataclass(frozen=True)
class Nearby:
    """How large scaled residuals are here: root mean square of the nearest ones, whose squares (n,) are known
    at points (n, 4)."""

    at: FloatArray
    squared: FloatArray
    count: int

    def size(self, at: FloatArray) -> FloatArray:
        return self._of(at, self.at, self.squared, 0)

    def without(self, scan: IndexArray | None) -> FloatArray:
        """(n,) the size at each own point from the others' residuals, or from other scans'."""
        if scan is None:
            return self._of(self.at, self.at, self.squared, 1)
        found = np.ones(len(self.at))
        for one in np.unique(scan):
            here = scan == one
            if not here.all():
                found[here] = self._of(self.at[here], self.at[~here], self.squared[~here], 0)
        return found

    def _of(self, at: FloatArray, known: FloatArray, squared: FloatArray, skipped: int) -> FloatArray:
        if not self.count:
            return np.ones(len(at))
        count = min(self.count + skipped, len(known))
        _, nearest = KDTree(known).query(at, count)
        near = squared[np.reshape(nearest, (len(at), count))[:, skipped:]]
        return np.sqrt((near.sum(axis=1) + PRIOR) / (near.shape[1] + PRIOR))


@dataclass(frozen=True)
class Misses:
    """Left-out samples: fitted values f (n,) in increasing order, and how many standard deviations each lay
    from where it was expected (n,)."""

    f: FloatArray
    miss: FloatArray

    def reach(self, f: FloatArray, level: float) -> FloatArray:
        """(m,) standard deviations that hold a share ``level`` of the left-out samples of like value."""
        count = len(self.f)
        alike = min(count, max(ALIKE, int(ALIKE_SHARE * count)))
        rank = min(alike - 1, int(np.ceil(level * (alike + 1))) - 1)
        windows = np.lib.stride_tricks.sliding_window_view(self.miss, alike)
        found = np.partition(windows, rank, axis=1)[:, rank]
        return found[np.clip(np.searchsorted(self.f, f) - alike // 2, 0, count - alike)]


@dataclass(frozen=True)
class Process:
    """The residuals of one channel.

    scale, nearby : what they are measured by. range, share : of the correlation, the rest being independent.
    deviation : of the residuals so measured. at : (n, 4) features that it is conditioned on, and slopes :
    (n, Q) what the parameters' principal directions do to the scaled values there. factor, weights : Cholesky
    factor of the covariances there and its solution for the scaled residuals. ends : the smallest value that
    was measured, or 0, and the largest. misses : where they set the width in place of the normal
    distribution. scans : how many there were, where a new scan is predicted.
    """

    scale: Scale
    nearby: Nearby
    range: float
    share: float
    deviation: float
    at: FloatArray
    slopes: FloatArray
    factor: FloatArray
    weights: FloatArray
    ends: tuple[float, float]
    misses: Misses | None = None
    scans: int | None = None

    def band(
        self, f: FloatArray, at: FloatArray, moved: FloatArray, level: float
    ) -> tuple[FloatArray, FloatArray]:
        """(lower, upper) of new measurements at features (m, 4), where f (m,) is the fitted value and moved
        (m, Q) what the parameters do to it."""
        near = self.nearby.size(at)
        own = moved / (self.scale.size(f) * near)[:, None]
        field = self.deviation**2 * self.share * matern(distances(at, self.at) / self.range)
        cross = field + own @ self.slopes.T
        half = linalg.solve_triangular(self.factor, cross.T, lower=True)
        whole = self.deviation**2 + np.square(own).sum(axis=1)
        least = self.deviation**2 * (1.0 - self.share + JITTER)
        left = np.maximum(whole - np.square(half).sum(axis=0), least)
        half, judged = (
            _reach(f, at_level, self.misses, self.scans) * np.sqrt(left) for at_level in (level, JUDGED_AT)
        )
        return self._around(f, near, cross @ self.weights, half, judged)

    def _around(
        self, f: FloatArray, near: FloatArray, mean: FloatArray, half: FloatArray,
        judged: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        """``half`` to both sides of the mean; ``judged`` is that of ``JUDGED_AT``, where it is another."""
        least, most = self.ends[0], LARGEST * np.maximum(np.maximum(self.ends[1], f), 0.0)

        def ends(away: FloatArray) -> tuple[FloatArray, FloatArray]:
            low, high = (self.scale.value(near * (mean + side * away), f) for side in (-1.0, 1.0))
            return low, high

        # A band that is beyond as a whole knows nothing. Decided at one level, so that wider ones hold
        # narrower ones.
        low, high = ends(half if judged is None else judged)
        beyond = (high <= least) | (low >= most)
        lower, upper = (np.clip(end, least, most) for end in ends(half))
        return np.where(beyond, least, lower), np.where(beyond, most, upper)

    def misfits(self, scan: IndexArray | None) -> tuple[FloatArray, FloatArray]:
        """How far each scaled residual (n,) that it is conditioned on is from where the others, or those of
        other scans, expect it, and the standard deviation they expect (Rasmussen and Williams, eq. 5.12)."""
        if scan is None:
            diagonal = np.diagonal(self._inverse)
            return self.weights / diagonal, 1.0 / np.sqrt(diagonal)
        off, deviation = np.empty(len(scan)), np.empty(len(scan))
        for one in np.unique(scan):
            here = np.flatnonzero(scan == one)
            covariance = np.linalg.inv(self._inverse[np.ix_(here, here)])
            off[here], deviation[here] = covariance @ self.weights[here], np.sqrt(np.diagonal(covariance))
        return off, deviation

    @cached_property
    def _inverse(self) -> FloatArray:
        return np.asarray(linalg.cho_solve((self.factor, True), np.eye(len(self.factor))), np.float64)

    def left_out(
        self, y: FloatArray, f: FloatArray, scan: IndexArray | None
    ) -> tuple[Process, float]:
        """The process with the width that does best for the samples (n,) it is conditioned on, each predicted
        from the others or (scan given) from other scans; and the interval score of that."""
        scans = None if scan is None else len(np.unique(scan))
        off, deviation = self.misfits(None if scan is None else scan[: len(f)])
        near = self.nearby.without(scan)[: len(f)]
        told = self.scale.scaled(y, f)
        mean = told / self.nearby.size(self.at) - off
        miss = np.abs(told / near - mean) / deviation
        order = np.argsort(f, kind="stable")
        ordered = Misses(f[order], miss[order])
        if len(f) < FEWEST:
            return replace(self, scans=scans), 0.0
        # A sample must not set the width that it is judged by: every other one does.
        seen = np.empty(len(f))
        for part, rest in ((slice(0, None, 2), slice(1, None, 2)), (slice(1, None, 2), slice(0, None, 2))):
            others = Misses(ordered.f[rest], ordered.miss[rest])
            seen[order[part]] = _reach(ordered.f[part], JUDGED_AT, others, scans)
        scores = [
            interval_score(*self._around(f, near, mean, reach * deviation), y)
            for reach in (_reach(f, JUDGED_AT, None, scans), seen)
        ]
        misses = ordered if scores[1] < scores[0] else None
        return replace(self, misses=misses, scans=scans), min(scores)


def _reach(f: FloatArray, level: float, misses: Misses | None, scans: int | None) -> FloatArray:
    """(m,) how many standard deviations a band of ``level`` reaches at fitted values f."""
    upper = 0.5 + 0.5 * level
    normal = float(special.ndtri(upper))
    reach = np.full(len(f), normal) if misses is None else misses.reach(f, level)
    if scans is None:
        return reach
    # Left-out scans are farther from the others than those between measured ones: what they missed by may
    # widen a band, and not narrow it. Scans miss as a whole: they are the evidence of how far, and few.
    return np.maximum(reach, normal) * (float(coverage_factor(max(scans - 1, 1), level)) / normal)


def interval_score(lower: FloatArray, upper: FloatArray, y: FloatArray) -> float:
    """The mean interval score of 95 % intervals; smaller is better."""
    outside = np.maximum(lower - y, 0.0) + np.maximum(y - upper, 0.0)
    return float(np.mean(upper - lower + 2.0 / (1.0 - JUDGED_AT) * outside))


def conditioned(
    scale: Scale, nearby: Nearby, z: FloatArray, f: FloatArray, at: FloatArray, moved: FloatArray,
    distance: FloatArray, reach: float, share: float, ends: tuple[float, float],
) -> Process:  # fmt: skip
    n = len(z)
    matrix = share * matern(distance / reach) + (1.0 - share + JITTER) * np.eye(n)
    half = linalg.solve_triangular(np.linalg.cholesky(matrix), z, lower=True)
    deviation = float(np.sqrt(max(float(half @ half), 1e-300) / n))
    own = moved / (scale.size(f) * nearby.size(at))[:, None]
    factor = np.asarray(np.linalg.cholesky(deviation**2 * matrix + own @ own.T), np.float64)
    weights = linalg.cho_solve((factor, True), z)
    return Process(scale, nearby, reach, share, deviation, at, own, factor, weights, ends)
