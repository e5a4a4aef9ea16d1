"""Clock: what a fit costs by phase, in seconds, with compiling and memory apart."""

from __future__ import annotations

import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from fitter.fitting.compiling import Meter, metering
from fitter.fitting.memory import MemoryWatch


@dataclass
class Clock:
    """Seconds by phase, monotonic. What was compiled in a phase is not part of it but of ``compiled``."""

    meter: Meter
    memory: MemoryWatch
    last: float
    phases: dict[str, float] = field(default_factory=dict[str, float])
    compiled: dict[str, float] = field(default_factory=dict[str, float])

    def lap(self, phase: str) -> None:
        """What went by since the last lap was this phase."""
        now = time.perf_counter()
        compiling = self.meter.between(self.last, now)
        self.phases[phase] = self.phases.get(phase, 0.0) + max(0.0, now - self.last - compiling)
        self.compiled[phase] = self.compiled.get(phase, 0.0) + compiling
        self.last = now

    def cost(self, load_seconds: float | None) -> dict[str, Any]:
        """JSON-ready: ``seconds`` of the fit, and of the ``phases``, which have the table's loading, too,
        where that is known."""
        phases = {} if load_seconds is None else {"load": load_seconds}
        compiling = float(sum(self.compiled.values()))
        peak, growth = self.memory.read()
        return {
            "seconds": float(sum(self.phases.values())) + compiling,
            "phases": {**phases, "compile": compiling, **self.phases},
            # Mostly found in the cache of earlier processes, not made.
            "from_cache": self.meter.hits > self.meter.misses,
            "compiled_in": {phase: spent for phase, spent in self.compiled.items() if spent > 0},
            "peak_memory_bytes": peak, "memory_growth_bytes": growth,
        }  # fmt: skip


@contextmanager
def running() -> Generator[Clock]:
    """A clock that runs while the block does."""
    with MemoryWatch() as memory, metering() as meter:
        yield Clock(meter, memory, time.perf_counter())
