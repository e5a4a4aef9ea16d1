"""NLopt as a second, independent solver: its own global search and its own local method.

It shares with the first solver the model and the sums over the data, and nothing of the search or of the
steps: agreement of the two is evidence that neither stopped early.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import nlopt
import numpy as np
from numpy.typing import NDArray

from fitter.errors import FitError
from fitter.fitting import separable
from fitter.fitting.blocks import Blocks
from fitter.fitting.layout import Layout
from fitter.fitting.polish import Normal, Polished, bounds, normal_equations
from fitter.fitting.search import Basin
from fitter.spec import Metric

FloatArray = NDArray[np.float64]


def search(
    layout: Layout, pair: FloatArray, y: FloatArray, weight: FloatArray, starts: int | None, seed: int
) -> tuple[list[Basin], dict[str, Any]]:
    """Multi-level single linkage (DIRECT-L for one parameter) on the reduced problem, then SBPLX."""
    t = len(layout.entries)
    low, high = layout.box
    reduced = jax.jit(lambda u: jnp.sum(jnp.square(separable.residuals(layout, u, pair, y, weight))))
    evaluations = 0

    def objective(z: FloatArray, grad: FloatArray) -> float:
        nonlocal evaluations
        evaluations += 1
        value = float(reduced(jnp.asarray(low + (high - low) * z)))
        return value if np.isfinite(value) else 1e300

    z = np.full(t, 0.5)
    if t:
        nlopt.srand(seed % 2**31)
        locally = nlopt.opt(nlopt.LN_SBPLX, t)
        locally.set_maxeval(300 * t)
        locally.set_xtol_abs(1e-7)
        if t == 1:
            globally = nlopt.opt(nlopt.GN_DIRECT_L, t)
            globally.set_maxeval(200 * (starts or 1))
        else:
            globally = nlopt.opt(nlopt.G_MLSL_LDS, t)
            globally.set_local_optimizer(locally)
            globally.set_population(16)
            globally.set_maxeval((starts or 10) * 300 * t)
        for method in (globally, locally):
            method.set_lower_bounds(np.zeros(t))
            method.set_upper_bounds(np.ones(t))
            method.set_min_objective(objective)
            z = method.optimize(z)
    u = low + (high - low) * z
    b = np.asarray(separable.inner(layout, jnp.asarray(u), pair, y, weight))
    best = float(reduced(jnp.asarray(u)))
    return [Basin(u, b, best)], {"candidates": evaluations, "starts": 1, "agree": 1, "second_basin": None}


def polish(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, blocks: Blocks
) -> Polished:
    """SLSQP on the full objective and its exact gradient, in units of each parameter's curvature."""
    lower, upper = bounds(layout, len(p))
    p = np.clip(p, lower, upper)
    last: list[tuple[FloatArray, Normal]] = [(p, normal_equations(layout, metric, floor, p, blocks))]
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(last[0][1].matrix), 1e-300))
    # A coefficient at 0 or a flat direction would make the unit infinite.
    scale = np.minimum(scale, 1e3 * np.maximum(np.abs(p), 1e-3))
    unit = max(last[0][1].objective, 1e-300)
    passes = 1

    def objective(z: FloatArray, grad: FloatArray) -> float:
        nonlocal passes
        passes += 1
        at = np.clip(z * scale, lower, upper)
        normal = normal_equations(layout, metric, floor, at, blocks)
        if grad.size:
            grad[:] = -2.0 * normal.rhs * scale / unit
        if normal.objective < last[0][1].objective:
            last[0] = (at, normal)
        return normal.objective / unit

    converged = True
    for _ in range(3):  # restarts: SLSQP's own model of the curvature goes stale
        before = last[0][1].objective
        method = nlopt.opt(nlopt.LD_SLSQP, len(p))
        method.set_lower_bounds(lower / scale)
        method.set_upper_bounds(upper / scale)
        method.set_min_objective(objective)
        method.set_ftol_rel(1e-15)
        method.set_xtol_rel(1e-12)
        method.set_maxeval(200)
        try:
            method.optimize(np.clip(last[0][0] / scale, lower / scale, upper / scale))
        except nlopt.RoundoffLimited:
            converged = True
        except (RuntimeError, ValueError) as error:
            raise FitError(
                f"NLopt's SLSQP stopped: {error}", code="solver-failed", remedy="use the default solver"
            ) from error
        else:
            converged = method.last_optimize_result() != nlopt.MAXEVAL_REACHED
        if before - last[0][1].objective <= 1e-12 * before:
            break
    return Polished(last[0][0], last[0][1], passes, converged, np.zeros_like(last[0][1].matrix))
