"""Random numbers inside kernels: xoshiro256++ (D. Blackman, S. Vigna 2021, "Scrambled linear pseudorandom
number generators"), ``LANES`` streams side by side, so that vector instructions move them on together; seeded
by NumPy's SeedSequence, anew for each block of draws."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled, part, routine

Words = NDArray[np.uint64]

#: Streams that move on together; each has a state of four words, not all 0.
LANES = 16
#: Words of a state: the first word of every stream, then the second of every stream, ...
STATE = 4 * LANES

_U = np.uint64
# A double in [1, 2) whose last 52 bits count: as fast as vector instructions make numbers of words.
_ONE = np.uint64(0x3FF0000000000000)
_SHIFT_12, _SHIFT_26, _SHIFT_38 = np.uint64(12), np.uint64(26), np.uint64(38)
_LOW_38, _SHIFT_14 = np.uint64((1 << 38) - 1), np.uint64(14)


@routine
def moved(state: Words, found: Words, count: int) -> None:
    """The next ``count`` words, a multiple of ``LANES``, into the first of ``found``; the streams move on."""
    lanes = _U(LANES)
    for k in range(_U(count // LANES)):
        start = k * lanes
        for j in range(lanes):
            a, b, c, d = state[j], state[lanes + j], state[_U(2) * lanes + j], state[_U(3) * lanes + j]
            total = a + d
            found[start + j] = ((total << _U(23)) | (total >> _U(41))) + a
            shifted = b << _U(17)
            c ^= a
            d ^= b
            b ^= c
            a ^= d
            c ^= shifted
            state[j], state[lanes + j], state[_U(2) * lanes + j] = a, b, c
            state[_U(3) * lanes + j] = (d << _U(45)) | (d >> _U(19))


@part
def one(bits: Words, row: int, count: int) -> None:
    """``count`` words from ``row`` on as the bits of multiples of 2^-52 in [1, 2)."""
    for i in range(count):
        bits[row + i] = (bits[row + i] >> _SHIFT_12) | _ONE


@part
def two(bits: Words, row: int, other: int, count: int) -> None:
    """``count`` words from ``row`` on as the bits of two numbers in [1, 2) each: there of multiples of 2^-38,
    and from ``other`` on of multiples of 2^-26."""
    for i in range(count):
        word = bits[row + i]
        bits[other + i] = ((word >> _SHIFT_38) << _SHIFT_26) | _ONE
        bits[row + i] = ((word & _LOW_38) << _SHIFT_14) | _ONE


@compiled
def words(state: Words, found: Words) -> None:
    """The next words of streams with states (``STATE``,), which move on, the streams in turn: a whole number
    from each."""
    moved(state, found, len(found))
