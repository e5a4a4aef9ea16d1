"""Lobes of Lafortune's model sought one by one, each beside the others: what a search of all at once misses.

From the best optimum known every lobe in turn is taken out, and the best one in its place is looked for
everywhere (:mod:`fitter.fitting.lobe_scan`); from the best few all lobes together are solved on the reduced
problem, until no exchange gains anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitter.fitting import candidates
from fitter.fitting.layout import Layout
from fitter.fitting.lobe_scan import LEAST, Beside, Polar, scan
from fitter.spec import FitSpec

FloatArray = NDArray[np.float64]
#: Samples, at most, that this is worth its time for.
MOST = 20_480
#: The usual subset: a fit that is to look at less is to be fast.
SUBSET = 4096
#: Places that each lobe is tried at, rounds of exchanges, steps and sweeps of a descent, at most.
TRIED, ROUNDS, STEPS, SWEEPS = 12, 6, 40, 3
#: How far a column may turn within a cell of the scans: first to find the basins, then to tell them apart.
STEPS_OF_SCANS = (0.4, 0.15)
#: The gain of a place, in units of the known one, from which a descent may reach more.
REACHED = 0.3
#: Where every lobe gains more, in units of the objective per degree of freedom, one round of scans is enough.
STRONG = 400.0
#: What counts as a gain, in units of the objective per degree of freedom.
GAIN = 1e-3


@dataclass(frozen=True)
class _Problem:
    """One channel: the samples as lobes see them, weighted values (n,), and the weighted diffuse column."""

    polar: Polar
    target: FloatArray
    diffuse: FloatArray | None
    low: FloatArray
    high: FloatArray

    def columns(self, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Columns (K, n), the diffuse one first, each lobe's largest entry 1; the lobes' slopes by (gamma,
        ln n), (L, 2, n); and the logarithm of what the columns were divided by (K,); for lobes u (L, 2)."""
        columns = [] if self.diffuse is None else [self.diffuse]
        slopes = np.empty((len(u), 2, len(self.target)))
        scale = [0.0] * len(columns)
        for k, (gamma, log_n) in enumerate(u):
            n = np.exp(log_n)
            angle = self.polar.phi + gamma
            cosine = np.cos(angle)
            some = cosine > 1e-9
            cosine = np.where(some, cosine, 1.0)
            log_b = np.log(cosine) + self.polar.log_r
            log_c = np.where(some, n * log_b + self.polar.log_w, -np.inf)
            # The coefficients of a lobe are divided by the largest of them.
            lead = np.log(max(abs(np.cos(gamma)), abs(np.sin(gamma))))
            top = log_c.max()
            held = np.isfinite(top) and top - n * lead > LEAST
            columns.append(np.exp(log_c - top) if held else np.zeros(len(cosine)))
            scale.append(float(top - n * lead + np.log((n + 2.0) / (2 * np.pi))) if held else 0.0)
            slopes[k, 0] = columns[-1] * np.where(some, -n * np.sin(angle) / cosine, 0.0)
            slopes[k, 1] = columns[-1] * n * np.where(some, log_b, 0.0)
        return np.stack(columns), slopes, np.array(scale)

    def coefficients(self, u: FloatArray) -> FloatArray:
        """The best coefficients (K,) of the model's terms."""
        columns, _, scale = self.columns(u)
        return self.solved(columns).coefficients * np.exp(-scale)

    def solved(self, columns: FloatArray) -> _Solved:
        """The best non-negative combination of columns (K, n)."""
        from scipy.optimize import nnls  # a third of a second, and most fits exchange no lobes

        q, r = np.linalg.qr(columns.T)
        b, _ = nnls(r, q.T @ self.target)
        residual = self.target - b @ columns
        return _Solved(b, residual, float(residual @ residual))

    def descended(self, u: FloatArray) -> tuple[FloatArray, float]:
        """The local optimum (L, 2) of the reduced objective from u, and the objective there.

        Where an edge of a lobe lies at a sample the objective has a kink, which holds a step in all
        parameters back: each is moved alone, too, as long as that gains something.
        """
        every = np.ones(u.size, bool)
        u, least = self._descended(u, every)
        for _ in range(SWEEPS):
            before = least
            for k in range(u.size):
                u, least = self._descended(u, np.arange(u.size) == k)
            if before - least <= 0.1 * GAIN * least / len(self.target):
                break
            u, least = self._descended(u, every)
        return u, least

    def _descended(self, u: FloatArray, moving: NDArray[np.bool_]) -> tuple[FloatArray, float]:
        """Levenberg's and Marquardt's steps with Kaufman's Jacobian (1975), which leaves out how the residual
        turns, in the parameters ``moving``."""
        u = np.clip(u, self.low, self.high)
        columns, slopes, _ = self.columns(u)
        now, damping = self.solved(columns), 1e-3
        for _ in range(STEPS):
            step, foretold = self._step(u, columns, slopes, now, damping, moving)
            if foretold <= 1e-2 * GAIN * now.objective / len(self.target):
                break
            trial = np.clip(u + step, self.low, self.high)
            then_columns, then_slopes, _ = self.columns(trial)
            then = self.solved(then_columns)
            if then.objective < now.objective:
                u, columns, slopes, now, damping = trial, then_columns, then_slopes, then, 0.1 * damping
            elif damping > 1e8:
                break
            else:
                damping *= 10.0
        return u, now.objective

    def _step(
        self, u: FloatArray, columns: FloatArray, slopes: FloatArray, now: _Solved, damping: float,
        moving: NDArray[np.bool_],
    ) -> tuple[FloatArray, float]:
        first = len(columns) - len(u)
        q = np.linalg.qr(columns[now.coefficients > 0].T)[0]
        d = (now.coefficients[first:, None, None] * slopes).reshape(-1, len(self.target))
        j = d - (d @ q) @ q.T
        gradient, curvature = j @ now.residual, j @ j.T
        step = np.zeros(len(gradient))
        free = moving & (np.square(j).sum(axis=1) > 1e-20 * max(now.objective, 1e-300))
        at_low, at_high = (u <= self.low).reshape(-1), (u >= self.high).reshape(-1)
        free &= ~(at_low & (gradient < 0)) & ~(at_high & (gradient > 0))
        if not free.any():
            return step.reshape(u.shape), 0.0
        own = curvature[np.ix_(free, free)]
        scale = np.sqrt(np.diagonal(own))
        damped = own / np.outer(scale, scale) + damping * np.eye(len(own))
        step[free] = np.linalg.solve(damped, gradient[free] / scale) / scale
        return step.reshape(u.shape), float(2 * gradient @ step - step @ curvature @ step)

    def beside(self, columns: FloatArray) -> Beside:
        """What a lobe is sought beside, of the columns (K, n) of everything else."""
        found = self.solved(columns) if len(columns) else _Solved(np.zeros(0), self.target, 0.0)
        return Beside.of(columns, found.coefficients, found.residual)


class _Solved(NamedTuple):
    coefficients: FloatArray
    residual: FloatArray
    objective: float


def improved(
    layout: Layout, pair: FloatArray, y: FloatArray, weight: FloatArray, starts: Sequence[FloatArray]
) -> tuple[FloatArray, float]:
    """The vector [u, coefficients] of the best optimum that exchanges lead to from the best of the ``starts``
    (T,), where they are :func:`wanted`, and by what share of itself they lowered the objective.

    pair : (6, n). y, weight : (n, 1), 0 for samples that don't count.
    """
    where = np.array([layout.free.index(name) for name in _names(layout)])
    low, high = (side[where].reshape(-1, 2) for side in layout.box)
    used = (weight[:, 0] > 0) & (pair[2] > 0) & (pair[5] > 0)
    w, own = weight[used, 0], pair[:, used]
    polar = Polar.of(own[2] * own[5], own[0] * own[3] + own[1] * own[4], w)
    diffuse = w / np.pi if layout.spec.diffuse == "lambert" else None
    problem = _Problem(polar, w * y[used, 0], diffuse, low, high)
    found, fell = _exchanged(problem, [start[where].reshape(-1, 2) for start in starts])
    u = np.empty(len(where))
    u[where] = found.reshape(-1)
    return np.concatenate([u, problem.coefficients(found)]), fell


def wanted(layout: Layout, request: FitSpec, samples: int, channels: int) -> bool:
    """Whether a fit with the effort of ``request`` exchanges lobes: one of isotropic cosine lobes of a single
    channel, all directions and exponents free, on all of not too many samples and with no less than the usual
    starts and subset."""
    usual = candidates.default_counts(len(layout.free))[1]
    effort = (request.starts or usual) >= usual and request.subset >= min(SUBSET, samples) and samples <= MOST
    complete = request.polish == "full" or request.subset >= samples
    own = layout.spec.family == "lafortune" and channels == 1 and request.solver == "optimistix"
    return effort and complete and own and sorted(layout.free) == sorted(_names(layout))


def _names(layout: Layout) -> list[str]:
    suffixes = [""] if layout.spec.lobes == 1 else [f"_{k + 1}" for k in range(layout.spec.lobes)]
    return [name + suffix for suffix in suffixes for name in ("gamma", "n")]


def _exchanged(problem: _Problem, starts: Sequence[FloatArray]) -> tuple[FloatArray, float]:
    best, least = min((problem.descended(start) for start in starts), key=lambda end: end[1])
    first, before_all = int(problem.diffuse is not None), least
    for step in STEPS_OF_SCANS:
        unchanged, lobe, strong = 0, 0, True
        for _ in range(ROUNDS * len(best)):
            columns, _, _ = problem.columns(best)
            others = problem.beside(np.delete(columns, first + lobe, axis=0))
            known = float(others.residual @ others.residual) - least
            found = scan(problem.polar, others, (problem.low[lobe], problem.high[lobe]), known, step)
            before, strong = least, strong and known > STRONG * least / len(problem.target)
            for place in found.best(TRIED, REACHED * known):
                trial = best.copy()
                trial[lobe] = place
                end, objective = problem.descended(trial)
                if objective < least - GAIN * least / len(problem.target):
                    best, least = end, objective
            unchanged = unchanged + 1 if least == before or len(best) == 1 else 0
            if unchanged == len(best):
                break
            lobe = (lobe + 1) % len(best)
        if strong:
            break
    return best, 1.0 - least / before_all if before_all > 0 else 0.0
