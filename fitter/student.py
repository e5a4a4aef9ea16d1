"""Student's t as the GUM uses it: coverage factors, and degrees of freedom of a combined uncertainty."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special


def coverage_factor(degrees: ArrayLike, level: float) -> NDArray[np.float64]:
    """k of the expanded uncertainty k u that covers with the probability ``level``: the two-sided quantile of
    Student's t (GUM G.3), which is the normal distribution's where the degrees of freedom are infinite."""
    return np.asarray(special.stdtrit(np.asarray(degrees, np.float64), 0.5 + 0.5 * level))


def effective_degrees(variance: float, parts: Iterable[tuple[float, float]]) -> float:
    """Degrees of freedom of a variance that is the sum of parts, each with its own: the Welch-Satterthwaite
    formula (GUM G.4.1), and of it the whole number below, the cautious side."""
    if not 0.0 < variance < math.inf:
        return math.inf
    known = ((v / variance, degrees) for v, degrees in parts if math.isfinite(v) and math.isfinite(degrees))
    terms = sum(share * share / degrees for share, degrees in known)
    # Rounding must not make 12 of 13.
    return max(1.0, float(math.floor((1.0 + 1e-9) / terms))) if terms > 0 else math.inf
