"""The design of a tradeoff: which fits are made, in the order of what they tell.

The first model gets everything: its usual fit, subsets without passes over the table, numbers of starts, the
other solver, the other metrics, compressed tables. The other models get their usual fit and a subset. A
newcomer's time limit ends the list where it ends; what was measured until then is a picture by itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, TypeVar

from fitter.fitting import candidates, exchange
from fitter.fitting.layout import layout
from fitter.spec import FitSpec, Metric, ModelSpec, Solver, TradeoffSpec
from fitter.table import Table

Axis: TypeAlias = Literal[
    "reference", "default", "subset", "starts", "solver", "metric", "compression", "precision"
]
T = TypeVar("T")
SUBSETS = (256, 1024, 4096, 16_384, 65_536)
SOLVERS: tuple[Solver, ...] = ("nlopt",)
METRICS: tuple[Metric, ...] = ("cosine", "log", "cbrt")
TOLERANCES = (0.001, 0.01, 0.05, 0.2)
#: Tables that fit into this many samples are searched for the reference as a whole.
REFERENCE_SUBSET = exchange.MOST
REFERENCE_STARTS = 256


@dataclass(frozen=True)
class Configuration:
    """One fit to be measured. ``tolerance`` : of the compressed table it is made to, None for the table."""

    axis: Axis
    label: str
    fit: FitSpec
    tolerance: float | None = None

    @property
    def optimum(self) -> tuple[str, str | None]:
        """What it looks for: fits of one model under one metric have one optimum."""
        return self.fit.model.name, self.fit.metric


def design(spec: TradeoffSpec, table: Table) -> list[Configuration]:
    """Every fit to be measured on ``table``, the most telling first. Raises SpecError as a fit would."""
    metric = spec.metric or ("measurement" if table.sigma is not None else "cbrt")
    samples, channels = int(table.mask.sum()), len(spec.select.channels or table.channels)
    usual = [_usual(spec, model, metric, channels) for model in spec.models]
    ladder = list(_first(spec, usual[0], metric, samples, channels))
    short = [_subset(one, 1024) for one in usual[1:] if samples > 1024]
    return [*usual, *ladder[:2], *short, *ladder[2:]]


def reference(configuration: Configuration, table: Table, starts: int) -> Configuration:
    """The fit that its errors are taken from: of the whole table, from many starts on a larger subset."""
    samples = int(table.mask.sum())
    changed = {"starts": starts, "subset": max(64, min(REFERENCE_SUBSET, samples)), "polish": "full"}
    fit = configuration.fit.model_copy(update={**changed, "solver": "optimistix"})
    return Configuration("reference", f"{fit.model.name}: reference", fit)


def usual_starts(spec: FitSpec, channels: int) -> int:
    """The starts of a fit that names none."""
    return spec.starts or candidates.default_counts(len(layout(spec, channels).free))[1]


def _usual(spec: TradeoffSpec, model: ModelSpec, metric: Metric, channels: int) -> Configuration:
    fit = FitSpec(model=model, metric=metric, select=spec.select, seed=spec.seed)
    layout(fit, channels)  # says what is wrong with it before anything is measured
    return Configuration("default", f"{model.name}", fit)


def _first(
    spec: TradeoffSpec, usual: Configuration, metric: Metric, samples: int, channels: int
) -> Iterator[Configuration]:
    name, fit = usual.label, usual.fit
    sizes = _of(spec.subsets, SUBSETS)
    for size in (m for m in sizes if m < samples):
        yield _subset(usual, size)
    many = usual_starts(fit, channels)
    for tolerance in _of(spec.tolerances, TOLERANCES):
        yield Configuration("compression", f"{name}: compressed to {tolerance:g}", fit, tolerance)
    if layout(fit, channels).entries:
        for starts in _of(spec.starts, (1, 4 * many)):
            if starts != many:
                label = f"{name}: {starts} start" + ("s" if starts != 1 else "")
                yield Configuration("starts", label, fit.model_copy(update={"starts": starts}))
    for solver in _of(spec.solvers, SOLVERS):
        if solver != fit.solver:
            yield Configuration("solver", f"{name}: {solver}", fit.model_copy(update={"solver": solver}))
    for other in _of(spec.metrics, METRICS):
        if other != metric:
            yield Configuration("metric", f"{name}: {other}", fit.model_copy(update={"metric": other}))


def _subset(usual: Configuration, size: int) -> Configuration:
    changed = usual.fit.model_copy(update={"subset": size, "polish": "subset"})
    return Configuration("subset", f"{usual.label}: {size:,} samples", changed)


def _of(given: Sequence[T] | None, usual: Sequence[T]) -> Sequence[T]:
    return usual if given is None else given
