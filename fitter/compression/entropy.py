"""Integers to bits and back: classes of stated width, a distribution of two parameters each, and a coder.

A class's distribution is (1 + x^2 / (2 m s^2))^-m over the integers: Cauchy-like for m = 1, nearly normal
for m = 32. It costs four bytes, where a histogram would cost as much as a small table's data. Integers are
coded as tokens: small ones are one each, larger ones an eighth of an octave, whose remaining bits follow
as they are. The coder is :mod:`fitter.kernels.interleaved`; containers of version 2 have a range coder's,
:mod:`fitter.kernels.range_coder`.

Probabilities are computed by IEEE additions, multiplications, divisions and square roots alone, so that every
machine has the same ones.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Numbers (zigzag) below this are a token each; above, tokens are 1 / 2^MANTISSA of an octave.
DIRECT, MANTISSA = 32, 3
#: Largest magnitude that is coded at all.
LARGEST = 1 << 30
_FIRST_OCTAVE = 5
#: What a class may be: a byte.
_CLASSES = 256
_TOKENS = DIRECT + (32 - _FIRST_OCTAVE) * (1 << MANTISSA)
#: Exponents m of the distributions, by their number.
EXPONENTS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 16.0, 32.0)
#: Scales are 2^(i/4); this is the i of the number 0.
_SMALLEST_SCALE = -40
#: Least probability of a token, of the most probable one's: the coder can't resolve much less.
_LEAST = 2.0**-18
#: What numbers may be shifted by, see fitter.compression.dither: middles of quarters of half a step.
SHIFTS = (0.0625, 0.1875, 0.3125, 0.4375)
_QUARTERS = (1.0, 1.189207115002721, 1.4142135623730951, 1.681792830507429)


@cache
def _buckets() -> tuple[FloatArray, FloatArray]:
    """(tokens,) the number in the middle of each token (its size where it holds both signs), and how many
    numbers it holds."""
    token = np.arange(_TOKENS)
    octave, part = np.divmod(token - DIRECT, 1 << MANTISSA)
    bits = np.where(token < DIRECT, 0, octave + _FIRST_OCTAVE - MANTISSA)
    low = np.where(token < DIRECT, token, ((1 << MANTISSA) + part) << np.maximum(bits, 0))
    width = np.left_shift(1, bits).astype(np.float64)
    return np.where(token < DIRECT, (token >> 1) ^ -(token & 1), 0.5 * (low + 0.5 * width)), width


def tokens(numbers: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """``(token, bits, rest)`` of each number: ``rest`` is its lowest ``bits`` bits."""
    folded = np.where(numbers < 0, -2 * numbers - 1, 2 * numbers)
    octave = np.frexp(folded.astype(np.float64))[1].astype(np.int64) - 1
    bits = np.where(folded < DIRECT, 0, octave - MANTISSA)
    part = (folded >> bits) - (1 << MANTISSA)
    token = np.where(folded < DIRECT, folded, DIRECT + (octave - _FIRST_OCTAVE) * (1 << MANTISSA) + part)
    return token, bits, folded & ((1 << bits) - 1)


def fitted(token: IntArray, shift: IntArray) -> tuple[int, int, int]:
    """The distribution that codes these tokens, of numbers shifted by SHIFTS[shift], in the fewest bits: its
    scale as i of 2^(i/4), less ``_SMALLEST_SCALE``; its exponent's place in EXPONENTS; the largest token."""
    top = int(token.max())
    used = max(2, top + 1)
    count = np.bincount(shift * used + token, minlength=len(SHIFTS) * used).reshape(len(SHIFTS), 1, used)
    middle, width = (part[:used] for part in _buckets())
    mean = float((count * np.abs(middle)).sum() / count.sum())
    nominal = round(4 * np.log2(max(mean, 2.0**-9))) - _SMALLEST_SCALE
    scales = np.arange(max(0, nominal - 14), max(1, nominal + 9))
    s = np.exp2((scales + _SMALLEST_SCALE) / 4)[:, None, None, None]
    m = np.array(EXPONENTS)[:, None]
    away = np.abs(middle - np.array(SHIFTS)[:, None, None])
    log_p = np.log2(width) - m * np.log2(1.0 + np.square(away / s) / (2.0 * m))
    log_p = np.maximum(log_p - log_p.max(axis=-1, keepdims=True), np.log2(_LEAST))
    bits = count.sum(axis=-1) * np.log2(np.exp2(log_p).sum(axis=-1)) - (log_p * count).sum(axis=-1)
    cost = bits.sum(axis=1)
    row, exponent = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return int(scales[row]), int(exponent), top


class Encoder:
    """Tokens to words, in the order that they are written in."""

    def __init__(self) -> None:
        self._groups: list[tuple[IntArray, NDArray[np.uint8]]] = []

    def write(self, token: IntArray, kind: NDArray[np.uint8]) -> None:
        """A group of tokens, each of its ``kind``: SHIFTS times its class, and its shift."""
        self._groups.append((token, kind))

    def finish(self) -> tuple[NDArray[np.uint8], NDArray[np.uint32]]:
        """The distributions (D, 4) of the classes that were met, fitted to their tokens, and the words."""
        from fitter.kernels.interleaved import LANES, written

        token = np.concatenate([*(group[0] for group in self._groups), np.zeros(0, np.int64)])
        kind = np.concatenate([*(group[1] for group in self._groups), np.zeros(0, np.uint8)])
        own, shift = kind // len(SHIFTS), (kind % len(SHIFTS)).astype(np.int64)
        rows = [(u, *fitted(token[own == u], shift[own == u])) for u in np.unique(own).tolist()]
        distributions = np.array(rows, np.uint8).reshape(-1, 4)
        which, ends, _ = tables(distributions)
        words = np.empty(len(token) + 2 * LANES, np.uint32)
        used = written(token, which[own] * len(SHIFTS) + shift, ends, words)
        return distributions, words[len(words) - used :]


def tables(
    rows: NDArray[np.uint8],
) -> tuple[IntArray, NDArray[np.uint32], NDArray[np.uint8]]:
    """For :func:`fitter.kernels.tiles.decoded`: which of the distributions (D, 4) each class (256,) has, -1
    for none, their cumulated probabilities and first tokens. Raises ValueError for an exponent that there is
    not, and for more distributions than classes: a forged table must not fill the memory."""
    from fitter.kernels.range_coder import cumulated

    if len(rows) > _CLASSES:
        raise ValueError("more distributions than classes")
    if len(rows) and int(rows[:, 2].max()) >= len(EXPONENTS):
        raise ValueError("a distribution with an exponent that there is not")
    which = np.full(_CLASSES, -1)
    which[rows[:, 0]] = np.arange(len(rows))
    middle, width = _buckets()
    top = min(max(2, 1 + int(rows[:, 3].max(initial=0))), len(middle))
    ends = np.empty((len(rows) * len(SHIFTS), top + 1), np.uint32)
    first = np.empty((len(ends), 256), np.uint8)
    shifts, exponents = np.array(SHIFTS), np.array(EXPONENTS)
    cumulated(rows, _scales(), exponents, middle[:top], width[:top], shifts, _LEAST, ends, first)
    return which, ends, first


@cache
def _scales() -> FloatArray:
    """(256,) what the numbers of scales stand for."""
    octave, quarter = np.divmod(np.arange(256) + _SMALLEST_SCALE, 4)
    return np.ldexp(np.array(_QUARTERS)[quarter], octave)


def pack_bits(rest: IntArray, bits: IntArray) -> NDArray[np.uint8]:
    """The lowest ``bits`` bits of each, one after the other, the lowest first."""
    ends = np.cumsum(bits)
    total = int(ends[-1]) if len(ends) else 0
    owner = np.repeat(np.arange(len(bits)), bits)
    place = np.arange(total) - np.repeat(ends - bits, bits)
    return np.packbits(((rest[owner] >> place) & 1).astype(np.uint8), bitorder="little")
