"""How far a search may have stopped from the optimum of its model over the whole table."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import special

from fitter.fitting.layout import Layout
from fitter.fitting.polish import Polished, bounds, further_fall

FloatArray = NDArray[np.float64]
#: Curvatures below this share of the largest are directions that the data leave open.
OPEN = 1e-12
LEVEL = 0.95


def search_error(
    layout: Layout, end: Polished, scores: FloatArray, left_out: float | None
) -> float:
    """By what share of itself the rms residual is above that at the optimum on the same table.

    scores : (P, P) sums of outer products of the samples' scores.

    After passes over the whole table (``left_out`` None) it is what one more step would gain. After a subset
    that leaves out this share of the table it is the 95 % point of what the choice of samples does: with the
    curvature H and the samples' scores s, the optimum of the subset is off by H^-1 sum s, which raises the
    objective by tr(H^-1 sum s s^T) on average. That says nothing of another, better basin.
    """
    objective = end.normal.objective
    if objective <= 0:
        return 0.0
    if left_out is None:
        return rms_share(max(0.0, further_fall(layout, end)) / objective)
    rise, count = _expected_rise(layout, end, scores)
    if count == 0:
        return 0.0
    # As if all directions counted alike: then the rise is a chi-square of so many degrees of freedom.
    worst = at_most(count) / count
    return rms_share(left_out * rise * worst / objective)


def at_most(freedom: int) -> float:
    """The 95 % point of a chi-square of so many degrees of freedom."""
    return float(special.chdtri(freedom, 1.0 - LEVEL))


def rms_share(objective_share: float) -> float:
    """The relative rise of a root mean square, from that of the mean square."""
    return objective_share / (1.0 + float(np.sqrt(1.0 + objective_share)))


def _expected_rise(layout: Layout, end: Polished, outer: FloatArray) -> tuple[float, int]:
    """tr(H^-1 sum s s^T) over the parameters that are inside their bounds, and how many directions count."""
    lower, upper = bounds(layout, len(end.p))
    where = np.flatnonzero((end.p > lower) & (end.p < upper))
    matrix, scores = (part[np.ix_(where, where)] for part in (end.normal.matrix, outer))
    scale = np.sqrt(np.maximum(np.diagonal(matrix), 0.0))
    scale = np.where(scale > 0, scale, np.inf)
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    known = values > OPEN * max(values.max(initial=0.0), 1e-300)
    turned = vectors[:, known].T @ (scores / np.outer(scale, scale)) @ vectors[:, known]
    return float(np.sum(np.diagonal(turned) / values[known])), int(known.sum())
