"""Evaluating a fitted model in float64 and in float32: seconds, and what is lost. Fits are float64."""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.fitting.result import FitResult
from fitter.table import Table
from fitter.tradeoffs import errors
from fitter.tradeoffs.result import Point
from fitter.tradeoffs.split import Split

#: Pairs that are evaluated.
PAIRS = 65_536
DTYPES = (np.float64, np.float32)


def points(fit: FitResult, table: Table, held: Split | None, repeats: int) -> list[Point]:
    """One point a dtype; the two are timed in turn."""
    index = np.resize(np.flatnonzero(table.mask), PAIRS)
    wi, wo = table.directions(index)
    calls = [_call(fit, wi.astype(dtype), wo.astype(dtype)) for dtype in DTYPES]
    first: list[float] = []
    seconds: list[list[float]] = [[] for _ in DTYPES]
    for call in calls:
        begun = time.perf_counter()
        call()
        first.append(time.perf_counter() - begun)
    for _ in range(max(3, repeats)):
        for k, call in enumerate(calls):
            begun = time.perf_counter()
            call()
            seconds[k].append(time.perf_counter() - begun)
    names = [channel.name for channel in table.channels]
    columns = [names.index(name) for name in fit.model.channels]
    exact = errors.reflectances(fit.model, table.domain.theta_i)
    found: list[Point] = []
    for dtype, begun, spent in zip(DTYPES, first, seconds, strict=True):
        here = errors.reflectances(fit.model, table.domain.theta_i, dtype)
        name = np.dtype(dtype).name
        found.append(
            Point(
                axis="precision", label=f"{fit.spec.model.name}: evaluate {PAIRS:,} pairs in {name}",
                model=fit.spec.model.name, metric=fit.spec.metric, settings={"dtype": name, "pairs": PAIRS},
                seconds={
                    "min": min(spent), "median": median(spent), "repeats": float(len(spent)), "first": begun,
                    "compile": max(0.0, begun - median(spent)),
                },
                memory_bytes=None,
                errors={
                    "held_out": None if held is None else errors.held_out(fit.model, held, columns, dtype),
                    "parameters": None, "reflectance": errors.reflectance(here, exact),
                },
                status="done",
            )
        )  # fmt: skip
    return found


def _call(fit: FitResult, wi: NDArray[Any], wo: NDArray[Any]) -> Callable[[], object]:
    return lambda: np.asarray(fit.model.evaluate(wi, wo))
