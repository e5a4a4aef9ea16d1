"""What a fit uses of a table that stays in its file: a weighted sample, and blocks that each pass reads."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fitter.errors import FitError
from fitter.fitting import metrics
from fitter.fitting.blocks import Block, Blocks
from fitter.fitting.samples import IntArray, Usable, systematic
from fitter.fitting.usable import usable
from fitter.large import LargeTable
from fitter.reservoir import STRATA, strata
from fitter.spec import Metric, Select
from fitter.table import Table

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class FromFile(Usable):
    """A :class:`Usable` whose ``table`` is the sample; all samples come from the file.

    stands_for : (n,) how many samples of the table each of the sample stands for. count : of the table's that
    are used.
    """

    large: LargeTable
    select: Select
    anisotropic: bool
    stands_for: FloatArray
    count: int

    def __len__(self) -> int:
        return self.count

    def fits_in(self, size: int) -> bool:
        """Also not where the file holds more than the sample."""
        return len(self.index) == self.count <= size

    def subset(self, size: int, seed: int) -> tuple[IntArray, FloatArray]:
        """Of the sample, see :meth:`Usable.subset`; the weights are those of the table's samples."""
        n = len(self.index)
        if n <= size:
            return np.arange(n), self.stands_for
        p = self.chances(np.arange(n), self.stands_for)
        return systematic(p, self.stands_for, size, seed)

    def blocks_of_some(self, channels: Sequence[int]) -> tuple[Blocks, int]:
        return self.blocks(channels), 1

    def blocks(self, channels: Sequence[int]) -> _Blocks:
        """All samples of the channels, read when they are gone through."""
        return _Blocks(self, tuple(channels))

    def of(self, part: Table) -> Usable:
        """What is used of one part of the table."""
        return usable(part, self.metric, self.select, anisotropic=self.anisotropic, floor=self.floor)


@dataclass(frozen=True)
class _Blocks:
    data: FromFile
    channels: tuple[int, ...]

    @property
    def samples(self) -> int:
        return len(self.data)

    def __iter__(self) -> Iterator[Block]:
        found = 0
        for part in self.data.large.parts():
            # What a table says of its symmetry is said of all of it, not of a part.
            part.symmetry = self.data.large.symmetry
            for block in self.data.of(part).blocks(self.channels):
                found += block.count
                yield block
        if found != len(self.data):
            raise FitError(
                f"the file holds {found:,} usable samples now and held {len(self.data):,}",
                code="file-changed", cause="it was written to meanwhile", remedy="fit it when it is whole",
            )  # fmt: skip


def from_file(table: LargeTable, metric: Metric, select: Select, *, anisotropic: bool = False) -> FromFile:
    """As :func:`fitter.fitting.usable.usable`. The metric's floor is the sample's; where samples are left
    out, a pass over the file counts them. Raises SpecError or FitError."""
    by_stratum = np.zeros(STRATA)
    by_stratum[strata(table.sample.wi, table.sample.wo)] = table.weight
    some = usable(table.sample, metric, select, anisotropic=anisotropic)
    floor = metrics.LOG_FLOOR * _typical(some.value, by_stratum[_strata(some)])
    some = usable(table.sample, metric, select, anisotropic=anisotropic, floor=floor)
    stands_for = by_stratum[_strata(some)]
    data = FromFile(
        some.metric, some.weighting, some.table, some.index, some.used, some.channels, some.floor,
        some.summary._replace(spread=_spread(table, some, stands_for)), some.turn, None, {}, table, select,
        anisotropic, stands_for, table.usable,
    )  # fmt: skip
    if select.theta_i_max_deg is None and select.theta_o_max_deg is None and metric not in metrics.POSITIVE:
        return data
    count, left_out = 0, dict[str, int]()
    for part in table.parts():
        used = data.of(part)
        count += len(used)
        for why, n in used.left_out.items():
            left_out[why] = left_out.get(why, 0) + n
    return replace(data, count=count, left_out=left_out)


def _spread(table: LargeTable, some: Usable, stands_for: FloatArray) -> FloatArray:
    """The spread of the values: of the whole table where all of it is used, else the sample's estimate."""
    mean = np.average(some.value, axis=0, weights=stands_for)
    estimate = stands_for @ np.square(some.value - mean)
    whole = len(some.index) == len(table.sample) and len(some.channels) == len(table.channels)
    # Of the whole table only the sum over the channels is known.
    return estimate * (table.totals.spread / max(float(estimate.sum()), 1e-300)) if whole else estimate


def _strata(data: Usable) -> NDArray[np.intp]:
    return strata(data.pair[:3].T, data.pair[3:].T)


def _typical(value: FloatArray, weight: FloatArray) -> FloatArray:
    """(C,) the median |value| of (n, C) samples that stand for ``weight`` (n,) each, else their mean."""
    found: list[float] = []
    for column in np.abs(value).T:
        order = np.argsort(column)
        middle = np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum())
        found.append(float(column[order[middle]]) or float(np.average(column, weights=weight)) or 1.0)
    return np.array(found)
