"""Product quadrature over cells inside kernels, as many cells at a time as a chunk has points for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import part
from fitter.kernels.candidates import CHUNK

FloatArray = NDArray[np.float64]

#: The first rows of a chunk: both coordinates of a point, and its weight.
A, B, WEIGHT = 0, 1, 2


@part
def spread(cells: FloatArray, start: int, count: int, x: FloatArray, share: FloatArray, b: FloatArray) -> int:
    """The points of ``count`` cells (K, 4) = a0, a1, b0, b1 from ``start`` on, and their weights, into the
    first rows of ``b``, for nodes ``x`` in [-1, 1] along both sides and their weights. Returns how many."""
    i = 0
    for k in range(start, start + count):
        middle_a, middle_b = 0.5 * (cells[k, 0] + cells[k, 1]), 0.5 * (cells[k, 2] + cells[k, 3])
        half_a, half_b = 0.5 * (cells[k, 1] - cells[k, 0]), 0.5 * (cells[k, 3] - cells[k, 2])
        for p in range(len(x)):
            for q in range(len(x)):
                b[A * CHUNK + i], b[B * CHUNK + i] = middle_a + half_a * x[p], middle_b + half_b * x[q]
                b[WEIGHT * CHUNK + i] = half_a * half_b * share[p] * share[q]
                i += 1
    return i


@part
def summed(
    b: FloatArray, row: int, start: int, count: int, each: int, found: FloatArray, known: NDArray[np.int64]
) -> None:
    """The weighted sums of a row over the ``each`` points of every cell, without those that are NaN, into
    ``found`` (K,), and how many went in, into ``known`` (K,)."""
    i = 0
    for k in range(start, start + count):
        total, good = 0.0, 0
        for _ in range(each):
            value = b[row * CHUNK + i]
            if value == value:  # not NaN
                total += value * b[WEIGHT * CHUNK + i]
                good += 1
            i += 1
        found[k], known[k] = total, good
