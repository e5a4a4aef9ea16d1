"""The passes over a stage's nodes that decoding a tile consists of, one channel at a time.

Operations and their order are those of the array operations of :mod:`fitter.compression.stages` and
:mod:`fitter.compression.rules`, in the tile's own type: the numbers have to be the encoder's to the last bit.
(A term of weight 0, which those leave out, is no difference.)
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import part, routine

Numbers = NDArray[np.floating[Any]]
IntArray = NDArray[np.int64]

#: Nodes that are mixed at once: what is made of them on the way stays in the first cache.
RUN = 512
# Rows of the scratch array are apart by a constant: vector instructions need no proof then that what is
# written is none of what is read. A few other arrays in a loop are proved to be apart, many are not.
_WIDE = RUN + 48
_MIXED, _NEAR, _SPREAD, _AROUND, _NEAR_ROW, _FAR_ROW, _UNREST_ROW, _SUM_ROW = (
    np.uint64(k * _WIDE) for k in range(8)
)
SCRATCH = 8 * _WIDE
_ONE, _THREE, _FOUR = np.uint64(1), np.uint64(3), np.uint64(4)
#: Runs are worked on in multiples of this, for vector instructions: what is written beyond the end of one is
#: written again by the next, and arrays of nodes have as many to spare.
BLOCK = 16
#: Nodes beyond a row's ends for which its own stand.
_PAD = 2


@part
def clamped(row: int, last: int) -> int:
    return min(max(row, 0), last)


@part
def mirrored(row: int, n: int) -> int:
    """The row that stands for one up to two beyond the ends of two rows or more."""
    row = -1 - row if row < 0 else row
    return row if row < n else 2 * n - 1 - row


@part
def inside(dims: IntArray, axis: int) -> tuple[int, int, int]:
    """An array of these dimensions as (outer, n, inner) about an axis."""
    outer, inner = 1, 1
    for k in range(axis):
        outer *= dims[k]
    for k in range(axis + 1, len(dims)):
        inner *= dims[k]
    return outer, dims[axis], inner


@routine
def between(
    known: Numbers, error: Numbers, a: int, b: int, c: int, d: int, to: int, count: int, near: Numbers,
    far: Numbers, slope: Numbers, bend: Numbers, unrest: Numbers,
) -> None:  # fmt: skip
    """Of runs of known nodes from ``a``, ``b``, ``c`` and ``d`` on: the new nodes lie between b and c."""
    # Unsigned: an index that may be negative would count from the end, and be in the way of vector
    # instructions.
    p, q, r, s, t = np.uint64(a), np.uint64(b), np.uint64(c), np.uint64(d), np.uint64(to)
    n = np.uint64(max(count, 0))
    for i in range(n):
        near[t + i] = known[q + i] + known[r + i]
    for i in range(n):
        far[t + i] = known[p + i] + known[s + i]
    for i in range(n):
        slope[t + i] = abs(known[r + i] - known[q + i])
    for i in range(n):
        bend[t + i] = abs(known[s + i] - known[p + i] - (known[r + i] - known[q + i]))
    for i in range(n):
        unrest[t + i] = error[q + i] + error[r + i]


@routine
def paired(
    known: Numbers, error: Numbers, outer: int, n: int, inner: int, count: int, near: Numbers, far: Numbers,
    slope: Numbers, bend: Numbers, unrest: Numbers,
) -> None:  # fmt: skip
    """What new nodes see along their axis, see :class:`fitter.compression.stages.Neighbours`, of the known
    ones and their errors (outer, n, inner); nodes at the ends stand for those beyond."""
    stop = max(min(count, n - 2), 1)
    for o in range(outer):
        # Rows whose nodes are all there lie side by side.
        a = (o * n) * inner
        between(
            known, error, a, a + inner, a + 2 * inner, a + 3 * inner, (o * count + 1) * inner,
            (stop - 1) * inner, near, far, slope, bend, unrest,
        )  # fmt: skip
        for end in range(1 + count - min(stop, count)):
            r = end + stop - 1 if end else 0
            p, q = (o * n + clamped(r - 1, n - 1)) * inner, (o * n + r) * inner
            u = (o * n + clamped(r + 1, n - 1)) * inner
            v, to = (o * n + clamped(r + 2, n - 1)) * inner, (o * count + r) * inner
            if inner > 1:
                between(known, error, p, q, u, v, to, inner, near, far, slope, bend, unrest)
            else:
                steep = known[u] - known[q]
                near[to], far[to], unrest[to] = known[q] + known[u], known[p] + known[v], error[q] + error[u]
                slope[to], bend[to] = abs(steep), abs(known[v] - known[p] - steep)


@part
def begun(near: Numbers, far: Numbers, at: int, count: int, factors: Numbers, b: Numbers) -> None:
    """The first terms of a run's prediction and signs."""
    u, f, g = np.uint64(at), factors[0], factors[1]
    for i in range(np.uint64(count)):
        b[_NEAR + i] = near[u + i]
        b[_MIXED + i] = near[u + i] * f + far[u + i] * g
        b[_SPREAD + i] = abs(far[u + i] - near[u + i])
        b[_AROUND + i] = b.dtype.type(0)


@part
def beside(
    near: Numbers, far: Numbers, unrest: Numbers, ends: tuple[int, int, int, int], count: int,
    factors: Numbers, first: int, b: Numbers,
) -> None:  # fmt: skip
    """The terms of one other axis, of the rows beside and of those two off."""
    p, q, r, s = np.uint64(ends[0]), np.uint64(ends[1]), np.uint64(ends[2]), np.uint64(ends[3])
    f, g, h, half = factors[first], factors[first + 1], factors[first + 2], b.dtype.type(0.5)
    for i in range(np.uint64(count)):
        total = near[p + i] + near[q + i]
        found = b[_MIXED + i] + total * f + (near[r + i] + near[s + i]) * g
        b[_MIXED + i] = found + (far[p + i] + far[q + i]) * h
        b[_SPREAD + i] += abs(total * half - b[_NEAR + i])
        b[_AROUND + i] += unrest[p + i] + unrest[q + i]


@part
def along(count: int, factors: Numbers, first: int, b: Numbers) -> None:
    """The same of the axis along the row, whose nodes and pads are in rows of their own."""
    f, g, h, half = factors[first], factors[first + 1], factors[first + 2], b.dtype.type(0.5)
    for i in range(np.uint64(count)):
        total = b[_NEAR_ROW + _ONE + i] + b[_NEAR_ROW + _THREE + i]
        found = b[_MIXED + i] + total * f + (b[_NEAR_ROW + i] + b[_NEAR_ROW + _FOUR + i]) * g
        b[_MIXED + i] = found + (b[_FAR_ROW + _ONE + i] + b[_FAR_ROW + _THREE + i]) * h
        b[_SPREAD + i] += abs(total * half - b[_NEAR + i])
        b[_AROUND + i] += b[_UNREST_ROW + _ONE + i] + b[_UNREST_ROW + _THREE + i]


@part
def diagonal(
    near: Numbers, ends: tuple[int, int, int, int], count: int, factor: Any, spreads: Any, b: Numbers
) -> None:
    """The term of a pair of other axes. spreads : 1 where it counts as a sign, too, as every third one but
    the last does; else 0."""
    p, q, r, s = np.uint64(ends[0]), np.uint64(ends[1]), np.uint64(ends[2]), np.uint64(ends[3])
    half = b.dtype.type(0.5)
    for i in range(np.uint64(count)):
        total = (near[p + i] + near[q + i]) + (near[r + i] + near[s + i])
        b[_MIXED + i] += total * factor
        b[_SPREAD + i] += abs(total * half - b[_NEAR + i]) * spreads


@part
def diagonal_along(count: int, factor: Any, spreads: Any, b: Numbers) -> None:
    """The same where the second one is along the row."""
    half = b.dtype.type(0.5)
    for i in range(np.uint64(count)):
        total = b[_SUM_ROW + _ONE + i] + b[_SUM_ROW + _THREE + i]
        b[_MIXED + i] += total * factor
        b[_SPREAD + i] += abs(total * half - b[_NEAR + i]) * spreads


@routine
def padded(
    values: Numbers, one: int, other: int, begin: int, count: int, row: int, to: np.uint64, b: Numbers
) -> None:
    """Part of a row that starts at ``one``, or of the sum of two, with what is beyond its ends."""
    u, v, w = np.uint64(one + begin), np.uint64(other + begin), to + np.uint64(_PAD)
    if one == other:
        for i in range(np.uint64(count)):
            b[w + i] = values[u + i]
    else:
        for i in range(np.uint64(count)):
            b[w + i] = values[u + i] + values[v + i]
    for i in range(2 * _PAD):
        k = i - _PAD if i < _PAD else count + i - _PAD
        p = mirrored(begin + k, row)
        b[np.int64(to) + _PAD + k] = values[one + p] if one == other else values[one + p] + values[other + p]


@part
def ended(
    unrest: Numbers, slope: Numbers, bend: Numbers, at: int, count: int, share: Any, shares: Numbers,
    b: Numbers, predicted: Numbers, width: Numbers,
) -> None:  # fmt: skip
    """The terms of a run's expected errors, and its predictions, but for those of other channels."""
    u = np.uint64(at)
    e, f, g, h, k, spread = shares[0], shares[1], shares[2], shares[3], shares[4], shares[5]
    for i in range(np.uint64(count)):
        found = e + unrest[u + i] * f + (b[_AROUND + i] * share) * g
        width[u + i] = found + slope[u + i] * h + bend[u + i] * k + b[_SPREAD + i] * spread
    for i in range(np.uint64(count)):
        predicted[u + i] = b[_MIXED + i]


@part
def corrected_by(
    corrections: Numbers, row: int, at: int, count: int, factor: Any, share: Any, predicted: Numbers,
    width: Numbers,
) -> None:  # fmt: skip
    """The terms of another channel's corrections."""
    u, v = np.uint64(at), np.uint64(row + at)
    for i in range(np.uint64(count)):
        predicted[u + i] += corrections[v + i] * factor
        width[u + i] += abs(corrections[v + i]) * share


@routine
def mixed(
    near: Numbers, far: Numbers, slope: Numbers, bend: Numbers, unrest: Numbers, corrections: Numbers,
    before: int, new: IntArray, axis: int, factors: Numbers, shares: Numbers, b: Numbers, predicted: Numbers,
    width: Numbers,
) -> None:  # fmt: skip
    """Predictions and expected errors of one channel's new nodes, whose dimensions are ``new``, along
    ``axis``.

    corrections : of the ``before`` channels before this one, one after the other. factors : of the
    prediction, one for each of the sums of :class:`fitter.compression.stages.Neighbours` and for each
    correction; shares : of the width, see :meth:`fitter.compression.rules.Seen.width`. b : (SCRATCH,).
    """
    axes = len(new)
    last = axes - 1
    row, nodes, others = new[last], 1, 0
    strides = np.ones(axes, np.int64)
    for k in range(last, -1, -1):
        strides[k] = nodes
        nodes *= new[k]
        others += int(k != axis and new[k] > 1)
    rows_count = last != axis and row > 1
    share = near.dtype.type(0.5 / max(1, others))
    whole, nothing = near.dtype.type(1), near.dtype.type(0)
    final = 1 + 3 * others + others * (others - 1) // 2
    low, high = np.zeros((2, axes), np.int64), np.zeros((2, axes), np.int64)
    index = np.zeros(axes, np.int64)
    at = begin = 0
    while at < nodes:
        for k in range(last):
            if k != axis and new[k] > 1:
                for s in range(2):
                    low[s, k] = (mirrored(index[k] - 1 - s, new[k]) - index[k]) * strides[k]
                    high[s, k] = (mirrored(index[k] + 1 + s, new[k]) - index[k]) * strides[k]
        # Rows whose neighbours are all there are a run, unless those along the row count, too.
        rows, count = 1, min(row - begin, RUN)
        if last > 0 and not rows_count and row <= RUN:
            k = last - 1
            rows = new[k] - index[k]
            if k != axis and new[k] > 1:
                rows = max(rows - 2, 1) if index[k] > 1 else 1
            rows = min(rows, RUN // row)
            count = rows * row
        wide = (count + BLOCK - 1) // BLOCK * BLOCK
        begun(near, far, at, wide, factors, b)
        first = 2
        for k in range(last):
            if k != axis and new[k] > 1:
                ends = at + low[0, k], at + high[0, k], at + low[1, k], at + high[1, k]
                beside(near, far, unrest, ends, wide, factors, first, b)
                first += 3
        if rows_count:
            start = at - begin
            padded(near, start, start, begin, count, row, _NEAR_ROW, b)
            padded(far, start, start, begin, count, row, _FAR_ROW, b)
            padded(unrest, start, start, begin, count, row, _UNREST_ROW, b)
            along(wide, factors, first, b)
            first += 3
        for j in range(last):
            if j != axis and new[j] > 1:
                one, other = at + low[0, j], at + high[0, j]
                for k in range(j + 1, last):
                    if k != axis and new[k] > 1:
                        ends = one + low[0, k], other + low[0, k], one + high[0, k], other + high[0, k]
                        spreads = whole if first % 3 == 2 and first < final else nothing
                        diagonal(near, ends, wide, factors[first], spreads, b)
                        first += 1
                if rows_count:
                    padded(near, one - begin, other - begin, begin, count, row, _SUM_ROW, b)
                    spreads = whole if first % 3 == 2 and first < final else nothing
                    diagonal_along(wide, factors[first], spreads, b)
                    first += 1
        ended(unrest, slope, bend, at, wide, share, shares, b, predicted, width)
        for k in range(before):
            corrected_by(
                corrections, k * nodes, at, wide, factors[first + k], shares[6 + k], predicted, width
            )
        at += count
        begin += count
        if begin >= row:
            begin = 0
            if last > 0:
                index[last - 1] += rows
            for k in range(last - 1, 0, -1):
                if index[k] == new[k]:
                    index[k] = 0
                    index[k - 1] += 1


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
            p, q, r = np.uint64(o * n), np.uint64(o * count), np.uint64(o * both)
            for i in range(np.uint64(count)):
                found[r + i + i] = known[p + i]
                found[r + i + i + np.uint64(1)] = new[q + i]
            if n > count:
                found[o * both + 2 * count] = known[o * n + count]
            continue
        for r in range(n):
            p, q = np.uint64((o * both + 2 * r) * inner), np.uint64((o * n + r) * inner)
            for i in range(np.uint64(inner)):
                found[p + i] = known[q + i]
        for r in range(count):
            p, q = np.uint64((o * both + 2 * r + 1) * inner), np.uint64((o * count + r) * inner)
            for i in range(np.uint64(inner)):
                found[p + i] = new[q + i]
