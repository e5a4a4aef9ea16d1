"""Tests of ranks and of coverage: how far they may stray by chance alone.

A rank among L draws is uniform on 0, ..., L where truth and draws come from the same posterior (S. Talts
et al., "Validating Bayesian inference algorithms with simulation-based calibration", 2018). Its empirical
distribution function is judged at every level at once (T. Saeilynoja, P. Buerkner, A. Vehtari, "Graphical
test for discrete uniformity and its applications in goodness-of-fit evaluation", 2022): the smallest of the
two-sided binomial probabilities over the levels is the statistic. Its distribution is exact here: counts
between levels are independent Poisson numbers under the condition that their sum is N.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
#: Bisections of the logarithm of a probability between 1e-12 and 1.
BISECTIONS = 45


def corrected(level: float, tests: int) -> float:
    """The level of each of so many tests that together hold at ``level`` (Sidak)."""
    return float(level ** (1.0 / tests))


def ecdf(ranks: ArrayLike, draws: int) -> IntArray:
    """(L,) how many of the ranks are at most 0, ..., L - 1."""
    return np.bincount(np.asarray(ranks, np.intp), minlength=draws + 1).cumsum()[:draws]


def p_value(ranks: ArrayLike, draws: int) -> float:
    """The probability that uniform ranks stray as far as these, at their worst level."""
    n = len(np.asarray(ranks))
    two_sided = _two_sided(n, draws)
    worst = float(two_sided[np.arange(draws), ecdf(ranks, draws)].min())
    # Rounding must not take the boundary itself for a smaller deviation.
    return float(np.clip(1.0 - _stays(n, draws, two_sided > worst * (1.0 + 1e-9)), 0.0, 1.0))


def ecdf_band(n: int, draws: int, level: float) -> tuple[IntArray, IntArray]:
    """(lowest, highest), each (L,): between which the counts of :func:`ecdf` of n uniform ranks stay, at all
    levels at once, with a probability of at least ``level``."""
    two_sided = _two_sided(n, draws)
    low, high = np.log(1e-12), 0.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if _stays(n, draws, two_sided > np.exp(middle)) >= level:
            low = middle
        else:
            high = middle
    inside = two_sided > np.exp(low)
    return inside.argmax(axis=1), n - inside[:, ::-1].argmax(axis=1)


def coverage_band(n: int, rate: float, level: float) -> tuple[int, int]:
    """(lowest, highest) number of n intervals that hold the truth, each with probability ``rate``: outside
    lies a probability of at most 1 - ``level``."""
    low, high = stats.binom.ppf([0.5 * (1.0 - level), 0.5 * (1.0 + level)], n, rate)
    return int(low), int(high)


def _two_sided(n: int, draws: int) -> FloatArray:
    """(L, n + 1) two-sided binomial probability of each count at each level."""
    at = (np.arange(draws) + 1.0)[:, None] / (draws + 1.0)
    count = np.arange(n + 1)
    below, above = stats.binom.cdf(count, n, at), stats.binom.sf(count - 1, n, at)
    return np.minimum(1.0, 2.0 * np.minimum(below, above))


def _stays(n: int, draws: int, inside: NDArray[np.bool_]) -> float:
    """The probability that the counts of n uniform ranks are ``inside`` (L, n + 1) at every level."""
    step = stats.poisson.pmf(np.arange(n + 1), n / (draws + 1.0))
    turn = np.subtract.outer(np.arange(n + 1), np.arange(n + 1))
    kernel = np.where(turn >= 0, step[np.abs(turn)], 0.0)
    now = np.zeros(n + 1)
    now[0] = 1.0
    for allowed in inside:
        now = np.where(allowed, kernel @ now, 0.0)
    return float((kernel @ now)[n] / stats.poisson.pmf(n, n))
