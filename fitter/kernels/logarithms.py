"""Signed logarithms back to what they are of, see :mod:`fitter.compression.scale`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled, part

FloatArray = NDArray[np.float64]

# Numbers at a time; rows of the scratch array.
_SOME = 256
_POWER, _REST, _SIZE = (k * _SOME for k in range(3))
# Added to a number below 2^51 it leaves the nearest whole one in the last bits.
_WHOLE = 6755399441055744.0
_PER_OCTAVE = 1.4426950408889634
# log 2 in two parts: multiples of the first by whole numbers below 2^21 are exact.
_OCTAVE = float(np.ldexp(np.floor(np.ldexp(np.log(2.0), 32)), -32))
_REMAINDER = (float(np.log(2.0)) - _OCTAVE) + 2.3190468138462996e-17
_BITS_OF_ONE, _MANTISSA = np.uint64(0x3FF0000000000000), np.uint64(52)


@part
def less_one(x: float) -> float:
    """exp(x) - 1 for |x| < 0.35 by its series, in independent pieces: right to 1.4e-15 of it."""
    q = x * x
    q4 = q * q
    first = (1 / 2 + x * (1 / 6)) + q * (1 / 24 + x * (1 / 120))
    second = (1 / 720 + x * (1 / 5040)) + q * (1 / 40320 + x * (1 / 362880))
    third = (1 / 3628800 + x * (1 / 39916800)) + q * (1 / 479001600)
    return x + q * (first + q4 * (second + q4 * third))


@compiled
def restored(
    logarithm: NDArray[np.floating], unit: float, floor: FloatArray, large: float, found: FloatArray
) -> None:
    """floor (exp|y| - 1) with the sign of y = ``unit`` times the logarithms (C, M), into ``found`` (M, C);
    from ``large`` on exp(|y| + log floor), which overflows where the value does.

    By additions and multiplications alone below that: every machine has the same values.
    """
    channels, count = logarithm.shape
    bits = np.empty(3 * _SOME, np.uint64)
    b = bits.view(np.float64)
    for c in range(channels):
        lowest = floor[c]
        for start in range(0, count, _SOME):
            m, at = np.uint64(min(_SOME, count - start)), np.uint64(start)
            few = 0
            for i in range(m):
                y = abs(logarithm[c, at + i] * unit)
                few += int(y < large)
                y = y if y < large else 0.0
                whole = y * _PER_OCTAVE + _WHOLE
                b[_POWER + i] = whole
                whole -= _WHOLE
                b[_REST + i] = y - whole * _OCTAVE - whole * _REMAINDER
            for i in range(m):
                bits[_POWER + i] = (bits[_POWER + i] << _MANTISSA) + _BITS_OF_ONE
            for i in range(m):
                power = b[_POWER + i]
                b[_SIZE + i] = (power * less_one(b[_REST + i]) + (power - 1.0)) * lowest
            for i in range(m):
                size = b[_SIZE + i]
                found[at + i, c] = -size if logarithm[c, at + i] < 0 else size
            if few < m:
                for i in range(m):
                    y = logarithm[c, at + i] * unit
                    if not abs(y) < large:
                        found[at + i, c] = np.copysign(np.exp(abs(y) + np.log(lowest)), y)
