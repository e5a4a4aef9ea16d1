"""What choosing a subset of the samples does to the estimates, in standard errors of a fit to all of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fitter.fitting.covariance import Curvature, natural
from fitter.fitting.layout import Layout
from fitter.fitting.sums import Scores

FloatArray = NDArray[np.float64]


def selection_error(
    layout: Layout, curve: Curvature, weighted: Scores, alone: Scores, channels: Sequence[int],
    likelihood: bool,
) -> FloatArray:  # fmt: skip
    """(Q,) standard deviation that the choice of samples causes, over the estimate's standard error.

    A sample that stands for w others was chosen with probability 1/w. The subset's sum of scores, S = sum w
    s, estimates the table's with the variance sum w (w - 1) s s^T (Horvitz and Thompson 1952, J. Am. Stat.
    Assoc. 47, 663, of samples chosen independently), and the optimum moves by H^-1 S. The standard error is
    the one that a fit to the whole table would state: from the curvature where the metric is the likelihood,
    else the sandwich with sum w s s^T for the table's sum s s^T.

    weighted, alone : sums of (w s)(w s)^T and of w s s^T. NaN where no uncertainty is stated.
    """
    chosen = weighted._replace(outer=weighted.outer - alone.outer)
    whole = natural(layout, curve, alone, channels, likelihood)
    moved = natural(layout, curve, chosen, channels, False)
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = np.maximum(np.diagonal(moved.covariance), 0.0) / np.diagonal(whole.covariance)
    return np.sqrt(variance)
