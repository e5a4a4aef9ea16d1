"""The global search: many candidates screened on a subset, the best distinct ones solved."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitter.errors import FitError
from fitter.fitting import beam, blockwise, candidates, separable
from fitter.fitting.layout import Layout

FloatArray = NDArray[np.float64]
#: Starts within this relative objective of the best have found the same optimum.
AGREE = 1e-6


@dataclass(frozen=True)
class Basin:
    """One local optimum: search coordinates (T,), inner vector (M, C), objective on the subset."""

    u: FloatArray
    inner: FloatArray
    objective: float


def search(
    layout: Layout, pair: FloatArray, y: FloatArray, weight: FloatArray, starts: int | None, seed: int
) -> tuple[list[Basin], dict[str, Any]]:
    """Distinct basins, best first, and the evidence: how many starts agree and how far the next one is."""
    t = len(layout.entries)
    if t == 0:
        b = separable.inner(layout, jnp.zeros(0), pair, y, weight)
        r = separable.residuals(layout, jnp.zeros(0), pair, y, weight)
        only = Basin(np.zeros(0), np.asarray(b), float(jnp.sum(r * r)))
        return [only], {"candidates": 1, "starts": 1, "agree": 1, "second_basin": None}
    # Where channels have parameters of their own, what is screened is one channel's.
    count, solves = candidates.default_counts(len(layout.free))
    solves = starts if starts is not None else solves
    solve = blockwise.solve if layout.mixed else functools.partial(_solve, max(count, 4 * solves))
    u, cost, b, screened = solve(layout, pair, y, weight, solves, seed)
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
        "candidates": screened, "scanned": t == 1, "starts": len(u), "agree": agree,
        "second_basin": float(basins[1].objective / best - 1.0) if len(basins) > 1 and best > 0 else None,
    }  # fmt: skip
    return basins, evidence


def _solve(
    count: int, layout: Layout, pair: FloatArray, y: FloatArray, weight: FloatArray, solves: int, seed: int
) -> tuple[FloatArray, FloatArray, FloatArray, int]:
    """Local optima from the best of ``count`` candidates: u (S, T), objective (S,), inner (S, M, C)."""
    low, high = layout.box
    if len(low) == 1:
        # A scan: every local minimum of it is looked into, and narrow ones need all samples to be seen.
        tried = low + (high - low) * candidates.scan(max(count, candidates.NODES))
        cost = np.asarray(separable.screen(layout, tried, pair, y, weight)).sum(axis=1)
        begin = tried[candidates.minima(cost, solves)]
    else:
        cube = candidates.sobol(len(low), count, seed)
        tried = low + (high - low) * cube
        # Pseudo-samples are few, and no two are alike.
        stride = candidates.stride(pair.shape[1]) if len(pair) == 6 else 1
        part = (pair[:, ::stride], y[::stride], weight[::stride])
        cost = np.asarray(separable.screen(layout, tried, *part)).sum(axis=1)
        begin = tried[candidates.distinct(cube, cost, solves)]
    grown = beam.candidates(layout, pair, y, weight, solves)
    if grown is not None:
        # Two thirds of the starts: the beam's resolution is its library's, the others have none.
        begin = np.concatenate([grown[: solves - solves // 3], begin])[:solves]
    u, objective, inner = separable.solve_many(layout, begin, pair, y, weight)
    return u, objective, inner, len(tried)
