"""How far a model is from 50 digits of its canonical expression, against what its inputs allow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mpmath
import numpy as np

DIGITS = 50
_STEP = mpmath.mpf(10) ** -20


def conditioned(reference: Callable[..., Any], inputs: Sequence[float]) -> tuple[Any, Any]:
    """The value to 50 digits and kappa = sum |x d ln f / dx| over the inputs, by central differences."""
    with mpmath.workdps(DIGITS):
        x = [mpmath.mpf(float(v)) for v in inputs]
        value = reference(*x)
        kappa = mpmath.mpf(0)
        for k, v in enumerate(x):
            ends = [reference(*x[:k], v * (1 + s * _STEP), *x[k + 1 :]) for s in (1, -1)]
            kappa += abs((ends[0] - ends[1]) / (2 * _STEP))
        return value, kappa / abs(value) if value else mpmath.mpf(0)


def excess(
    reference: Callable[..., Any], inputs: Sequence[np.ndarray], found: np.ndarray, dtype: type[np.floating]
) -> np.ndarray:
    """Relative errors over the bound 1e-12 + 8 eps kappa (float32: 1e-5 + 8 eps kappa), one per row.

    At most 1 where the bound is met. Values about as small as the smallest normal number count as 0.
    """
    info = np.finfo(dtype)
    base = 1e-12 if dtype == np.float64 else 1e-5
    over = np.zeros(len(found))
    for row, (value, *x) in enumerate(zip(found, *inputs, strict=True)):
        exact, kappa = conditioned(reference, x)
        if abs(exact) < 1e3 * info.tiny:
            assert abs(value) <= 2e3 * info.tiny
            continue
        bound = base + 8 * float(info.eps) * float(kappa)
        over[row] = min(float(abs(mpmath.mpf(float(value)) - exact) / abs(exact)) / bound, 1e300)
    return over
