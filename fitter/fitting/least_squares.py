"""Bounded, damped least squares on normal equations: the solver under every fit.

It never sees residuals or their Jacobian, only their sums at a vector p, which the caller makes as it likes
(:func:`fitter.fitting.polish.normal_equations`: in chunks, on all cores).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

FloatArray = NDArray[np.float64]
#: Passes stop when the objective can fall by less than this many units of its value per degree of
#: freedom: 1e-6 is a thousandth of a standard error.
TOLERANCE = 1e-6
MAX_PASSES = 60


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
    """The end of the passes: the vector p, its sums, how many passes, whether the tolerance was met."""

    p: FloatArray
    normal: E
    passes: int
    converged: bool


def solve(
    equations: Callable[[FloatArray], E], p: FloatArray, lower: FloatArray, upper: FloatArray, freedom: int,
    max_passes: int = MAX_PASSES, tolerance: float = TOLERANCE,
) -> Solution[E]:  # fmt: skip
    """Levenberg-Marquardt from p (P,) with bounds kept by an active set in every step.

    The part of the Hessian that Gauss-Newton leaves out is learned from the gradients (Dennis, Gay and
    Welsch 1981, NL2SOL): without it a model that fits badly takes fifty passes instead of eight. A step
    is taken only if the objective falls, whatever approximation made it.

    freedom : values less parameters, at least 1: the objective over it is the unit of the tolerance.
    """
    p = np.clip(p, lower, upper)
    now = equations(p)
    damping, passes = 0.0, 1
    rest = np.zeros_like(now.matrix)
    while passes < max_passes:
        step, predicted = _step(now.matrix + rest, now.rhs, p, lower, upper, damping)
        if predicted <= tolerance * now.objective / freedom:
            return Solution(p, now, passes, True)
        trial = np.clip(p + step, lower, upper)
        then = equations(trial)
        passes += 1
        if np.isfinite(then.objective) and then.objective < now.objective:
            rest = _second_order(rest, now, then, trial - p)
            p, now = trial, then
            damping = 0.0 if damping < 1e-6 else damping / 10
        elif np.max(np.abs(step) / (np.abs(p) + 1e-12)) < 1e-13:
            # The step is rounding: the objective is flat to the last digit.
            return Solution(p, now, passes, True)
        else:
            rest = np.zeros_like(rest)
            damping = max(damping * 10, 1e-4)
            if damping > 1e12:
                return Solution(p, now, passes, False)
    return Solution(p, now, passes, False)


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
    missing = wanted - sized @ step
    outer = np.outer(missing, change) / along
    return sized + outer + outer.T - float(missing @ step) / along**2 * np.outer(change, change)


def _step(
    matrix: FloatArray, rhs: FloatArray, p: FloatArray, lower: FloatArray, upper: FloatArray, damping: float
) -> tuple[FloatArray, float]:
    """The bounded damped step of the quadratic model and by how much the objective falls along it."""
    diagonal = np.diagonal(matrix)
    # A parameter that moves nothing (the roughness of a lobe of no strength) has no curvature.
    scale = np.sqrt(np.where(diagonal > 1e-200, diagonal, 1.0))
    g = matrix / np.outer(scale, scale)
    r = rhs / scale
    # min d.g.d/2 - r.d as least squares on the eigenvectors of g, which survives a singular g.
    values, vectors = np.linalg.eigh(g)
    root = np.sqrt(np.maximum(values, 1e-14) + damping)
    a = root[:, None] * vectors.T
    target = (vectors.T @ r) / root
    room = (np.minimum((lower - p) * scale, 0.0), np.maximum((upper - p) * scale, 0.0))
    free = room[1] - room[0] > 0
    d = np.zeros_like(p)
    if free.any():
        found = lsq_linear(a[:, free], target, bounds=(room[0][free], room[1][free]), method="bvls")
        d[free] = found.x
    return d / scale, float(2.0 * r @ d - np.square(np.sqrt(np.maximum(values, 0.0)) * (vectors.T @ d)).sum())
