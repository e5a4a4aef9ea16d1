"""The global search: many candidates screened on a subset, the best distinct ones solved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from fitter.errors import FitError
from fitter.fitting import beam, separable
from fitter.fitting.layout import Layout

FloatArray = NDArray[np.float64]
#: Samples that candidates are screened on; the solves use the whole subset.
SCREEN_SAMPLES = 1024
#: Starts within this relative objective of the best have found the same optimum.
AGREE = 1e-6


@dataclass(frozen=True)
class Basin:
    """One local optimum: search coordinates (T,), coefficients (K, C), objective on the subset."""

    u: FloatArray
    coefficients: FloatArray
    objective: float


def default_counts(dimensions: int) -> tuple[int, int]:
    """(candidates to screen, starts to solve) for T nonlinear parameters.

    Measured shares of starts that reach the global optimum of this reduced problem: 0.97, 1.00 and 0.67
    for one to three Lafortune lobes, so that 41 full or 6 reduced starts give 99.9 %; these are more.
    """
    return {0: (1, 1), 1: (48, 3), 2: (192, 6)}.get(dimensions, (384, 12 if dimensions <= 4 else 20))


def search(
    layout: Layout, pair: FloatArray, y: FloatArray, weight: FloatArray, starts: int | None, seed: int
) -> tuple[list[Basin], dict[str, Any]]:
    """Distinct basins, best first, and the evidence: how many starts agree and how far the next one is."""
    t = len(layout.free)
    count, solves = default_counts(t)
    solves = starts if starts is not None else solves
    if t == 0:
        b = separable.coefficients(layout, jnp.zeros(0), pair, y, weight)
        r = separable.residuals(layout, jnp.zeros(0), pair, y, weight)
        only = Basin(np.zeros(0), np.asarray(b), float(jnp.sum(r * r)))
        return [only], {"candidates": 1, "starts": 1, "agree": 1, "second_basin": None}
    low, high = layout.box
    count = max(count, 4 * solves)
    cube = qmc.Sobol(t, rng=np.random.default_rng(seed)).random(1 << (count - 1).bit_length())
    candidates = low + (high - low) * cube
    stride = max(1, pair.shape[1] // SCREEN_SAMPLES)
    objective = np.asarray(
        separable.screen(layout, jnp.asarray(candidates), pair[:, ::stride], y[::stride], weight[::stride])
    )
    begin = candidates[_distinct(cube, objective, solves)]
    grown = beam.candidates(layout, pair, y, weight, solves)
    if grown is not None:
        # Two thirds of the starts: the beam's resolution is its library's, the others have none.
        begin = np.concatenate([grown[: solves - solves // 3], begin])[:solves]
    u, cost, b = (np.asarray(a) for a in separable.solve_many(layout, begin, pair, y, weight))
    ok = np.isfinite(cost) & np.isfinite(u).all(axis=1) & np.isfinite(b).all(axis=(1, 2))
    if not ok.any():
        raise FitError(
            f"the objective of {layout.spec.name} is not finite anywhere", code="not-finite",
            cause="values or weights near the limits of floating point, or a single absurd value",
            remedy="look at the table's largest value and smallest sigma",
        )  # fmt: skip
    order = np.flatnonzero(ok)[np.argsort(cost[ok])]
    best = cost[order[0]]
    basins: list[Basin] = []
    for k in order:
        if all(cost[k] - other.objective > AGREE * max(best, 1e-300) for other in basins):
            basins.append(Basin(u[k], b[k], float(cost[k])))
    agree = int(np.sum(cost[order] - best <= AGREE * max(best, 1e-300)))
    evidence: dict[str, Any] = {
        "candidates": len(candidates), "starts": len(begin), "agree": agree,
        "second_basin": float(basins[1].objective / best - 1.0) if len(basins) > 1 and best > 0 else None,
    }  # fmt: skip
    return basins, evidence


def _distinct(cube: FloatArray, objective: FloatArray, count: int) -> NDArray[np.intp]:
    """The best candidates of which no two lie close together in the unit cube, then simply the best."""
    order = np.argsort(np.where(np.isfinite(objective), objective, np.inf))
    apart = 0.5 * len(cube) ** (-1.0 / cube.shape[1])
    chosen: list[int] = []
    for k in order:
        if len(chosen) == count:
            break
        if all(np.max(np.abs(cube[k] - cube[j])) > apart for j in chosen):
            chosen.append(int(k))
    rest = [int(k) for k in order if k not in set(chosen)]
    return np.array(chosen + rest[: max(0, count - len(chosen))], dtype=np.intp)
