"""Random numbers inside kernels: xoshiro256++ (D. Blackman, S. Vigna 2021, "Scrambled linear pseudorandom
number generators"), one stream for each block of draws, seeded by NumPy's SeedSequence."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled, part

#: A stream's state: four words of 64 bits, not all 0.
State = tuple[np.uint64, np.uint64, np.uint64, np.uint64]

_U = np.uint64
_ULP = 2.0**-53
_LOW = np.uint64((1 << 27) - 1)
_SHIFT_11, _SHIFT_27 = np.uint64(11), np.uint64(27)


@part
def resumed(state: NDArray[np.uint64]) -> State:
    """A stream where it was left."""
    return state[0], state[1], state[2], state[3]


@part
def left(state: NDArray[np.uint64], s: State) -> None:
    """Leave a stream, to be resumed there."""
    state[0], state[1], state[2], state[3] = s


@part
def following(s: State) -> tuple[np.uint64, State]:
    """The next 64 bits, and the state after them."""
    a, b, c, d = s
    total = a + d
    found = ((total << _U(23)) | (total >> _U(41))) + a
    moved = b << _U(17)
    c ^= a
    d ^= b
    b ^= c
    a ^= d
    c ^= moved
    d = (d << _U(45)) | (d >> _U(19))
    return found, (a, b, c, d)


@part
def uniform(s: State) -> tuple[float, State]:
    """A multiple of 2^-53 in [0, 1)."""
    bits, s = following(s)
    return np.int64(bits >> _SHIFT_11) * _ULP, s


@part
def two(s: State) -> tuple[float, float, State]:
    """Two numbers in [0, 1) of one word: multiples of 2^-26 and of 2^-27."""
    bits, s = following(s)
    bits >>= _SHIFT_11
    return np.int64(bits >> _SHIFT_27) * 2.0**-26, np.int64(bits & _LOW) * 2.0**-27, s


@compiled
def words(state: NDArray[np.uint64], count: int) -> NDArray[np.uint64]:
    """The next ``count`` words of a stream (4,), which moves on."""
    s = resumed(state)
    found = np.empty(count, np.uint64)
    for k in range(count):
        found[k], s = following(s)
    left(state, s)
    return found
