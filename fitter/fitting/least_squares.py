"""Bounded least squares on normal equations in a trust region: the solver under every fit.

It never sees residuals or their Jacobian, only their sums at a vector p, which the caller makes as it likes
(:func:`fitter.fitting.polish.normal_equations`: in chunks, on all cores).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
#: Passes stop when the objective can fall by less than this many units of its value per degree of
#: freedom: 1e-6 is a thousandth of a standard error.
TOLERANCE = 1e-6
MAX_PASSES = 60
#: Products of two sums below this are numbers.
LARGEST = 1e150
#: Rounding of the residuals, relative to the fitted values.
ROUNDING = 1e-15
#: Scaled curvatures are taken to be at least this.
SINGULAR = 1e-14


class Equations(Protocol):
    """Sums over samples at one vector: Gauss-Newton matrix J^T J (P, P), descent side -J^T r (P,), and the
    objective r^T r."""

    @property
    def matrix(self) -> FloatArray: ...
    @property
    def rhs(self) -> FloatArray: ...
    @property
    def objective(self) -> float: ...


E = TypeVar("E", bound=Equations)


@dataclass(frozen=True)
class Solution(Generic[E]):
    """The end of the passes: the vector p, its sums, how many passes, whether the tolerance was met, and the
    part of the Hessian beyond J^T J (P, P) as it was learned, 0 where J^T J alone foretold better."""

    p: FloatArray
    normal: E
    passes: int
    converged: bool
    rest: FloatArray


def solve(
    equations: Callable[[FloatArray], E], p: FloatArray, lower: FloatArray, upper: FloatArray, freedom: int,
    max_passes: int = MAX_PASSES, tolerance: float = TOLERANCE, known: FloatArray | None = None,
) -> Solution[E]:  # fmt: skip
    """Gauss-Newton from p (P,) in a trust region, with bounds kept by an active set in every step.

    Parameters are measured by what they do to the fitted values: the region is |D step| <= radius, D the
    largest column norms of the Jacobian met so far (More 1978), so that a parameter that has left the place
    where it mattered does not run off. Steps that fit inside, as most do, are not damped.

    The part S of the Hessian that Gauss-Newton leaves out is learned from the gradients (Dennis, Gay and
    Welsch 1981, NL2SOL), and used as long as it foretells the objective better than J^T J alone: without it
    a model that fits badly takes fifty passes instead of eight. A step is taken only if the objective falls,
    or, where that is flat to the last digits, by how much it could still fall.

    freedom : values less parameters, at least 1: the objective over it is the unit of the tolerance.
    known : S as far as it is known beforehand, (P, P).
    """
    p = np.clip(p, lower, upper)
    now = equations(p)
    rest = np.zeros_like(now.matrix) if known is None else known
    passes, blocked, learned = 1, False, bool(rest.any())
    widest = _norms(now.matrix)

    def ended(converged: bool) -> Solution[E]:
        return Solution(p, now, passes, converged, rest if learned else np.zeros_like(rest))

    if not countable(now):
        # A lobe that a subset left to chance may overflow on all samples: no step is tried from there.
        return ended(False)
    radius = max(_length(widest * p), 1e-3 * math.sqrt(max(now.objective, 0.0))) or math.inf
    while passes < max_passes:
        own = _norms(now.matrix)
        widest = np.maximum(widest, own)
        matrix = now.matrix + rest if learned else now.matrix
        step = _step(matrix, now.rhs, p, lower, upper, _positive(own))
        damped = _length(widest * step) > radius
        if damped:
            damping = _damping(matrix, now.rhs, _positive(widest), radius)
            step = _step(matrix, now.rhs, p, lower, upper, _positive(widest), damping)
        plain = 2.0 * float(now.rhs @ step) - float(step @ now.matrix @ step)
        bent = plain - float(step @ rest @ step)
        predicted = bent if learned else plain
        if not damped and predicted <= tolerance * now.objective / freedom:
            return ended(True)
        trial = np.clip(p + step, lower, upper)
        then = equations(trial)
        passes += 1
        size = _length(widest * step)
        finite = countable(then)
        noise = ROUNDING * (now.objective + _length(own * p) * math.sqrt(max(now.objective, 0.0)))
        flat = predicted <= noise
        level = flat and then.objective <= now.objective + noise
        if finite and (then.objective < now.objective or (level and _nearer(then, now))):
            fell = now.objective - then.objective
            learned = abs(fell - bent) < abs(fell - plain)
            rest = _second_order(rest, now, then, trial - p)
            if fell > 0.75 * predicted:
                radius = max(radius, 2.0 * size)
            elif fell < 0.25 * predicted:
                radius = 0.5 * size
            p, now, blocked = trial, then, False
        elif finite and flat:
            # The step is rounding, unless it is so short because of what lies around.
            return ended(not blocked)
        elif learned:
            learned = False
        else:
            radius = (0.5 if finite else 0.1) * size
            blocked = blocked or not finite
    return ended(False)


def countable(now: Equations) -> bool:
    """Whether the sums, and products of two of them, are numbers."""
    return bool(now.objective < LARGEST and np.abs(now.matrix).max(initial=0.0) < LARGEST)


def foretold(now: Equations, p: FloatArray, lower: FloatArray, upper: FloatArray) -> float:
    """By how much an undamped Gauss-Newton step from p within the bounds would lower the objective."""
    step = _step(now.matrix, now.rhs, p, lower, upper, _positive(_norms(now.matrix)))
    return 2.0 * float(now.rhs @ step) - float(step @ now.matrix @ step)


def _nearer(then: Equations, now: Equations) -> bool:
    """Whether an undamped step could lower the objective a quarter as much as before at most."""
    before, after = (
        float(e.rhs @ _solved(e.matrix, e.rhs, _positive(_norms(e.matrix)))) for e in (now, then)
    )
    return after < 0.25 * before


def _solved(matrix: FloatArray, rhs: FloatArray, scale: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    return vectors @ ((vectors.T @ (rhs / scale)) / np.maximum(values, SINGULAR)) / scale


def _length(vector: FloatArray) -> float:
    return float(np.linalg.norm(vector))


def _norms(matrix: FloatArray) -> FloatArray:
    """(P,) column norms of the Jacobian. That of a parameter that moves nothing (the roughness of a lobe of
    no strength) is 0."""
    diagonal = np.diagonal(matrix)
    return np.sqrt(np.where(diagonal > 1e-200, diagonal, 0.0))


def _positive(norms: FloatArray) -> FloatArray:
    return np.where(norms > 0, norms, 1.0)


def _damping(matrix: FloatArray, rhs: FloatArray, scale: FloatArray, radius: float) -> float:
    """The damping that brings the scaled step of the quadratic model to the radius: by bisection of its
    logarithm on the eigenvalues, which is exact enough and can't fail."""
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    values = np.maximum(values, SINGULAR)
    along = vectors.T @ (rhs / scale)
    # With all eigenvalues 0 the step would be rhs/damping.
    low, high = math.log(1e-16), max(math.log(max(_length(along) / radius, 1e-300)), math.log(1e-15))
    for _ in range(30):
        middle = 0.5 * (low + high)
        if _length(along / (values + math.exp(middle))) > radius:
            low = middle
        else:
            high = middle
    return math.exp(high)


def _second_order(rest: FloatArray, before: Equations, after: Equations, step: FloatArray) -> FloatArray:
    """NL2SOL's update of the second-order part S so that (J^T J + S) step matches the gradients' change."""
    change = before.rhs - after.rhs  # of the half gradient, which is -rhs
    along = float(change @ step)
    if along <= 0:
        return np.zeros_like(rest)
    wanted = change - after.matrix @ step
    have = float(step @ rest @ step)
    # Sizing: S must not outlive the residuals it was learned from.
    sized = rest * min(1.0, abs(float(step @ wanted)) / abs(have)) if have != 0 else rest
    missing, unit = wanted - sized @ step, math.sqrt(along)
    # Where a parameter has come from nowhere its curvature may be beyond all numbers: nothing is learned.
    with np.errstate(over="ignore", invalid="ignore"):
        turned = change / unit
        outer = np.outer(missing / unit, turned)
        learned = sized + outer + outer.T - float(missing @ step) / along * np.outer(turned, turned)
    return learned if np.isfinite(learned).all() else np.zeros_like(rest)


def _step(
    matrix: FloatArray, rhs: FloatArray, p: FloatArray, lower: FloatArray, upper: FloatArray,
    scale: FloatArray, damping: float = 0.0,
) -> FloatArray:  # fmt: skip
    """The bounded step (P,) of the quadratic model, damped in units of ``scale``."""
    r = rhs / scale
    # min d.g.d/2 - r.d by the eigenvectors of g, which survives a singular g.
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    energies = np.maximum(values, SINGULAR) + damping
    low, high = np.minimum((lower - p) * scale, 0.0), np.maximum((upper - p) * scale, 0.0)
    d = vectors @ ((vectors.T @ r) / energies)
    if ((d < low) | (d > high)).any():
        root = np.sqrt(energies)
        a, target = root[:, None] * vectors.T, (vectors.T @ r) / root
        free = high - low > 0
        d = np.zeros_like(p)
        if free.any():
            from scipy.optimize import lsq_linear  # a third of a second, and most fits need none of it

            d[free] = lsq_linear(a[:, free], target, bounds=(low[free], high[free]), method="bvls").x
    return d / scale
