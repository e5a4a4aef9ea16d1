"""Arrays where XLA can read them in place.

A compiled program copies what NumPy hands it unless that begins at a multiple of 64 bytes, and it holds the
interpreter's lock while it copies: of a block of samples that took half as long as what was done with it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

#: Bytes.
ALIGNMENT = 64


def empty(shape: tuple[int, ...]) -> NDArray[np.float64]:
    """An array of float64 whose first element lies at a multiple of ``ALIGNMENT``, not filled."""
    size = math.prod(shape) * np.dtype(np.float64).itemsize
    memory = np.empty(size + ALIGNMENT, np.uint8)
    start = -memory.ctypes.data % ALIGNMENT
    return memory[start : start + size].view(np.float64).reshape(shape)
