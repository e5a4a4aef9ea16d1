"""tradeoff: make every fit of the design, again and again in turn, and say what each cost and got wrong."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any

import numpy as np

from fitter import progress
from fitter.compression import CompressedTable, compress
from fitter.errors import FitError, SpecError
from fitter.fitting import budget, cost_model
from fitter.fitting.effort import Case
from fitter.fitting.engine import fit
from fitter.fitting.result import FitResult
from fitter.spec import ModelSpec, TradeoffSpec, tradeoff_spec
from fitter.table import Table
from fitter.tradeoffs import errors, exhaustive, posteriors, precision
from fitter.tradeoffs.design import REFERENCE_STARTS, Configuration, design, reference, usual_starts
from fitter.tradeoffs.result import Point, Tradeoff, with_fronts
from fitter.tradeoffs.split import Split, split

#: Shares of the time limit after which no further configuration, repeat or posterior is begun.
FIRST_RUNS, REPEATS, POSTERIOR = 0.65, 0.8, 0.9
#: Share of the time limit that a reference's search may take, as far as it can be foreseen.
REFERENCE_SHARE = 0.1


@dataclass
class Compressed:
    """A table at one tolerance, and what making it and reading it back took."""

    table: CompressedTable
    seconds: float
    reading: float


@dataclass
class Measured:
    """The fits of one configuration, in the order they were made: the first one had to compile."""

    configuration: Configuration
    fits: list[FitResult] = field(default_factory=list[FitResult])
    wall: list[float] = field(default_factory=list[float])


class Bench:
    """One measuring: its tables, its fits, and its time."""

    def __init__(self, spec: TradeoffSpec, table: Table, report: progress.Progress) -> None:
        self.begun = time.perf_counter()
        self.spec = spec
        self.table = table
        self.split: Split | None = split(table, spec.seed)
        self.fitted = table if self.split is None else self.split.fitted
        self.notes: list[str] = []
        if self.split is None:
            self.notes.append("fewer than three incidences: none can be held out, there is no such error")
        self._report = report
        self._compressed: dict[float, Compressed] = {}
        self.measured: list[Measured] = []
        self.references: dict[tuple[str, str | None], Measured] = {}
        self.scans: dict[tuple[str, str | None], dict[str, Any] | None] = {}
        self.skipped: list[str] = []

    def share(self) -> float:
        """Of the time limit, how much is gone."""
        return (time.perf_counter() - self.begun) / self.spec.time_limit_seconds

    def tell(self, what: str) -> None:
        self._report(min(0.99, self.share()), what)

    def first_runs(self, configurations: Sequence[Configuration]) -> None:
        """Each configuration once, with the reference that it is judged by, until the time is up."""
        for k, configuration in enumerate(configurations):
            if k and self.share() > FIRST_RUNS:
                self.skipped += [one.label for one in configurations[k:]]
                return
            try:
                one = self.run(Measured(configuration))
                if configuration.optimum not in self.references:
                    self._make_reference(one)
            except (FitError, SpecError) as error:
                if isinstance(error, progress.Cancelled) or not self.measured:
                    raise
                self.skipped.append(configuration.label)
                self.notes.append(f"{configuration.label}: {error}")
                continue
            self.measured.append(one)

    def repeats(self) -> None:
        """Every configuration again, in turn, so that all see the same machine; at least once."""
        for turn in range(1, self.spec.repeats + 1):
            for one in self.measured:
                if turn == 1 or self.share() < REPEATS:
                    self.run(one, turn)

    def run(self, one: Measured, turn: int = 0) -> Measured:
        """The configuration once more, with a seed of its own: what subsets are chosen differs."""
        configuration = one.configuration
        self.tell(configuration.label)
        table = self.table_of(configuration)
        request = configuration.fit.model_copy(update={"seed": configuration.fit.seed + turn})
        begun = time.perf_counter()
        one.fits.append(fit(table, request, progress=lambda _share, _what: self.tell(configuration.label)))
        one.wall.append(time.perf_counter() - begun)
        return one

    def table_of(self, configuration: Configuration) -> Table | CompressedTable:
        """What the configuration is fitted to."""
        tolerance = configuration.tolerance
        return self.fitted if tolerance is None else self.compressed(tolerance).table

    def compressed(self, tolerance: float) -> Compressed:
        """The fitted part of the table, compressed; made once."""
        if tolerance not in self._compressed:
            begun = time.perf_counter()
            small = compress(self.fitted, tolerance)
            made = time.perf_counter()
            small.decompress()
            self._compressed[tolerance] = Compressed(small, made - begun, time.perf_counter() - made)
        return self._compressed[tolerance]

    def _make_reference(self, usual: Measured) -> None:
        configuration = usual.configuration
        first = usual.fits[0]
        starts = usual_starts(configuration.fit, len(first.model.channels))
        each = max(1e-4, float(first.cost["phases"]["search"]) / (starts + 1))
        affordable = int(REFERENCE_SHARE * self.spec.time_limit_seconds / each)
        many = max(2 * starts, min(REFERENCE_STARTS, affordable))
        made = self.run(Measured(reference(configuration, self.fitted, many)))
        self.references[configuration.optimum] = made
        self.tell(f"{made.configuration.label}: exhaustive scan")
        self.scans[configuration.optimum] = exhaustive.scan(self.fitted, made.fits[0])


def tradeoff(
    table: Table | CompressedTable,
    model: TradeoffSpec | ModelSpec | str | Sequence[ModelSpec | str],
    *,
    progress: progress.Progress = progress.ignore,
    **settings: Any,
) -> Tradeoff:
    """Measure error against seconds and memory on this machine, for this table.

    Parameters
    ----------
    model : one model or several, or a whole TradeoffSpec, which then rules alone.
    settings : the other fields of a :class:`fitter.spec.TradeoffSpec`, as ``time_limit_seconds=60``.
    progress : called with (share, text); may raise to stop.

    Raises
    ------
    SpecError, FitError : as a fit of the first model would.
    """
    if isinstance(model, TradeoffSpec):
        spec = model
    else:
        models = [model] if isinstance(model, str | ModelSpec) else list(model)
        spec = tradeoff_spec({"models": models, **settings})
    if isinstance(table, CompressedTable):
        table = table.decompress()
    load = _load_average()
    bench = Bench(spec, table, progress)
    bench.first_runs(design(spec, bench.fitted))
    bench.repeats()
    points = _points(bench)
    first = bench.measured[0]
    points += precision.points(first.fits[-1], bench.fitted, bench.split, spec.repeats)
    found = None
    if spec.posterior and bench.share() < POSTERIOR:
        left = spec.time_limit_seconds * (1.0 - bench.share())
        found = posteriors.measure(bench.fitted, first.fits[0], left, spec.seed, bench.tell)
    elif spec.posterior:
        bench.skipped.append("posterior")
    bench.notes += _remember(bench)
    progress(1.0, "done")
    return Tradeoff(
        spec=spec, points=with_fronts(points), compression=tuple(_compression(bench, points)),
        posterior=found,
        references=tuple(_reference(bench, key) for key in bench.references), skipped=tuple(bench.skipped),
        table=_table(bench), machine={**cost_model.machine(), "load_average": [load, _load_average()]},
        noise=_noise(bench), seconds=time.perf_counter() - bench.begun, notes=tuple(bench.notes),
    )  # fmt: skip


def _points(bench: Bench) -> list[Point]:
    return [
        *(_point(bench, one) for one in bench.measured),
        *(_point(bench, one) for one in bench.references.values()),
    ]


def _point(bench: Bench, one: Measured) -> Point:
    configuration = one.configuration
    key = configuration.optimum
    best = bench.references[key].fits[0]
    domain = bench.fitted.domain.theta_i
    there = errors.reflectances(best.model, domain)
    warm = slice(1, None) if len(one.fits) > 1 else slice(None)
    wall, fits = one.wall[warm], one.fits[warm]
    if len(one.fits) == 1:  # a reference: its compiling is told apart, since it is not made twice
        wall = [one.wall[0] - float(one.fits[0].cost["phases"]["compile"])]
    names = [channel.name for channel in bench.table.channels]
    found: dict[str, list[float | None]] = {kind: [] for kind in errors.KINDS}
    for result in fits:
        columns = [names.index(name) for name in result.model.channels]
        judged = None if bench.split is None else errors.held_out(result.model, bench.split, columns)
        found["held_out"].append(judged)
        found["parameters"].append(errors.parameters(result, best))
        found["reflectance"].append(errors.reflectance(errors.reflectances(result.model, domain), there))
    spec = fits[-1].spec
    growth = [g for r in fits if (g := r.cost["memory_growth_bytes"]) is not None]
    return Point(
        axis=configuration.axis, label=configuration.label, model=spec.model.name, metric=spec.metric,
        settings={
            "subset": spec.subset, "starts": spec.starts, "solver": spec.solver, "polish": spec.polish,
            "tolerance": configuration.tolerance,
        },
        seconds={
            "min": min(wall), "median": median(wall), "repeats": float(len(wall)), "first": one.wall[0],
            "compile": float(one.fits[0].cost["phases"]["compile"]),
        },
        memory_bytes=max(growth) if growth else None,
        errors={kind: _median(values) for kind, values in found.items()},
        status=fits[-1].status,
        evidence={
            "search_error": float(median(float(r.evidence["search_error"]) for r in fits)),
            "passes": int(fits[-1].cost["passes"]),
            "starts_that_agree": [[g["agree"], g["starts"]] for g in fits[-1].evidence["groups"]],
        },
    )  # fmt: skip


def _median(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(median(known)) if known else None


def _reference(bench: Bench, key: tuple[str, str | None]) -> dict[str, Any]:
    one = bench.references[key]
    result = one.fits[0]
    return {
        "model": key[0], "metric": key[1], "status": result.status, "starts": one.configuration.fit.starts,
        "subset": one.configuration.fit.subset, "objective": float(result.metrics["objective"]),
        "relative_rmse": float(result.metrics["relative_rmse"]),
        "starts_that_agree": [[g["agree"], g["starts"]] for g in result.evidence["groups"]],
        "second_basin": [g["second_basin"] for g in result.evidence["groups"]],
        "scan": bench.scans[key],
    }  # fmt: skip


def _compression(bench: Bench, points: Sequence[Point]) -> list[dict[str, Any]]:
    """Bytes against errors, one row a tolerance."""
    rows: list[dict[str, Any]] = []
    for point in points:
        tolerance = point.settings.get("tolerance")
        if tolerance is None:
            continue
        made = bench.compressed(tolerance)
        rows.append(
            {
                "tolerance": tolerance, "bytes": made.table.nbytes, "value_bytes": made.table.value_bytes,
                "ratio": made.table.ratio,
                "worst_error": made.table.worst_error * tolerance,
                "compress_seconds": made.seconds, "decompress_seconds": made.reading,
                "fit_seconds": point.seconds["min"], **point.errors,
            }
        )  # fmt: skip
    return sorted(rows, key=lambda row: row["tolerance"])


def _table(bench: Bench) -> dict[str, Any]:
    table, held = bench.table, bench.split
    return {
        "name": table.metadata.name, "hash": table.hash, "samples": len(table),
        "channels": len(table.channels),
        "usable": int(table.mask.sum()), "fitted": int(bench.fitted.mask.sum()),
        "held_out": 0 if held is None else held.held_out,
        "held_out_theta_i_deg": [] if held is None else [list(pair) for pair in held.incidences_deg],
    }  # fmt: skip


def _noise(bench: Bench) -> dict[str, Any]:
    """How far warm repeats of the same fit spread: what differences of seconds mean nothing below."""
    spreads = [median(one.wall[1:]) / min(one.wall[1:]) - 1.0 for one in bench.measured if len(one.wall) > 2]
    spread = float(median(spreads)) if spreads else None
    said = (
        "each fit was repeated too seldom to tell" if spread is None
        else f"repeats of the same fit take {100 * spread:.0f} % longer than the fastest (median)"
    )  # fmt: skip
    return {"spread": spread, "sentence": said}


def _remember(bench: Bench) -> list[str]:
    """Teach the machine's cost model, where there is one, what was measured."""
    book, _ = cost_model.load(cost_model.path())
    if book is None:
        return []
    for one in [*bench.measured, *bench.references.values()]:
        configuration = one.configuration
        case = Case.of(bench.table_of(configuration), configuration.fit)
        effort = case.effort(configuration.fit)
        for result in one.fits[-2:]:
            book = budget.learned(book, case, effort, result)
    return cost_model.save(book, cost_model.path())


def _load_average() -> float | None:
    return float(np.round(os.getloadavg()[0], 2)) if hasattr(os, "getloadavg") else None
