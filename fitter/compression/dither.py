"""Subtractive dither: what makes the errors of rounding independent of what is rounded.

A number between -1/2 and 1/2 that the decoder knows, too, is added before rounding and subtracted after.
The error is then uniform over a step whatever the value is (Schuchman 1964, IEEE Trans. Commun. Technol. 12,
162). Without it a table that is smoother than its bound has errors that follow its shape: a peak is low as a
whole, and a fit is misled by more than errors of that size would if they were independent.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.compression.entropy import SHIFTS

#: Factors of a mixing function of 32 bits (MurmurHash3's finaliser), and 2^32 over the golden ratio.
_FACTORS = (np.uint32(0x85EBCA6B), np.uint32(0xC2B2AE35))
_GOLDEN = 0x9E3779B9


def dither(
    shape: tuple[int, ...], seed: int, stage: int, channel: int, kind: np.dtype[Any]
) -> NDArray[np.floating[Any]]:
    """The numbers of one channel's new nodes of a stage; other seeds, stages and channels have others."""
    start = np.uint32(((seed * 251 + stage) * 257 + channel) * _GOLDEN & 0xFFFFFFFF)
    mixed = np.arange(int(np.prod(shape)), dtype=np.uint32)
    mixed *= np.uint32(_GOLDEN)
    mixed += start
    for factor in _FACTORS:
        mixed ^= mixed >> np.uint32(15)
        mixed *= factor
    mixed ^= mixed >> np.uint32(16)
    mixed >>= np.uint32(9)
    found = mixed.astype(kind)
    found *= kind.type(2.0**-23)
    found += kind.type(2.0**-24 - 0.5)
    return found.reshape(shape)


def kinds(classes: NDArray[np.uint8], added: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """Class and shift of each number in one; numbers count from the side that the dither is on."""
    size = np.abs(added) * added.dtype.type(2 * len(SHIFTS))
    return classes * np.uint8(len(SHIFTS)) + size.astype(np.uint8)
