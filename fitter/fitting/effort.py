"""Effort: how much of the table a fit looks at, how often, and from how many starts.

The efforts that a budget chooses from run from one start on 256 samples, never looking at the rest, to
sixteen times the usual starts and passes over the whole table.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from fitter.compression import CompressedTable
from fitter.fitting import candidates, exchange, reduction, search_error
from fitter.fitting.blocks import padded
from fitter.fitting.chunks import CHUNK
from fitter.fitting.layout import Layout, channel_groups, layout
from fitter.fitting.least_squares import TOLERANCE
from fitter.fitting.samples import ENOUGH
from fitter.spec import FitSpec, Polish, Solver
from fitter.table import Table

#: What the cost model tells apart; loading is no part of a fit, and compiling is predicted by itself.
Phase: TypeAlias = Literal["prepare", "search", "polish", "check"]
PHASES: tuple[Phase, ...] = ("prepare", "search", "polish", "check")
SUBSETS = (256, 1024, 4096, 16_384, 65_536)
USUAL = 4096
#: Starts of the dearest efforts, in units of the usual number.
MORE = (4, 16)
#: What exchanging lobes takes, in searches of one start. Measured: 20 to 60.
EXCHANGES = 40
#: Until runs say it: how much larger the error of a subset is than that of as many independent samples.
SPREAD = 2.0
#: Values of a table, at most, on all of which a single parameter is scanned.
SCANNED = 3 * exchange.MOST
#: What a search with the usual starts may miss, and one with fewer. Usual numbers are chosen for 99.9 %.
MISSED, LIKELY_MISSED = 1e-3, 0.3


def searched(places: Layout, request: FitSpec, samples: int, channels: int) -> int:
    """How many samples a fit of a group of channels searches.

    Scanning one parameter is cheap. So tables for which it is are looked at whole: the flank of a narrow lobe
    may be a few samples, which a subset leaves out. Who states another effort than the usual one gets that.
    """
    usual = request.starts is None and request.subset == USUAL and request.polish == "full"
    few = samples <= exchange.MOST and samples * channels <= SCANNED
    return samples if usual and few and len(places.entries) == 1 else request.subset


@dataclass(frozen=True)
class Effort:
    """Samples of the subset, starts that are solved, and whether the whole table is polished on."""

    subset: int
    starts: int
    polish: Polish

    def applied(self, request: FitSpec) -> FitSpec:
        """The request with this effort in place of a budget."""
        chosen = {
            "subset": max(64, self.subset), "starts": max(1, self.starts), "polish": self.polish,
            "budget_seconds": None, "target_error": None,
        }  # fmt: skip
        return request.model_copy(update=chosen)

    def to_dict(self) -> dict[str, str | int]:
        return dataclasses.asdict(self)

    def __str__(self) -> str:
        starts = f"{self.starts} start" + ("s" if self.starts != 1 else "")
        where = "then the whole table" if self.polish == "full" else "and no more of the table"
        return f"{starts} on {self.subset:,} samples, {where}"


@dataclass(frozen=True)
class Case:
    """A table and a request as far as they decide what a fit costs.

    key : fits whose seconds are alike but for their size.
    """

    key: str
    places: Layout
    solver: Solver
    metric: str
    samples: int
    channels: int
    groups: int
    usual_starts: int
    parameters: int
    #: Whether a large table of this kind is reduced to pseudo-samples.
    reducible: bool = False

    @staticmethod
    def of(table: Table | CompressedTable, request: FitSpec) -> Case:
        """Raises SpecError where the request makes no sense for its model."""
        if isinstance(table, CompressedTable):
            samples, names = int(table.header["samples"]), [c["name"] for c in table.header["channels"]]
            stated = "sigma" in table.blocks
        else:
            samples, names = int(table.mask.sum()), [c.name for c in table.channels]
            stated = table.sigma is not None
        metric = request.metric or ("measurement" if stated else "cbrt")
        channels = len(request.select.channels or names)
        groups = channel_groups(request, channels)
        places = layout(request, channels)
        _, usual = candidates.default_counts(len(places.free))
        # What a compressed table is made of is known when it is unpacked.
        reducible = isinstance(table, Table) and reduction.applies(places, metric, table, samples)
        key = "|".join(
            [
                request.model.name, request.solver, metric, ",".join(sorted(request.fixed)),
                ",".join(request.model.per_channel or ()), str(isinstance(table, CompressedTable)),
                str(reducible),
            ]
        )  # fmt: skip
        parameters = len(groups) * (len(places.entries) + len(places.linear) * len(groups[0]))
        return Case(
            key, places, request.solver, metric, max(1, samples), channels, len(groups), usual, parameters,
            reducible,
        )

    @property
    def reduced(self) -> bool:
        """Whether the whole table is looked at once, and searched as a few pseudo-samples."""
        return self.reducible and self.samples > USUAL

    def sized(self, samples: int, channels: int) -> Case:
        """The same kind of fit of another table."""
        return dataclasses.replace(self, samples=samples, channels=channels)

    @functools.cached_property
    def weight(self) -> Mapping[Phase | Literal["compile"], float]:
        """Work by phase in units of the calibrated model's: two terms and one derivative of each."""
        terms = max(1, len(self.places.linear))
        derivatives = (1 + len(self.places.free)) * terms / 4.0
        # Where channels share some parameters only, each is searched alone first, then all together.
        search = derivatives * (6.0 if self.places.mixed else 1.0) * (8.0 if self.solver == "nlopt" else 1.0)
        shape = 0.5 + 0.5 * derivatives
        return {
            "prepare": 1.0, "search": search, "polish": derivatives, "check": derivatives, "compile": shape
        }  # fmt: skip

    def effort(self, request: FitSpec) -> Effort:
        """What a fit of this case does that has no budget."""
        subset = searched(self.places, request, self.samples, self.channels // self.groups)
        starts = request.starts if request.starts is not None else self.usual_starts
        return Effort(min(subset, self.samples), starts, request.polish)

    def efforts(self, starts: int | None = None) -> list[Effort]:
        """What there is to choose from; ``starts`` where the caller names them."""
        usual = starts or self.usual_starts
        fewer = [1] if starts is None and usual > 1 else []
        if self.reduced:
            # The whole table costs less than a subset of it, which would be drawn and searched as it is.
            more = [times * usual for times in MORE] if starts is None and self.places.entries else []
            return [Effort(USUAL, s, "full") for s in (*fewer, usual, *more)]
        sizes = [m for m in SUBSETS if m < self.samples]
        found = [Effort(m, s, "subset") for m in sizes for s in (*(fewer if m <= 1024 else ()), usual)]
        whole = min(USUAL, self.samples)
        found += [Effort(min(1024, self.samples), s, "full") for s in (*fewer, usual)]
        found += [Effort(whole, usual, "full")]
        if starts is None and self.places.entries:
            found += [Effort(whole, times * usual, "full") for times in MORE]
        return list(dict.fromkeys(found))

    def work(self, effort: Effort, passes: int) -> dict[Phase, float]:
        """Units of work of each phase."""
        subset = min(effort.subset, self.samples)
        full = self.complete(effort)
        looked_at = self.samples if full else subset
        reduced = self.reduced and effort.polish == "full"
        searched = (CHUNK if reduced else padded(subset)) * self.channels
        # A subset is drawn from a part of a large table.
        drawn = 0 if reduced or subset == self.samples else min(self.samples, max(ENOUGH, 4 * subset))
        return {
            "prepare": float((self.samples + drawn) * self.channels),
            "search": float((effort.starts + 4) * searched + self._exchanges(effort)),
            "polish": float(passes * looked_at * self.channels) if full and not reduced else 0.0,
            "check": float(looked_at * self.channels),
        }

    def _exchanges(self, effort: Effort) -> int:
        """Units of work of exchanging lobes, where that is done, at most."""
        request = effort.applied(FitSpec(model=self.places.spec, solver=self.solver))
        done = exchange.wanted(self.places, request, self.samples, self.channels // self.groups)
        return EXCHANGES * self.samples * self.channels if done else 0

    def complete(self, effort: Effort) -> bool:
        """Whether every sample is looked at."""
        return effort.polish == "full" or effort.subset >= self.samples

    def programs(self, effort: Effort) -> dict[str, Hashable]:
        """What has to be compiled: the search by the subset's length and the starts, and the rest."""
        reduced = self.reduced and effort.polish == "full"
        size = "reduced" if reduced else padded(min(effort.subset, self.samples))
        # Few starts are one program with the usual candidates; more starts screen more of them.
        screened = max(candidates.default_counts(len(self.places.free))[0], 4 * effort.starts)
        common = (self.places, self.solver, self.channels)
        return {
            "search": ("search", *common, size, screened),
            "rest": ("rest", *common, self.metric, self.complete(effort), size),
        }

    def error(self, effort: Effort, spreads: Sequence[float] = ()) -> float:
        """The search error to expect, at most (95 %), other basins apart: of so many independent samples,
        times what subsets of such tables were worse than that."""
        if self.complete(effort):
            freedom = max(1, self.samples * self.channels - self.parameters)
            return search_error.rms_share(TOLERANCE / freedom)
        return self.independent(effort.subset) * (float(np.quantile(spreads, 0.8)) if spreads else SPREAD)

    def independent(self, subset: int) -> float:
        """The search error of an optimum of independent samples, at most (95 %)."""
        left_out = 1.0 - subset / self.samples
        values = max(1, subset * self.channels)
        worst = search_error.at_most(max(1, self.parameters))
        return max(1e-15, search_error.rms_share(left_out * worst / values))

    def score(self, effort: Effort, error: float) -> float:
        """What a fit may be wrong by, the risk of a missed optimum included; smaller is better."""
        share = self.usual_starts / max(1, effort.starts)
        missed = MISSED * share**2 if share <= 1 else LIKELY_MISSED
        return error + 0.1 * missed
