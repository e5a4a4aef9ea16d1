"""The passes over a stage's nodes that decoding a tile consists of.

Operations and their order are those of the array operations of :mod:`fitter.compression.stages`, in
the tile's own type: the numbers have to be the encoder's to the last bit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import part, routine

Numbers = NDArray[np.floating[Any]]
IntArray = NDArray[np.int64]


@part
def clamped(row: int, last: int) -> int:
    return min(max(row, 0), last)


@routine
def row_pair(known: Numbers, sign: float, a: int, b: int, inner: int, found: Numbers, c: int) -> None:
    """The sum, or difference, of two runs of known nodes."""
    # Unsigned: an index that may be negative would count from the end, and be in the way of vector
    # instructions.
    u, v, w = np.uint64(a), np.uint64(b), np.uint64(c)
    if sign > 0:
        for i in range(np.uint64(max(inner, 0))):
            found[w + i] = known[u + i] + known[v + i]
    else:
        for i in range(np.uint64(max(inner, 0))):
            found[w + i] = known[u + i] - known[v + i]


@routine
def added_to(
    found: Numbers, values: Numbers, row: int, start: int, factor: Any, absolute: bool, count: int
) -> None:
    """``factor`` times a run of a row of ``values``, or of what it is without sign, added to ``found``."""
    u, k = np.uint64(start), np.uint64(row)
    if absolute:
        for i in range(np.uint64(count)):
            found[i] += abs(values[k, u + i]) * factor
    else:
        for i in range(np.uint64(count)):
            found[i] += values[k, u + i] * factor


@routine
def pair(
    known: Numbers,
    sign: float,
    outer: int,
    n: int,
    inner: int,
    count: int,
    one: int,
    other: int,
    found: Numbers,
) -> None:
    """The sum, or difference, of the known nodes (outer, n, inner) ``one`` and ``other`` steps from the one
    before each new node, the nodes at the ends for those beyond."""
    start = max(0, -min(one, other))
    stop = max(min(count, n - max(one, other)), start)
    for o in range(outer):
        # Rows whose nodes are all there lie side by side.
        row_pair(
            known, sign, (o * n + start + one) * inner, (o * n + start + other) * inner,
            (stop - start) * inner, found, (o * count + start) * inner,
        )  # fmt: skip
        for r in range(count):
            if r < start or r >= stop:
                a, b = clamped(r + one, n - 1), clamped(r + other, n - 1)
                row_pair(
                    known,
                    sign,
                    (o * n + a) * inner,
                    (o * n + b) * inner,
                    inner,
                    found,
                    (o * count + r) * inner,
                )


@part
def mirrored(row: int, n: int) -> int:
    row = (row + 2 * n * 4) % (2 * n)
    return row if row < n else 2 * n - 1 - row


@routine
def beside(values: Numbers, outer: int, n: int, inner: int, step: int, found: Numbers) -> None:
    """The sum of the nodes ``step`` rows to either side, mirrored at the ends."""
    stop = max(n - step, step)
    for o in range(outer):
        a = o * n * inner
        row_pair(values, 1.0, a, a + 2 * step * inner, (stop - step) * inner, found, a + step * inner)
        for r in range(n):
            if r < step or r >= stop:
                b, c = mirrored(r - step, n), mirrored(r + step, n)
                row_pair(
                    values, 1.0, (o * n + b) * inner, (o * n + c) * inner, inner, found, (o * n + r) * inner
                )


@part
def inside(dims: IntArray, axis: int, channels: int) -> tuple[int, int, int]:
    """An array of these dimensions, channels first, as (outer, n, inner) about an axis."""
    outer, inner = channels, 1
    for k in range(axis):
        outer *= dims[k]
    for k in range(axis + 1, len(dims)):
        inner *= dims[k]
    return outer, dims[axis], inner


@routine
def neighbours(
    known: Numbers, error: Numbers, dims: IntArray, axis: int, count: int, channels: int, sums: Numbers,
    others: Numbers, scratch: Numbers, counts: IntArray,
) -> int:  # fmt: skip
    """As :func:`fitter.compression.stages.neighbours`: ``sums`` (S, nodes), ``others`` (4, nodes) = unrest,
    around, slope, bend; all channels of each. Returns S."""
    outer, n, inner = inside(dims, axis, channels)
    near, far = sums[0], sums[1]
    unrest, around, slope, bend = others[0], others[1], others[2], others[3]
    pair(known, 1.0, outer, n, inner, count, 0, 1, near)
    pair(known, 1.0, outer, n, inner, count, -1, 2, far)
    pair(known, -1.0, outer, n, inner, count, 1, 0, slope)
    pair(known, -1.0, outer, n, inner, count, 2, -1, bend)
    pair(error, 1.0, outer, n, inner, count, 0, 1, unrest)
    size = outer * count * inner
    for i in range(size):
        bend[i] = abs(bend[i] - slope[i])
        slope[i] = abs(slope[i])
        around[i] = 0
    new = dims.copy()
    new[axis] = count
    counts[0], counts[1] = 2, 2
    used, across = 2, 0
    for k in range(len(dims)):
        if k != axis and new[k] > 1:
            o, m, w = inside(new, k, channels)
            beside(near, o, m, w, 1, sums[used])
            beside(near, o, m, w, 2, sums[used + 1])
            beside(far, o, m, w, 1, sums[used + 2])
            counts[used], counts[used + 1], counts[used + 2] = 4, 4, 4
            beside(unrest, o, m, w, 1, scratch)
            for i in range(size):
                around[i] += scratch[i]
            used, across = used + 3, across + 1
    factor = known.dtype.type(0.5 / max(1, across))
    for i in range(size):
        around[i] *= factor
    first = 0
    for j in range(len(dims)):
        if j != axis and new[j] > 1:
            for k in range(j + 1, len(dims)):
                if k != axis and new[k] > 1:
                    o, m, w = inside(new, k, channels)
                    beside(sums[2 + 3 * first], o, m, w, 1, sums[used])
                    counts[used] = 8
                    used += 1
            first += 1
    return used


@routine
def far_apart(sums: Numbers, used: int, start: int, count: int, found: Numbers) -> None:
    """The spread of :meth:`fitter.compression.rules.Seen.of`."""
    half, u = sums.dtype.type(0.5), np.uint64(start)
    for i in range(np.uint64(count)):
        found[i] = abs(sums[1, u + i] - sums[0, u + i])
    for k in range(np.uint64(2), np.uint64(used - 1), np.uint64(3)):
        for i in range(np.uint64(count)):
            found[i] += abs(sums[k, u + i] * half - sums[0, u + i])


@routine
def dithered(seed: int, stage: int, channel: int, found: Numbers) -> None:
    """As :func:`fitter.compression.dither.dither`."""
    scale, start = found.dtype.type(2.0**-23), found.dtype.type(2.0**-24 - 0.5)
    begin = np.uint32((((seed * 251 + stage) * 257 + channel) * 0x9E3779B9) & 0xFFFFFFFF)
    for i in range(len(found)):
        mixed = np.uint32(np.uint32(i) * np.uint32(0x9E3779B9)) + begin
        mixed = np.uint32(mixed)
        mixed = np.uint32((mixed ^ (mixed >> np.uint32(15))) * np.uint32(0x85EBCA6B))
        mixed = np.uint32((mixed ^ (mixed >> np.uint32(15))) * np.uint32(0xC2B2AE35))
        mixed = (mixed ^ (mixed >> np.uint32(16))) >> np.uint32(9)
        found[i] = found.dtype.type(mixed) * scale + start


@routine
def woven(known: Numbers, new: Numbers, outer: int, n: int, inner: int, count: int, found: Numbers) -> None:
    """Known nodes (outer, n, inner) and the new ones between them."""
    both = n + count
    for o in range(outer):
        if inner == 1:
            for r in range(count):
                found[o * both + 2 * r] = known[o * n + r]
                found[o * both + 2 * r + 1] = new[o * count + r]
            if n > count:
                found[o * both + 2 * count] = known[o * n + count]
            continue
        for r in range(n):
            for i in range(inner):
                found[(o * both + 2 * r) * inner + i] = known[(o * n + r) * inner + i]
        for r in range(count):
            for i in range(inner):
                found[(o * both + 2 * r + 1) * inner + i] = new[(o * count + r) * inner + i]
