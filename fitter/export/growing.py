"""A tensor tree that is grown: cells are divided where that matters, and put together where it does not.

The reflectance that a tree says is that of cells, and a cell that covers 10 deg of a sharp lobe at grazing
incidence says little of any one of them. A grid fine enough for those has billions of cells: so cells are
averaged, the ones whose values differ most are divided, and so on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter.export.energy import scale

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

#: (level, cells (n, rank) in units of 2^-level) -> mean of f in each, its standard deviation there, and what
#: part of the whole the cell is.
Average = Callable[[int, IntArray], tuple[FloatArray, FloatArray, FloatArray]]

#: Cells are divided whose deviation is more than this part of all that is reflected.
_SHARE = 1e-6
#: Neighbours become one that differ by less than this part of their mean, or of that of all.
_SAME, _SAME_OF_ALL = 0.02, 1e-3


@dataclass
class _Level:
    """cells (n, rank); value (n,); divided: those whose halves are the next level's cells, 2^rank each."""

    cells: IntArray
    value: FloatArray
    divided: IntArray


def grown(average: Average, reflectance: FloatArray, rank: int, first: int) -> str:
    """The text of a tree whose cells are at ``first`` halvings of each side or more before those that say the
    same are put together.

    reflectance : of the incident cells (n,) or (n, n) at the deepest level, n = 2^deepest.
    """
    deepest = len(reflectance).bit_length() - 1
    corners = np.stack(np.unravel_index(np.arange(1 << rank), (2,) * rank), axis=1)
    levels = [_Level(np.zeros((1, rank), np.intp), np.zeros(1), np.zeros(1, np.intp))]
    total = 0.0
    for level in range(1, deepest + 1):
        above = levels[-1]
        cells = (2 * above.cells[above.divided][:, None, :] + corners).reshape(-1, rank)
        value, divided = np.zeros(len(cells)), np.arange(len(cells))
        if level >= first:
            value, spread, part = average(level, cells)
            total = float((value * part).sum()) if level == first else total
            divided = np.flatnonzero(spread * part > _SHARE * total)
        levels.append(_Level(cells, value, divided if level < deepest else divided[:0]))
    _scale(levels, reflectance, first)
    _join(levels, rank, _SAME_OF_ALL * total)
    return _text(levels, rank)


def _scale(levels: list[_Level], reflectance: FloatArray, first: int) -> None:
    """Scale leaves so that those of each incidence have its reflectance.

    Where a lobe is cut by the border between coarse and fine cells, what it loses to the coarse ones at one
    incidence they have too much at the next: the fine ones, which follow it, are scaled instead.
    """
    sides = reflectance.ndim
    sums: list[FloatArray] = []
    for level, entry in enumerate(levels):
        n = 1 << level
        leaf = np.ones(len(entry.value), bool)
        leaf[entry.divided] = False
        where = _incident(entry.cells, n, sides)
        whole: FloatArray = np.bincount(where[leaf], entry.value[leaf], n**sides).astype(np.float64)
        sums.append(np.asarray(whole.reshape((n,) * sides) * (np.pi / n**2), np.float64))
    for level in range(first, len(levels)):
        n = 1 << level
        fine = np.sum([_means(one, n) for one in sums[level:]], axis=0)
        coarse = np.sum([_repeats(one, n) for one in sums[:level]], axis=0)
        known = _means(reflectance, n)
        factor = scale(known, coarse, fine)
        for below in range(level, len(levels)):
            here = _repeats(factor, 1 << below)
            sums[below] = sums[below] * here
            entry = levels[below]
            entry.value *= here.reshape(-1)[_incident(entry.cells, 1 << below, sides)]


def _incident(cells: IntArray, n: int, sides: int) -> IntArray:
    """Which incident cell each is of, as one number."""
    return cells[:, 0] if sides == 1 else cells[:, 0] * n + cells[:, 1]


def _repeats(values: FloatArray, n: int) -> FloatArray:
    """Values of cells at all finer ones, n on a side."""
    for axis in range(values.ndim):
        values = np.repeat(values, n // values.shape[axis], axis=axis)
    return values


def _means(values: FloatArray, n: int) -> FloatArray:
    """Means over coarser cells, n on a side."""
    by = len(values) // n
    if values.ndim == 1:
        return values.reshape(n, by).mean(axis=1)
    return values.reshape(n, by, n, by).mean(axis=(1, 3))


def _join(levels: list[_Level], rank: int, least: float) -> None:
    """Give divided cells the mean of their halves, and undo divisions that make no difference."""
    for above, below in zip(levels[-2::-1], levels[:0:-1], strict=True):
        halves = below.value.reshape(-1, 1 << rank)
        leaf = np.ones(len(below.value), bool)
        leaf[below.divided] = False
        mean = halves.mean(axis=1)
        above.value[above.divided] = mean
        kept = np.ptp(halves, axis=1) > _SAME * mean + least
        kept |= ~leaf.reshape(halves.shape).all(axis=1)
        there = np.repeat(kept, 1 << rank)
        moved = np.cumsum(there) - 1
        below.divided = moved[below.divided]
        below.cells, below.value = below.cells[there], below.value[there]
        above.divided = above.divided[kept]


def _text(levels: list[_Level], rank: int) -> str:
    """Nested braces: halves in the order of their bits, the first side's lowest; a grid row by row."""
    order = [sum((n >> d & 1) << rank - 1 - d for d in range(rank)) for n in range(1 << rank)]
    below: list[str] = []
    leaves: set[int] = set()
    for level in reversed(levels):
        numbers = [f"{value:.5g}" for value in level.value.tolist()]
        found = dict(enumerate(numbers))
        for k, index in enumerate(level.divided.tolist()):
            own = range(k << rank, (k + 1) << rank)
            if leaves.issuperset(own):
                found[index] = "{" + " ".join(below[n] for n in own) + "}"
            else:
                halves = (k << rank | n for n in order)
                found[index] = (
                    "{" + "".join(f"{{{below[n]}}}" if n in leaves else below[n] for n in halves) + "}\n"
                )
        below = [found[n] for n in range(len(numbers))]
        leaves = set(range(len(numbers))).difference(level.divided.tolist())
    return below[0] if not leaves else f"{{{below[0]}}}"
