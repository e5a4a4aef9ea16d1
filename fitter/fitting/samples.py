"""The usable samples of a table, as blocks of all or of a part of them, or as a weighted subset."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.fitting import aligned, metrics
from fitter.fitting.blocks import BLOCK, Block, Blocks, BlocksMade
from fitter.grid import Grid
from fitter.spec import Metric, Weighting
from fitter.summary import Summary
from fitter.table import Table

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
#: Of more samples than this an evenly spaced part stands for all where a typical value, or where the energy
#: lies, is asked for.
ENOUGH = 131_072
#: Fewer rows of a grid than this are no fair part of it.
FEW_LINES = 256
#: Turning from one sample to the next, of a turn: azimuths that fill the circle evenly.
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


@dataclass(frozen=True)
class Usable:
    """What a fit uses of a table: n usable, selected samples.

    metric, weighting : whose weights they are. index : (n,) of the samples in the table.
    used : (N,) which samples of the table they are. channels : positions in the table.
    floor : (C,) of the metric. summary : of the values, (C,).
    turn : whether directions are turned about the normal, see :func:`fitter.fitting.usable.usable`.
    measure : (N,) what each sample of the table counts, None where all count alike.
    left_out : counts by reason of usable samples not used.
    """

    metric: Metric
    weighting: Weighting
    table: Table
    index: IntArray
    used: NDArray[np.bool_]
    channels: tuple[int, ...]
    floor: FloatArray
    summary: Summary
    turn: bool
    measure: FloatArray | None
    left_out: dict[str, int]

    @property
    def likelihood(self) -> bool:
        """Whether the objective is minus twice the logarithm of the likelihood, up to a constant."""
        return self.metric == "measurement" and self.weighting == "samples"

    def __len__(self) -> int:
        return len(self.index)

    @cached_property
    def pair(self) -> FloatArray:
        """(6, n) components of all directions."""
        return self._pair(self.index)

    @cached_property
    def value(self) -> FloatArray:
        """(n, C) values."""
        return self.table.value[self.index][:, self._columns(range(len(self.channels)))]

    @cached_property
    def sigma(self) -> FloatArray | None:
        """(n, C) standard uncertainties, None where the table states none."""
        columns = self._columns(range(len(self.channels)))
        return None if self.table.sigma is None else self.table.sigma[self.index][:, columns]

    @cached_property
    def weight(self) -> FloatArray:
        """(n, C) weights."""
        block = self.part(range(len(self.channels)), slice(None), len(self.index))
        return np.broadcast_to(block.weight, block.y.shape).T

    def _pair(self, index: IntArray) -> FloatArray:
        return self._turned(np.concatenate([w.T for w in self.table.directions(index)]), index)

    def _turned(self, pair: FloatArray, index: IntArray) -> FloatArray:
        if not self.turn:
            return pair
        angle = 2 * np.pi * np.mod(index * GOLDEN, 1.0)
        c, s = np.cos(angle), np.sin(angle)
        return np.concatenate([directions.turned(w.T, c, s).T for w in (pair[:3], pair[3:])])

    def _columns(self, channels: Sequence[int]) -> slice | list[int]:
        """Positions in the table of channels given by their position among the selected."""
        picked = [self.channels[c] for c in channels]
        # Basic slices of whole columns are views; a list of channels would copy the table.
        return slice(None) if picked == list(range(self.table.value.shape[1])) else picked

    def part(
        self, channels: Sequence[int], rows: slice | IntArray, size: int, scale: FloatArray | None = None
    ) -> Block:
        """The samples ``rows`` of the channels (positions among the selected), padded to ``size``.

        ``scale`` multiplies the squared residuals of the samples of a weighted subset.
        """
        index = self.index[rows]
        pair = aligned.empty((6, size))
        pair[:, : len(index)] = self._pair(index)
        pair[:, len(index) :] = pair[:, len(index) - 1 : len(index)]
        return self._block(channels, pair, index, scale=scale)

    def lines(self, channels: Sequence[int], lines: slice | IntArray, size: int) -> Block:
        """The cells of whole rows of a grid's last axis, as they lie in the table."""
        grid = self.table.grid
        assert grid is not None
        width = grid.shape[-1]
        which = np.arange(*lines.indices(grid.rows)) if isinstance(lines, slice) else lines
        count = len(which) * width
        pair = aligned.empty((6, size))
        grid.row_components(which, pair[:, :count])
        pair[:, count:] = pair[:, count - 1 : count]
        # A slice of the table is no copy of it.
        cells: slice | IntArray = slice(int(which[0]) * width, int(which[0]) * width + count)
        if not isinstance(lines, slice):
            cells = (which[:, None] * width + np.arange(width)).reshape(-1)
        if self.turn:
            each = np.arange(cells.start, cells.stop) if isinstance(cells, slice) else cells
            pair[:, :count] = self._turned(pair[:, :count], each)
        return self._block(channels, pair, cells, self.used[cells])

    def _block(
        self, channels: Sequence[int], pair: FloatArray, rows: slice | IntArray,
        used: NDArray[np.bool_] | None = None, scale: FloatArray | None = None,
    ) -> Block:  # fmt: skip
        columns, size = self._columns(channels), pair.shape[1]
        values = self.table.value[rows][:, columns]
        y = _filled(values.T, used, size, 0.0)
        stated = self.table.sigma if self.metric == "measurement" else None
        sigma = None if stated is None else _filled(stated[rows][:, columns].T, used, size, 1.0)
        measure = None if self.measure is None else np.ones(size)
        count = len(values)
        if measure is not None and self.measure is not None:
            measure[:count] = self.measure[rows]
        weight = metrics.base_weights(self.metric, sigma, pair[2], measure)
        if scale is not None:
            weight[:, : len(scale)] *= np.sqrt(scale)
        weight[:, count:] = 0.0
        if used is not None:
            weight[:, :count] *= used
        return Block(pair, y, weight, count)

    def blocks(self, channels: Sequence[int]) -> Blocks:
        """All samples of the channels: by rows of a grid most of which is used, which is cheaper than picking
        samples."""
        grid = self.table.grid
        if grid is not None and self._by_lines(grid):
            return self.blocks_of_lines(channels, BLOCK // grid.shape[-1])
        return BlocksMade(lambda here: self.part(channels, here, BLOCK), len(self), BLOCK, len(self))

    def blocks_of_lines(self, channels: Sequence[int], each: int) -> BlocksMade:
        """All samples of the channels, by rows of the grid's last axis, ``each`` so many."""
        assert self.table.grid is not None
        rows = self.table.grid.rows
        return BlocksMade(lambda here: self.lines(channels, here, BLOCK), rows, each, len(self))

    def _by_lines(self, grid: Grid) -> bool:
        return 2 * len(self) >= grid.size and grid.shape[-1] <= BLOCK

    def blocks_of_some(self, channels: Sequence[int]) -> tuple[Blocks, float]:
        """Of a large table an evenly spaced part, and how many samples each of it stands for."""
        grid, step = self.table.grid, max(1, len(self) // ENOUGH)
        if step == 1:
            return self.blocks(channels), 1.0
        if grid is not None and self._by_lines(grid) and grid.rows >= FEW_LINES * step:
            # Whole rows of the grid: to make samples one by one takes ten times as long.
            width = grid.shape[-1]
            step = _coprime(step, grid.shape[-2])
            lines = np.arange(step // 2, grid.rows, step)
            seen = max(1, int(np.count_nonzero(self.used.reshape(-1, width)[lines])))
            made = BlocksMade(
                lambda here: self.lines(channels, lines[here], BLOCK), len(lines), BLOCK // width, seen
            )
            return made, len(self) / seen
        rows, step = self.evenly(ENOUGH)
        made = BlocksMade(lambda here: self.part(channels, rows[here], BLOCK), len(rows), BLOCK, len(rows))
        return made, step

    def evenly(self, most: int) -> tuple[IntArray, int]:
        """About ``most`` evenly spaced positions at least, and the step between them."""
        grid = self.table.grid
        step = _coprime(max(1, len(self) // most), 1 if grid is None else grid.shape[-1])
        return np.arange(step // 2, len(self), step), step

    def fits_in(self, size: int) -> bool:
        """Whether a subset of so many samples is all of them."""
        return len(self) <= size

    def subset(self, size: int, seed: int) -> tuple[IntArray, FloatArray]:
        """Positions and weights of a systematic sample, half uniform, half by squared value.

        Systematic sampling with probability proportional to size: a sample taken k times with
        inclusion probability m p stands for k/(m p) samples. Of a large table an evenly spaced part is
        sampled so.
        """
        if len(self) <= size:
            return np.arange(len(self)), np.ones(len(self))
        rows, step, p = self._pool if 4 * size <= ENOUGH else self._pooled(4 * size)
        chosen, scale = systematic(p, np.full(len(rows), float(step)), size, seed)
        return rows[chosen], scale

    @cached_property
    def _pool(self) -> tuple[IntArray, int, FloatArray]:
        return self._pooled(ENOUGH)

    def _pooled(self, most: int) -> tuple[IntArray, int, FloatArray]:
        """About ``most`` positions to draw from, the step between them, and the chances of each."""
        rows, step = self.evenly(most)
        return rows, step, self.chances(rows, np.full(len(rows), float(step)))

    def chances(self, rows: IntArray, weight: FloatArray) -> FloatArray:
        """The chances, 1 in all, of samples ``rows`` that stand for ``weight`` each to be drawn."""
        block = self.part(range(len(self.channels)), rows, len(rows))
        p = 0.5 * weight / weight.sum()
        # By the metric and plainly: with noise in proportion to the value all samples weigh the same, and a
        # lobe that only few of them see would be lost.
        for seen in (block.weight * block.y, block.y):
            energy = weight * np.square(seen).sum(axis=0)
            # No sample counts for more than 100 times its share: glints must not fill the subset.
            energy = np.minimum(energy, 100 * energy.mean())
            p += 0.25 * energy / max(energy.sum(), 1e-300)
        return p / p.sum()


def systematic(
    p: FloatArray, weight: FloatArray, size: int, seed: int
) -> tuple[IntArray, FloatArray]:
    """Which of the samples that stand for ``weight`` (n,) are drawn with the chances ``p``, and for how many
    each of those stands."""
    offset = np.random.default_rng(seed).random()
    picked = np.searchsorted(np.cumsum(p), (np.arange(size) + offset) / size).clip(0, len(p) - 1)
    chosen, times = np.unique(picked, return_counts=True)
    return chosen, weight[chosen] * times / (size * p[chosen])


def _coprime(step: int, width: int) -> int:
    """The largest step up to ``step`` that has no divisor in common with the length of a grid's rows, or the
    same columns would be met again and again."""
    while math.gcd(step, width) > 1:
        step -= 1
    return step


def _filled(
    values: FloatArray, used: NDArray[np.bool_] | None, size: int, fill: float
) -> FloatArray:
    """(C, size) values (C, m) where they are used, ``fill`` elsewhere and behind them."""
    found = aligned.empty((len(values), size))
    found[...] = fill
    np.copyto(found[:, : values.shape[1]], values, where=True if used is None else used)
    return found
