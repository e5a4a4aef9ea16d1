"""The calibration of the cost model: one model fitted to made-up tables of two sizes, once on a machine."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np

from fitter import models, progress
from fitter.fitting.cost_model import Calibration, Line
from fitter.fitting.effort import PHASES, Case, Effort, Phase
from fitter.fitting.result import FitResult
from fitter.spec import FitSpec, ModelSpec
from fitter.table import Table

Fitter: TypeAlias = Callable[[Table, FitSpec, progress.Progress], FitResult]

MODEL, METRIC, CHANNELS = "ward", "cosine", 3
SMALL, LARGE = 1000, 60_000
REPEATS = 3
#: Names of the engine's laps by the phase of the cost model; what is not named is part of the check.
LAPS: Mapping[str, Phase] = {
    "prepare": "prepare", "reduce": "prepare", "search": "search", "subset polish": "search",
    "polish": "polish",
}  # fmt: skip


def by_phase(laps: Mapping[str, float]) -> dict[Phase, float]:
    """Seconds of the cost model's phases from those of the engine's, loading and compiling apart."""
    found: dict[Phase, float] = dict.fromkeys(PHASES, 0.0)
    for lap, seconds in laps.items():
        if lap not in ("load", "compile"):
            found[LAPS.get(lap, "check")] += seconds
    return found


def calibrate(fit: Fitter, report: progress.Progress) -> Calibration:
    """Measure this machine, in a few seconds."""
    begun = time.perf_counter()
    request = FitSpec(model=ModelSpec.parse(MODEL), metric=METRIC)
    spent: list[dict[Phase, float]] = []
    work: list[dict[Phase, float]] = []
    compiled = {"search": 0.0, "rest": 0.0}
    for size in (SMALL, LARGE):
        report(0.0, "calibrating the cost model of this machine")
        table = _table(size)
        first = fit(table, request, progress.ignore)
        for lap, seconds in first.cost["compiled_in"].items():
            part = "search" if lap == "search" else "rest"
            compiled[part] = max(compiled[part], float(seconds))
        # Two sizes of subset, so two searches were compiled; the larger of the two is what one takes.
        warm = [fit(table, request, progress.ignore) for _ in range(REPEATS)]
        laps = [by_phase(result.cost["phases"]) for result in warm]
        spent.append({phase: min(lap[phase] for lap in laps) for phase in PHASES})
        case = Case.of(table, request)
        work.append(case.work(Effort(4096, case.usual_starts, "full"), int(warm[0].cost["passes"])))
    lines: dict[Phase, Line] = {
        phase: _line(*((done[phase], took[phase]) for done, took in zip(work, spent, strict=True)))
        for phase in PHASES
    }
    return Calibration(
        lines=lines,
        compile_search=compiled["search"], compile_rest=compiled["rest"],
        seconds=time.perf_counter() - begun,
    )  # fmt: skip


def _line(small: tuple[float, float], large: tuple[float, float]) -> Line:
    """Through two points of (work, seconds); neither part negative, whatever the noise."""
    each = max((large[1] - small[1]) / (large[0] - small[0]), 0.1 * large[1] / large[0], 1e-12)
    return Line(fixed=max(0.0, small[1] - each * small[0]), each=each)


def _table(samples: int) -> Table:
    """Random directions over the hemisphere, values with 1 % noise."""
    rng = np.random.default_rng(1)
    model = models.create(MODEL, kd=[0.1, 0.2, 0.3], ks=[0.1, 0.1, 0.1], alpha=0.15)
    wi, wo = (_directions(rng, samples) for _ in range(2))
    value = np.asarray(model.evaluate(wi, wo)) * (1.0 + 0.01 * rng.standard_normal((samples, CHANNELS)))
    return Table(wi=wi, wo=wo, value=value, duplicates="keep")


def _directions(rng: np.random.Generator, count: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    z, phi = rng.uniform(0.1, 1.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1)
