"""The order in which a tile's nodes become known, and the neighbours that each stage predicts from.

One node is known at first. Stage by stage the grid of known nodes is halved along one axis: the nodes between
two known ones are predicted from all known nodes around them and corrected. Prediction from both sides
averages noise, which a predictor that runs along the rows can't, and a whole stage is a few array operations.
The scheme is that of interpolation-based compressors (Zhao et al., "Optimizing error-bounded lossy
compression for scientific data by dynamic spline interpolation", ICDE 2021).

Everything here is done by additions and multiplications of floating-point numbers alone, element by element:
the decoder has to come to the very numbers of the encoder, on every machine.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: float32 or float64: arrays of one tile have one type.
Numbers = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Stage:
    """Nodes that become known together: those between two known ones along ``axis``.

    target : index expression for an array (C, *shape) of a tile: the new nodes. count : along the axis.
    number : of the stage, from 0.
    """

    number: int
    axis: int
    count: int
    target: tuple[slice, ...]


def stages(shape: Sequence[int]) -> Iterator[Stage]:
    """The stages of a tile of this shape, coarse to fine; after them every node is known."""
    step = 1 << max(0, max(n - 1 for n in shape).bit_length() - 1)
    number = 0
    while step:
        for axis, n in enumerate(shape):
            if step < n:
                # Axes before this one have been halved at this step already.
                rows = [slice(None, None, step if k < axis else 2 * step) for k in range(len(shape))]
                rows[axis] = slice(step, None, 2 * step)
                yield Stage(number, axis, len(range(step, n, 2 * step)), (slice(None), *rows))
                number += 1
        step //= 2


def woven(stage: Stage, known: Numbers, new: Numbers) -> Numbers:
    """The grid of known nodes after a stage: ``new`` ones between those ``known`` before."""
    axis = stage.axis + 1
    shape = list(known.shape)
    shape[axis] += stage.count
    found = np.empty(shape, known.dtype)
    found[_at(axis, slice(0, None, 2))] = known
    found[_at(axis, slice(1, None, 2))] = new
    return found


@dataclass(frozen=True)
class Neighbours:
    """What the new nodes of one stage see, each (C, *nodes).

    sums : of known nodes, ``counts`` of them each. The first is that of the two next ones along the axis, the
        second of the two behind those; then for each other axis the next four, the next four two rows off and
        those three steps along; then for each pair of other axes the next eight.
    slope, bend : |difference| of the two next nodes, and what the two behind them add to it.
    unrest : of ``error``, the known nodes' own errors of prediction: the sum over the two next nodes.
    around : the mean of the same over the rows beside, zero where there are none.
    """

    sums: list[Numbers]
    counts: list[int]
    slope: Numbers
    bend: Numbers
    unrest: Numbers
    around: Numbers


def neighbours(stage: Stage, known: Numbers, error: Numbers) -> Neighbours:
    """The neighbours of a stage's nodes; known, error : (C, *known nodes)."""
    axis, count = stage.axis + 1, stage.count
    near = _pair(np.add, known, axis, count, 0, 1)
    far = _pair(np.add, known, axis, count, -1, 2)
    slope = _pair(np.subtract, known, axis, count, 1, 0)
    bend = _pair(np.subtract, known, axis, count, 2, -1)
    bend -= slope
    across = [k for k in range(1, known.ndim) if k != axis and near.shape[k] > 1]
    beside = {k: _beside(near, k, 1) for k in across}
    sums, counts = [near, far], [2, 2]
    for k in across:
        sums += [beside[k], _beside(near, k, 2), _beside(far, k, 1)]
        counts += [4, 4, 4]
    for j, k in combinations(across, 2):
        sums.append(_beside(beside[j], k, 1))
        counts.append(8)
    unrest = _pair(np.add, error, axis, count, 0, 1)
    around = np.zeros_like(unrest)
    for k in across:
        around += _beside(unrest, k, 1)
    around *= around.dtype.type(0.5 / max(1, len(across)))
    return Neighbours(sums, counts, np.abs(slope, out=slope), np.abs(bend, out=bend), unrest, around)


def _pair(work: Any, known: Numbers, axis: int, count: int, first: int, second: int) -> Numbers:
    """``work`` of the known nodes ``first`` and ``second`` steps from the one before each new node; the nodes
    at the ends stand for those beyond."""
    last = known.shape[axis] - 1
    shape = list(known.shape)
    shape[axis] = count
    found = np.empty(shape, known.dtype)
    low, high = min(first, second), max(first, second)
    start, stop = max(0, -low), min(count, last + 1 - high)
    if stop > start:
        inner = (known[_at(axis, slice(start + k, stop + k))] for k in (first, second))
        work(*inner, out=found[_at(axis, slice(start, stop))])
    for row in (*range(min(start, count)), *range(max(stop, start), count)):
        ends = (known[_at(axis, min(max(row + k, 0), last))] for k in (first, second))
        found[_at(axis, row)] = work(*ends)
    return found


def _beside(values: Numbers, axis: int, step: int) -> Numbers:
    """The sum of the nodes ``step`` rows to either side along ``axis``, mirrored at the ends."""
    n = values.shape[axis]
    found = np.empty_like(values)
    inner = range(step, n - step)
    if inner:
        both = values[_at(axis, slice(0, n - 2 * step))], values[_at(axis, slice(2 * step, n))]
        np.add(*both, out=found[_at(axis, slice(step, n - step))])
    for row in range(n):
        if row not in inner:
            one, other = (values[_at(axis, _mirrored(row + way, n))] for way in (-step, step))
            np.add(one, other, out=found[_at(axis, row)])
    return found


def _mirrored(row: int, n: int) -> int:
    """The row that stands for one beyond the ends, which lie half a step outside the first and last."""
    row %= 2 * n
    return row if row < n else 2 * n - 1 - row


def _at(axis: int, index: int | slice) -> tuple[int | slice, ...]:
    return (*(slice(None),) * axis, index)
