"""Sines, cosines and arc tangents inside kernels, in a few nanoseconds each, right to 1e-15."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import part

FloatArray = NDArray[np.float64]

# pi/2 in two parts: multiples of the first by small integers are exact; the last number is pi/2 less the
# double next to it.
_QUARTER = float(np.ldexp(np.floor(np.ldexp(np.pi / 2, 32)), -32))
_REST = (np.pi / 2 - _QUARTER) + 6.123233995736766e-17
# Coefficients of the series of sine (x^3, x^5, ...) and cosine (x^2, x^4, ...), with signs.
_S3, _S5, _S7, _S9, _S11, _S13, _S15 = (
    -1 / 6,
    1 / 120,
    -1 / 5040,
    1 / 362880,
    -1 / 39916800,
    1 / 6227020800,
    -1 / 1307674368000,
)
_C4, _C6, _C8, _C10, _C12, _C14, _C16 = (
    1 / 24,
    -1 / 720,
    1 / 40320,
    -1 / 3628800,
    1 / 479001600,
    -1 / 87178291200,
    1 / 20922789888000,
)
# Arc tangents of multiples of 1/64.
_STEPS = 64
_ARCS = np.arctan(np.arange(_STEPS + 1) / _STEPS)


@part
def short_sine(x: float) -> float:
    """sin(x) by its series, for |x| < 0.14."""
    q = x * x
    return x + x * q * (_S3 + q * (_S5 + q * (_S7 + q * _S9)))


@part
def short_cosine(x: float) -> float:
    """cos(x) by its series, for |x| < 0.14."""
    q = x * x
    return 1 - 0.5 * q + q * q * (_C4 + q * (_C6 + q * (_C8 + q * _C10)))


@part
def cosine_and_sine(angle: float) -> tuple[float, float]:
    """Of angles up to some thousand: by the rest of a division by quarter turns, and series up to 45
    degrees."""
    turns = np.floor(angle * (2 / np.pi) + 0.5)
    x = angle - turns * _QUARTER - turns * _REST
    q = x * x
    sine = x + x * q * (_S3 + q * (_S5 + q * (_S7 + q * (_S9 + q * (_S11 + q * (_S13 + q * _S15))))))
    cosine = (
        1 - 0.5 * q + q * q * (_C4 + q * (_C6 + q * (_C8 + q * (_C10 + q * (_C12 + q * (_C14 + q * _C16))))))
    )
    quarter = np.int64(turns) & 3
    odd = (quarter & 1) != 0
    first, second = (sine if odd else cosine), (cosine if odd else sine)
    return (-first if ((quarter + 1) & 2) != 0 else first), (-second if (quarter & 2) != 0 else second)


@part
def arc(y: float, x: float) -> float:
    """The angle of (x, y) from the x axis in [-pi, pi], 0 at the origin: from the nearest arc of a table on,
    by tan(a - b) = (tan(a) - tan(b)) / (1 + tan(a) tan(b)) and a series."""
    across, along = abs(y), abs(x)
    high, low = max(across, along), min(across, along)
    if high == 0.0:
        return 0.0
    k = np.int64(low / high * _STEPS + 0.5)
    tangent = k * (1.0 / _STEPS)
    d = (low - tangent * high) / (high + tangent * low)
    square = d * d
    found = _ARCS[k] + d * (1 - square * (1 / 3 - square * (1 / 5 - square * (1 / 7))))
    found = np.pi / 2 - found if across > along else found
    found = np.pi - found if x < 0 else found
    return -found if y < 0 else found
