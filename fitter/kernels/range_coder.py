"""The decoder's half of the range coder under compressed tables, see :mod:`fitter.compression.entropy`.

Range coding is G. N. N. Martin's (1979); word size, precision and how probabilities become whole numbers are
those of constriction 0.5, which wrote what is read here: containers of version 2. Version 3 has the same
probabilities.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled, part

FloatArray = NDArray[np.float64]
Words = NDArray[np.uint32]

_U = np.uint64
#: Bits of a probability, of a word, and of the first look-up of a token.
PRECISION, WORD, FIRST = 24, 32, 8
_ONE = 1 << PRECISION

#: Where a message is read: lower end and width of the interval, the point in it, and the next word.
Reader = tuple[np.uint64, np.uint64, np.uint64, int]


@compiled
def cumulated(
    rows: NDArray[np.uint8],
    scales: FloatArray,
    exponents: FloatArray,
    middle: FloatArray,
    width: FloatArray,
    shifts: FloatArray,
    least: float,
    ends: Words,
    first: NDArray[np.uint8],
) -> None:
    """Cumulated probabilities of tokens, in units of 2^-24, of distributions (D, 4): class, scale, exponent,
    largest token.

    scales, exponents : by their numbers. middle, width : of the tokens. ends : (D shifts, tokens + 1),
    filled. first : (D shifts, 256) the first token that a probability with these highest bits may be.
    """
    weight, square = np.empty(len(middle)), np.empty(len(middle))
    for d in range(len(rows)):
        s, m = scales[rows[d, 1]], exponents[rows[d, 2]]
        n = min(max(2, np.int64(rows[d, 3]) + 1), len(middle))
        for shift in range(len(shifts)):
            for k in range(n):
                away = (middle[k] - shifts[shift]) / s
                square[k] = 1.0 + away * away / (2.0 * m)
                weight[k] = np.sqrt(square[k]) if m % 1.0 > 0 else 1.0
            # By square roots and products, which round alike everywhere.
            whole = np.int64(m)
            while whole:
                if whole & 1:
                    for k in range(n):
                        weight[k] = weight[k] * square[k]
                for k in range(n):
                    square[k] = square[k] * square[k]
                whole >>= 1
            most = 0.0
            for k in range(n):
                weight[k] = width[k] / weight[k]
                most = max(most, weight[k])
            for k in range(n):
                weight[k] = max(weight[k] / most, least)
            total = 0.0
            for k in range(n):
                total += weight[k]
            scale, below, row = (_ONE - n) / total, 0.0, d * len(shifts) + shift
            for k in range(n):
                ends[row, k] = np.uint32(np.int64(below * scale) + k)
                below += weight[k]
            for k in range(n, ends.shape[1]):
                ends[row, k] = _ONE
            bucket = 0
            for k in range(n):
                while bucket < 1 << FIRST and bucket << (PRECISION - FIRST) < np.int64(ends[row, k + 1]):
                    first[row, bucket] = k
                    bucket += 1


@part
def opened(words: Words) -> Reader:
    """At the start of a message."""
    high = _U(words[0]) if len(words) > 0 else _U(0)
    low = _U(words[1]) if len(words) > 1 else _U(0)
    return _U(0), ~_U(0), (high << _U(WORD)) | low, 2


@part
def token(
    reader: Reader, words: Words, ends: Words, first: NDArray[np.uint8], row: int
) -> tuple[Any, Reader]:
    """The next token, of the distribution ``row``; -1 for data that has none."""
    lower, wide, point, place = reader
    scale = wide >> _U(PRECISION)
    quantile = (point - lower) // scale
    if quantile >= _U(_ONE):
        return -1, reader
    found = np.int64(first[row, np.int64(quantile >> _U(PRECISION - FIRST))])
    while _U(ends[row, found + 1]) <= quantile:
        found += 1
    left = _U(ends[row, found])
    lower += scale * left
    wide = scale * (_U(ends[row, found + 1]) - left)
    if wide < _U(1 << WORD):
        lower, wide, point = lower << _U(WORD), wide << _U(WORD), point << _U(WORD)
        if place < len(words):
            point |= _U(words[place])
        place += 1
    return found, (lower, wide, point, place)


@compiled
def read(
    words: Words, ends: Words, first: NDArray[np.uint8], rows: NDArray[np.int64], found: NDArray[np.int64]
) -> bool:
    """Tokens of the distributions ``rows`` (n,) into ``found`` (n,); False where there is one without."""
    reader = opened(words)
    for k in range(len(rows)):
        found[k], reader = token(reader, words, ends, first, rows[k])
        if found[k] < 0:
            return False
    return True
