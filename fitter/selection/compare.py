"""Comparing models: differences between folds, the rule of one standard error, an information criterion."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter.student import coverage_factor

FloatArray = NDArray[np.float64]

#: Two models whose errors differ by less than this are the same for every purpose.
SAME = 0.01
#: A model this much worse than the best is never taken for it, however uncertain the difference is.
TOLERATED = 0.10
#: Of differences in the information criterion, as much as nobody calls evidence.
NO_EVIDENCE = 2.0
#: Samples that the correlation of residuals is found from, and classes of distance.
_PAIRED, _CLASSES = 800, 40


@dataclass(frozen=True)
class Difference:
    """The ratio of two errors, a/b, over K folds: its geometric mean, the standard error of the logarithm,
    and the 95 % interval of the mean by Student's t with K - 1 degrees of freedom."""

    ratio: float
    log_error: float
    lower: float
    upper: float


def difference(a: FloatArray, b: FloatArray) -> Difference:
    """Of errors (K,) in the same folds. Ratios, because errors differ between folds more than between models.

    The folds share most of what is fitted to, so their ratios are not independent: no estimate of the spread
    is without bias (Bengio and Grandvalet 2004), and this one is typically too narrow.
    """
    d = np.log(a) - np.log(b)
    mean, error = float(d.mean()), float(d.std(ddof=1) / math.sqrt(len(d)))
    reach = float(coverage_factor(len(d) - 1, 0.95)) * error
    return Difference(_exp(mean), error, _exp(mean - reach), _exp(mean + reach))


def score(errors: FloatArray) -> float:
    """The geometric mean of the errors (K,) of the folds."""
    return _exp(float(np.log(errors).mean()))


def as_good(found: Difference) -> bool:
    """Whether a model is as good as the best: within one standard error of it, or within 1 %, and in no case
    more than 10 % worse."""
    allowed = min(max(found.log_error, math.log1p(SAME)), math.log1p(TOLERATED))
    return math.log(found.ratio) <= allowed


def effective_samples(residuals: FloatArray, features: FloatArray, seed: int) -> float:
    """How many independent samples residuals (n, C) at points (n, d) are worth, per channel.

    n/(1 + (n - 1) r), r the mean correlation of pairs: the size of an independent sample whose mean is known
    as well. The correlation is taken as a function of the distance of two points alone, up to the distance
    where it is no longer there, and only where it stands out from chance.
    """
    n = len(residuals)
    if n < 3:
        return float(n)
    some = np.sort(np.random.default_rng(seed).choice(n, min(n, _PAIRED), replace=False))
    z = residuals[some] / np.maximum(np.sqrt(np.mean(np.square(residuals[some]), axis=0)), 1e-300)
    product = (z @ z.T) / z.shape[1]
    i, j = np.triu_indices(len(some), 1)
    at = features[some]
    distance = np.sqrt(np.square(at[i] - at[j]).sum(axis=1))
    order = np.argsort(distance)
    correlated = 0.0
    for part in np.array_split(product[i, j][order], _CLASSES):
        mean = float(part.mean()) if len(part) else 0.0
        if mean <= 3.0 / math.sqrt(max(len(part), 1)):
            break
        correlated += mean * len(part)
    return n / (1.0 + (n - 1) * correlated / len(distance))


def information_criterion(error: float, parameters: int, values: float) -> float:
    """BIC of a model with root mean square residual ``error``: n ln(error^2) + k ln n, n = ``values`` the
    effective number of them (Schwarz 1978, the residuals' variance unknown)."""
    n = max(values, 2.0)
    return 2.0 * n * math.log(error) + parameters * math.log(n)


def _exp(x: float) -> float:
    return math.exp(min(x, 700.0))
