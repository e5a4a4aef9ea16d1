"""What a batch will take: measured on a few of its tables, not guessed."""

from __future__ import annotations

import os
import resource
import sys
import tempfile
import time
from dataclasses import dataclass
from typing import Any

from fitter import progress as reporting
from fitter.batch import working
from fitter.batch.planning import Plan, Unit

#: Tables that are fitted for the estimate: the smallest, a middle one and the largest.
_TRIED = 3


@dataclass(frozen=True)
class Estimate:
    """fits : how many there will be, posteriors apart. seconds : of all workers together, on ``workers``.
    memory : bytes that a worker will need at most. tried : the tables that were measured."""

    tables: int
    fits: int | None
    seconds: float
    memory: int
    workers: int
    tried: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return {**vars(self), "tried": list(self.tried), "kind": "brdf-fitter/batch-estimate"}


def estimate(
    plan: Plan, *, workers: int | None = None, progress: reporting.Progress = reporting.ignore
) -> Estimate:
    """Do up to three of the plan's units into a folder that is thrown away, each twice: the first compiles.

    Seconds grow with the size of the file, by the line through what was measured; an archive's members count
    by their own size. A unit that fails counts with the seconds it took to fail.
    """
    by_size = sorted(plan.units, key=lambda unit: unit.size)
    places = sorted({round(k * (len(by_size) - 1) / (_TRIED - 1)) for k in range(_TRIED)}) if by_size else []
    tried = [by_size[place] for place in places]
    spec = plan.spec.model_dump(mode="json")
    seconds: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        for k, unit in enumerate(tried):
            spent = 0.0
            for turn in range(2):
                progress((2 * k + turn) / (2 * len(tried)), f"measuring {unit.name}")
                begun = time.monotonic()
                working.work(unit.to_dict(), spec, "estimate", folder)
                spent = time.monotonic() - begun
            seconds.append(spent)
    count = workers or os.cpu_count() or 1
    models = plan.spec.models
    return Estimate(
        len(plan.units), None if isinstance(models, str) else len(models) * len(plan.units),
        sum(_interpolated(unit, tried, seconds) for unit in plan.units) / count, _peak(), count,
        tuple(unit.name for unit in tried),
    )  # fmt: skip


def _interpolated(unit: Unit, tried: list[Unit], seconds: list[float]) -> float:
    import numpy as np

    return float(np.interp(unit.size, [one.size for one in tried], seconds))


def _peak() -> int:
    """The most memory that this process has had, in bytes."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most * 1024
