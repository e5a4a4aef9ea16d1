"""LargeTable: a table that does not fit into memory, of which one pass tells what a fit needs to know."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import progress as reports
from fitter.domain import Domain
from fitter.errors import TableError
from fitter.formats.read_options import ReadOptions, read_options
from fitter.formats.stream import ROWS, Part, parts
from fitter.metadata import Channel, Metadata, Symmetry
from fitter.repeats import RepeatEstimate
from fitter.reservoir import STRATA, Reservoir
from fitter.table import Table

FloatArray = NDArray[np.float64]
#: Samples of the weighted sample that is kept in memory, at most.
SAMPLE = 1 << 18
#: Why samples of a part are masked in which none is usable: what is wrong with each is not told.
NONE_USABLE = "in a part without a usable sample"


@dataclass(frozen=True)
class Totals:
    """Exact sums over a large table.

    masked : counts by reason, as in ``Metadata.masked``. negative : samples, usable or not, with a negative
    value. lowest, highest, mean : (C,) 1/sr of the usable samples; spread : their squared differences from
    the mean, summed over the channels, too. repeats : see :class:`fitter.repeats.RepeatEstimate`.
    """

    samples: int
    usable: int
    negative: int
    masked: Mapping[str, int]
    lowest: FloatArray
    highest: FloatArray
    mean: FloatArray
    spread: float
    repeats: RepeatEstimate


@dataclass(frozen=True)
class LargeTable:
    """A file of samples read part by part: what :func:`open_large` gives.

    sample : a stratified sample of the usable ones as a Table; weight : (n,) how many each stands for.
    symmetry, domain, metadata : as of a Table; ``domain.incidences`` and ``in_plane`` are the sample's.
    """

    path: Path
    options: ReadOptions
    rows: int
    seed: int
    totals: Totals
    sample: Table
    weight: FloatArray
    symmetry: Symmetry
    domain: Domain
    metadata: Metadata

    def __len__(self) -> int:
        return self.totals.samples

    @property
    def channels(self) -> tuple[Channel, ...]:
        return self.sample.channels

    @property
    def sigma(self) -> FloatArray | None:
        """The sample's: not None where the table states uncertainties."""
        return self.sample.sigma

    @property
    def usable(self) -> int:
        """How many samples are usable."""
        return self.totals.usable

    def parts(self) -> Iterator[Table]:
        """The table's parts that have usable samples, in the file's order."""
        for part in parts(self.path, self.options, self.rows):
            if part.table is not None:
                yield part.table

    @cached_property
    def hash(self) -> str:
        """sha256 of the file and of how it is read: not the hash of the Table that it would be in memory."""
        digest = hashlib.sha256(repr(sorted(self.options.to_dict().items())).encode())
        with self.path.open("rb") as file:
            while block := file.read(1 << 22):
                digest.update(block)
        return digest.hexdigest()


def open_large(
    path: str | os.PathLike[str], *, seed: int = 0, rows: int = ROWS, sample: int = SAMPLE,
    progress: reports.Progress = reports.ignore, **options: Any,
) -> LargeTable:  # fmt: skip
    """Read a Parquet or delimited file once, part by part, and keep only sums and a weighted sample.

    Parameters
    ----------
    seed : of the sample. rows : in memory at a time. sample : how many are kept at most.
    options : those of :func:`fitter.load`; ``item`` is not among them, a file is one table here. Repeated
        geometries are not masked but estimated.
    progress : called with (share, text), the share always 0: how many rows there are is seen at the end.

    Raises
    ------
    TableError : as :func:`fitter.load`; a format that is not read in parts; nothing usable.
    """
    chosen = read_options(options)
    name = Path(path).name
    if chosen.item is not None:
        raise TableError(
            "a large file is one table", code="table-several", file=name, parameter="item",
            remedy="leave item out, and declare the column of items as 'ignore'",
        )  # fmt: skip
    survey = _Survey(Reservoir(max(1, sample // STRATA), seed))
    for part in parts(path, chosen, rows):
        survey.add(part)
        progress(0.0, f"{survey.samples:,} samples")
    if survey.first is None:
        raise TableError(
            f"none of the {survey.samples:,} samples is usable", code="table-nothing-usable", file=name,
            cause="a wrong unit, quantity or convention, or a file of fill values",
            remedy="check how the columns were declared",
        )  # fmt: skip
    return survey.finish(Path(path), chosen, rows, seed)


class _Survey:
    """What is summed while the parts pass by."""

    def __init__(self, reservoir: Reservoir) -> None:
        self.reservoir = reservoir
        self.repeats = RepeatEstimate()
        self.first: Table | None = None
        self.samples = self.usable = self.negative = 0
        self.anisotropic = False
        self.stated: Symmetry | None = None
        self.masked: dict[str, int] = {}
        self.cosines: list[tuple[float, float, float, float]] = []
        self.ranges: list[tuple[FloatArray, FloatArray]] = []
        self.sums = np.zeros((2, 0))

    def add(self, part: Part) -> None:
        table, rows = part.table, part.rows
        self.samples += rows
        if table is None:
            self.masked[NONE_USABLE] = self.masked.get(NONE_USABLE, 0) + rows
            return
        for reason, count in table.metadata.masked.items():
            self.masked[reason] = self.masked.get(reason, 0) + count
        self.negative += int(np.count_nonzero((table.value < 0).any(axis=1)))
        self.stated = part.symmetry
        self.anisotropic |= table.symmetry == "anisotropic"
        usable = table.mask if not table.mask.all() else slice(None)
        value, wi, wo = table.value[usable], table.wi[usable], table.wo[usable]
        self.usable += len(value)
        if self.first is None:
            self.first, self._shift = table, value.mean(axis=0)
            self.sums = np.zeros((2, value.shape[1]))
        self.sums += np.stack([(value - self._shift).sum(axis=0), np.square(value - self._shift).sum(axis=0)])
        self.ranges.append((value.min(axis=0), value.max(axis=0)))
        zi, zo = wi[:, 2], wo[:, 2]
        self.cosines.append((float(zi.min()), float(zi.max()), float(zo.min()), float(zo.max())))
        self.repeats.add(wi, wo)
        self.reservoir.add(table)

    def finish(self, path: Path, options: ReadOptions, rows: int, seed: int) -> LargeTable:
        first, kept = self.first, self.reservoir.rows
        assert first is not None
        assert kept is not None
        count = len(first.channels)
        metadata = first.metadata.but(masked=self.masked, sha256="")
        stated = first.sigma is not None
        sample = Table(
            wi=kept[:, 2:5], wo=kept[:, 5:8], value=kept[:, 8 : 8 + count],
            sigma=kept[:, 8 + count :] if stated else None, channels=first.channels,
            symmetry=self.stated or ("anisotropic" if self.anisotropic else None),
            metadata=replace(metadata, masked={}), negatives="keep", duplicates="keep",
        )  # fmt: skip
        bounds = np.array(self.cosines)
        ends = [bounds[:, 1].max(), bounds[:, 0].min(), bounds[:, 3].max(), bounds[:, 2].min()]
        a, b, c, d = (float(np.arccos(np.clip(z, -1.0, 1.0))) for z in ends)
        mean = self.sums[0] / self.usable
        lowest, highest = (np.array([pair[k] for pair in self.ranges]) for k in (0, 1))
        totals = Totals(
            self.samples, self.usable, self.negative, self.masked, lowest.min(axis=0), highest.max(axis=0),
            mean + self._shift, float((self.sums[1] - self.usable * mean**2).sum()), self.repeats,
        )  # fmt: skip
        domain = replace(sample.domain, theta_i=(a, b), theta_o=(c, d))
        return LargeTable(
            path, options, rows, seed, totals, sample, self.reservoir.weight, sample.symmetry, domain,
            metadata,
        )  # fmt: skip
