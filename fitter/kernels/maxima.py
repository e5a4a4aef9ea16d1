"""Largest values over ranges of a table inside kernels, see :mod:`fitter.sampling.maxima`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled, part

FloatArray = NDArray[np.float64]

#: Of an interval on an axis: the nodes that enclose it, its ends, clipped to the axis.
Span = tuple[int, int, float, float]
#: Weights of three nodes.
Three = tuple[float, float, float]


@part
def below(nodes: FloatArray, axis: int, n: int, x: float) -> int:
    """How many of the first ``n`` nodes are at most x."""
    low, high = 0, n
    while low < high:
        middle = (low + high) >> 1
        if nodes[axis, middle] <= x:
            low = middle + 1
        else:
            high = middle
    return low


@part
def before(nodes: FloatArray, axis: int, n: int, x: float) -> int:
    """How many of the first ``n`` nodes are below x."""
    low, high = 0, n
    while low < high:
        middle = (low + high) >> 1
        if nodes[axis, middle] < x:
            low = middle + 1
        else:
            high = middle
    return low


@part
def span(nodes: FloatArray, axis: int, n: int, low: float, high: float) -> Span:
    """The interval from low to high."""
    low = min(max(low, nodes[axis, 0]), nodes[axis, n - 1])
    high = min(max(high, nodes[axis, 0]), nodes[axis, n - 1])
    return max(below(nodes, axis, n, low) - 1, 0), min(before(nodes, axis, n, high), n - 1), low, high


@part
def ratio(step: float, width: float) -> float:
    return min(max(step / width, 0.0), 1.0) if width > 0 else 0.0


@part
def shares(nodes: FloatArray, axis: int, n: int, some: Span, which: int) -> Three:
    """Weights of the three nodes around an interval that holds at most one, at its lower end, at the node
    inside (or again at an end), or at its upper end."""
    first, _, low, high = some
    x0, x1, x2 = nodes[axis, first], nodes[axis, min(first + 1, n - 1)], nodes[axis, min(first + 2, n - 1)]
    point = low if which == 0 else (high if which == 2 else min(max(x1, low), high))
    left, right = ratio(point - x0, x1 - x0), ratio(point - x1, x2 - x1)
    return 1 - left, left * (1 - right), right


@part
def octave(length: int) -> int:
    """The largest k with 2^k at most ``length``."""
    k = 0
    while length > 1:
        length >>= 1
        k += 1
    return k


@part
def box(sparse: NDArray[np.float64], i0: int, i1: int, j0: int, j1: int) -> float:
    """The maximum over rows i0..i1 and columns j0..j1, both included, of a :class:`BoxMaximum`."""
    a, b = octave(i1 - i0 + 1), octave(j1 - j0 + 1)
    i2, j2 = i1 - (1 << a) + 1, j1 - (1 << b) + 1
    return max(
        max(sparse[a, b, i0, j0], sparse[a, b, i2, j0]), max(sparse[a, b, i0, j2], sparse[a, b, i2, j2])
    )


@part
def window(
    around: FloatArray, count: int, levels: NDArray[np.float32], low: float, high: float
) -> tuple[int, int, int]:
    """Of a :class:`WindowMaximum` over [low, high]: the level, -1 where the whole axis stands for it, and
    the two windows that cover it."""
    n = around.shape[1]
    if n == 0:
        return -1, 0, 0
    reach = 2 * (around[0, n - 1] - around[0, 0])
    first = below(around, 0, n, max(low, -reach)) - 1
    last = before(around, 0, n, min(high, reach))
    length = last - first + 1
    if first < 0 or last >= n or length >= min(1 << len(levels), count):
        return -1, 0, 0
    level = octave(length)
    return level, first % count, (last - (1 << level) + 1) % count


@part
def windowed(
    levels: NDArray[np.float32], whole: FloatArray, some: tuple[int, int, int], row: int, column: int
) -> float:
    """The maximum over a :func:`window` at one row and column."""
    level, start, stop = some
    if level < 0:
        return whole[row, column]
    return max(np.float64(levels[level, row, column, start]), np.float64(levels[level, row, column, stop]))


@part
def over_rectangle(
    nodes: FloatArray, sparse: NDArray[np.float64], x0: float, x1: float, y0: float, y1: float
) -> float:
    """As :class:`fitter.sampling.maxima.BilinearMaximum`, of one image, of which nodes and sparse are as
    :func:`fitter.sampling.maxima.packed` has them."""
    rows, columns = sparse.shape[2], sparse.shape[3]
    x, y = span(nodes, 0, columns, x0, x1), span(nodes, 1, rows, y0, y1)
    if x[1] - x[0] > 2 or y[1] - y[0] > 2:
        return box(sparse, y[0], y[1], x[0], x[1])
    i0, i1, i2 = x[0], min(x[0] + 1, columns - 1), min(x[0] + 2, columns - 1)
    j0, j1, j2 = y[0], min(y[0] + 1, rows - 1), min(y[0] + 2, rows - 1)
    image, most = sparse[0, 0], -np.inf
    for p in range(3):
        b0, b1, b2 = shares(nodes, 1, rows, y, p)
        r0 = b0 * image[j0, i0] + b1 * image[j1, i0] + b2 * image[j2, i0]
        r1 = b0 * image[j0, i1] + b1 * image[j1, i1] + b2 * image[j2, i1]
        r2 = b0 * image[j0, i2] + b1 * image[j1, i2] + b2 * image[j2, i2]
        for q in range(3):
            a0, a1, a2 = shares(nodes, 0, columns, x, q)
            most = max(most, a0 * r0 + a1 * r1 + a2 * r2)
    return most


@compiled
def over_windows(
    around: FloatArray, levels: NDArray[np.float32], whole: FloatArray, count: int,
    low: FloatArray, high: FloatArray, row: NDArray[np.int64], column: NDArray[np.int64], found: FloatArray,
) -> None:  # fmt: skip
    """(K,) maxima over [low, high] at one row and column each, into ``found``."""
    for k in range(len(low)):
        some = window(around, count, levels, low[k], high[k])
        found[k] = windowed(levels, whole, some, row[k], column[k])
