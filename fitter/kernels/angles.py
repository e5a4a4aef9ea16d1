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
# tan(22.5 degrees), and the coefficients of (atan(x)/x - 1)/x^2 in x^2 up to there, by interpolation at
# Chebyshev's points: right to 5e-18.
_EIGHTH = 0.41421356237309503
_A = (
    -0.3333333333333333, 0.1999999999999552, -0.14285714284666542, 0.11111111015256292, -0.09090904578121085,
    0.07692183190760651, -0.0666451144646022, 0.05858148904795124, -0.050854496960392584,
    0.039231657085083686, -0.019176885636589053,
)  # fmt: skip


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
    # Which quarter it is, in floating-point numbers, of which vector instructions can tell.
    half = 0.5 * turns
    even = np.floor(half)
    odd, lower = half != even, 0.5 * even != np.floor(0.5 * even)
    first, second = (sine if odd else cosine), (cosine if odd else sine)
    return (-first if odd != lower else first), (-second if lower else second)


@part
def arc(y: float, x: float) -> float:
    """The angle of (x, y) from the x axis in [-pi, pi], 0 at the origin: within 22.5 degrees of an axis or of
    a diagonal by a polynomial. Without branches or tables, for vector instructions."""
    across, along = abs(y), abs(x)
    high, low = max(across, along), min(across, along)
    diagonal = low > _EIGHTH * high
    d = (low - high if diagonal else low) / (low + high if diagonal else max(high, 1e-300))
    # The polynomial in pieces (G. Estrin 1960), which don't wait for each other.
    q = d * d
    q2 = q * q
    q4 = q2 * q2
    first = (_A[0] + q * _A[1]) + q2 * (_A[2] + q * _A[3])
    second = (_A[4] + q * _A[5]) + q2 * (_A[6] + q * _A[7])
    found = d + d * q * (first + q4 * (second + q4 * ((_A[8] + q * _A[9]) + q2 * _A[10])))
    found = found + np.pi / 4 if diagonal else found
    found = np.pi / 2 - found if across > along else found
    found = np.pi - found if x < 0 else found
    return -found if y < 0 else found
