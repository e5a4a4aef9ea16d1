"""Budgets: how often a fit is done in the time it was given, and as near the optimum as was asked."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

import fitter
from fitter.fitting.budget import GRACE
from fitter.table import Table
from tests.bench import tables
from tests.bench.measuring import Figure, Row, Size

SEED = 1
METRIC = "cosine"
FAMILIES = ("ward", "oren_nayar")
SIZES = (1_000, 10_000, 60_000, 200_000, 400_000)
#: Budgets in units of a warm fit of the usual effort, and targets.
BUDGETS, TARGETS = (0.3, 1.2, 5.0), (1e-2, 1e-4)
WANTED = 0.95


@dataclass
class Tally:
    """How many of the pairs came out as they had to, and those that did not."""

    good: int = 0
    refused: int = 0
    failures: list[dict[str, Any]] | None = None
    pairs: int = 0

    def add(self, right: bool, told: dict[str, Any], refused: bool) -> None:
        self.pairs += 1
        self.good += right
        self.refused += refused
        if not right:
            self.failures = [*(self.failures or []), told]


def run(size: Size) -> Iterator[Row]:
    times, targets = Tally(), Tally()
    for name in FAMILIES[: size.pick(2, 1)]:
        for count in SIZES[: size.pick(5, 1)]:
            table = tables.scattered(name, count, SEED)
            table.sigma = None
            _budgets(name, table, times)
            _targets(name, table, targets)
    for case, tally in (
        (f"budget: done within {GRACE:g} times it, or rightly unattainable", times),
        ("target error: reached, or rightly unattainable", targets),
    ):
        ours = Figure.of("share of the table x budget pairs", "ratio", [tally.good / tally.pairs])
        facts = {"pairs": tally.pairs, "unattainable": tally.refused, "failures": tally.failures or []}
        yield Row(case, ours, (Figure.of("floor: what is promised", "ratio", [WANTED]),), facts, SEED)


def _budgets(name: str, table: Table, tally: Tally) -> None:
    fitter.fit(table, name, metric=METRIC)
    usual = min(fitter.fit(table, name, metric=METRIC).seconds for _ in range(3))
    fitter.fit(table, name, metric=METRIC, target_error=1e-2)  # teaches the cost model this kind of fit
    for share in BUDGETS:
        budget, began = share * usual, time.perf_counter()
        told = {"model": name, "samples": len(table), "budget": budget}
        try:
            fit = fitter.fit(table, name, metric=METRIC, budget_seconds=budget)
        except fitter.FitError as error:
            if error.code != "unattainable":
                raise
            fitter.fit(table, name, metric=METRIC, subset=256, polish="subset", starts=1)
            least = fitter.fit(table, name, metric=METRIC, subset=256, polish="subset", starts=1).seconds
            tally.add(least > budget / GRACE, {**told, "cheapest": least}, refused=True)
            continue
        spent = time.perf_counter() - began
        told |= {"spent": spent, **fit.cost["budget"]["chosen"]}
        tally.add(spent <= GRACE * budget, told, refused=False)


def _targets(name: str, table: Table, tally: Tally) -> None:
    best = _rms(fitter.fit(table, name, metric=METRIC, starts=12), table)
    for target in TARGETS:
        fit = fitter.fit(table, name, metric=METRIC, target_error=target)
        error = _rms(fit, table) / best - 1.0
        told = {"model": name, "samples": len(table), "target": target, "error": error}
        tally.add(error <= target, {**told, **fit.cost["budget"]["chosen"]}, refused=False)


def _rms(fit: fitter.FitResult, table: Table) -> float:
    """Of the residuals that the metric minimises, over the whole table."""
    off = table.wi[:, 2:] * (np.asarray(fit.model.evaluate(table.wi, table.wo)) - table.value)
    return float(np.sqrt(np.mean(off[table.mask] ** 2)))
