"""The usable samples of a table as blocks of component arrays, whole or a weighted subset.

Nothing is expanded beforehand: directions and weights of a block are made when it is asked for, so
that a fit needs little memory beside the table, whatever its size.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, TypeAlias, overload, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.fitting import aligned, metrics
from fitter.grid import Grid
from fitter.spec import Metric, Weighting
from fitter.summary import Summary
from fitter.table import Table

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
#: Samples a block holds. One length for all, so that one program serves every table.
BLOCK = 65_536
#: Of more samples than this an evenly spaced part stands for all where a typical value, or where the energy
#: lies, is asked for.
ENOUGH = 131_072
#: Fewer rows of a grid than this are no fair part of it.
FEW_LINES = 256
#: Turning from one sample to the next, of a turn: azimuths that fill the circle evenly.
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


def padded(samples: int) -> int:
    """What a subset of so many samples is padded to: a power of two, so that few lengths are compiled for."""
    return max(1024, 1 << (samples - 1).bit_length())


@dataclass(frozen=True)
class Block:
    """Samples padded to one length; padding, and what of a grid is not usable, has weight 0.

    Channels come first: three to a row are no length for the processor's vectors.

    pair : (6, B) components of wi and wo. y : (C, B) values.
    weight : (C, B), or (1, B) where the channels have the same.
    count : samples that are not padding.
    """

    pair: FloatArray
    y: FloatArray
    weight: FloatArray
    count: int


@runtime_checkable
class Streamed(Protocol):
    """Blocks that are made anew on every pass and can't be had one by one. samples : in all of them."""

    @property
    def samples(self) -> int: ...
    def __iter__(self) -> Iterator[Block]: ...


Blocks: TypeAlias = Sequence[Block] | Streamed


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
        """All samples of the channels."""
        return TableBlocks(self, tuple(channels))

    def blocks_of_some(self, channels: Sequence[int]) -> tuple[Blocks, float]:
        """Of a large table an evenly spaced part, and how many samples each of it stands for."""
        every = TableBlocks(self, tuple(channels))
        grid, step = self.table.grid, max(1, len(self) // ENOUGH)
        if step == 1:
            return every, 1
        if grid is None or not every.by_lines or grid.rows < FEW_LINES * step:
            rows, step = self.evenly(ENOUGH)
            return replace(every, rows=rows), step
        # Whole rows of the grid: to make samples one by one takes ten times as long.
        lines = _spaced(grid.rows, step, grid.shape[-2])
        seen = np.count_nonzero(self.used.reshape(-1, grid.shape[-1])[lines])
        return replace(every, lines=lines), len(self) / max(1, seen)

    def evenly(self, most: int) -> tuple[IntArray, int]:
        """About ``most`` evenly spaced positions at least, and the step between them."""
        grid = self.table.grid
        rows = _spaced(len(self), max(1, len(self) // most), 1 if grid is None else grid.shape[-1])
        return rows, int(rows[1] - rows[0]) if len(rows) > 1 else 1

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


def _spaced(count: int, step: int, width: int) -> IntArray:
    """Evenly spaced places among ``count``: the largest step up to ``step`` that has no divisor in common
    with the length of a grid's rows, or the same columns would be met again and again."""
    while np.gcd(step, width) > 1:
        step -= 1
    return np.arange(step // 2, count, step)


@dataclass(frozen=True)
class TableBlocks(Sequence[Block]):
    """All samples block by block, or those at the positions ``rows``, or the rows ``lines`` of the grid's
    last axis; each block made when it is asked for.

    cells : how many cells of a grid a block covers, whole rows of its last axis; None leaves it to the table.
    """

    data: Usable
    channels: tuple[int, ...]
    cells: int | None = None
    rows: IntArray | None = None
    lines: IntArray | None = None

    @property
    def samples(self) -> int:
        """How many there are, of a grid's ``lines`` what is not usable counted."""
        if self.lines is not None and self.data.table.grid is not None:
            return len(self.lines) * self.data.table.grid.shape[-1]
        return len(self.data) if self.rows is None else len(self.rows)

    @property
    def by_lines(self) -> bool:
        """Whether blocks are made of a grid's rows: where most of it is used, that is cheaper than picking
        samples."""
        grid = self.data.table.grid
        if grid is None or self.rows is not None:
            return False
        return self.cells is not None or (2 * len(self.data) >= grid.size and grid.shape[-1] <= BLOCK)

    def _of(self, grid: Grid) -> tuple[int, int]:
        """How many rows of the grid there are, and how many make a block."""
        whole = grid.rows if self.lines is None else len(self.lines)
        return whole, (self.cells or BLOCK) // grid.shape[-1]

    def __len__(self) -> int:
        grid = self.data.table.grid
        if grid is None or not self.by_lines:
            return -(-self.samples // BLOCK)
        whole, each = self._of(grid)
        return -(-whole // each)

    @overload
    def __getitem__(self, index: int) -> Block: ...
    @overload
    def __getitem__(self, index: slice) -> list[Block]: ...
    def __getitem__(self, index: int | slice) -> Block | list[Block]:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        k, grid = index % len(self), self.data.table.grid
        if grid is not None and self.by_lines:
            whole, each = self._of(grid)
            here = slice(k * each, min((k + 1) * each, whole))
            return self.data.lines(self.channels, here if self.lines is None else self.lines[here], BLOCK)
        here = slice(k * BLOCK, min((k + 1) * BLOCK, self.samples))
        return self.data.part(self.channels, here if self.rows is None else self.rows[here], BLOCK)

    def __iter__(self) -> Iterator[Block]:
        return (self[k] for k in range(len(self)))


def count(blocks: Blocks) -> int:
    """The samples of blocks, usable ones where that is known without making them."""
    return blocks.samples if isinstance(blocks, Streamed) else sum(block.count for block in blocks)


def _filled(
    values: FloatArray, used: NDArray[np.bool_] | None, size: int, fill: float
) -> FloatArray:
    """(C, size) values (C, m) where they are used, ``fill`` elsewhere and behind them."""
    found = aligned.empty((len(values), size))
    found[...] = fill
    np.copyto(found[:, : values.shape[1]], values, where=True if used is None else used)
    return found
