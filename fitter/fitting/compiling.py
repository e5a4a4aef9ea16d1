"""Seconds that JAX spends on tracing and compiling, told apart from the work itself.

JAX reports the end and the length of every trace, lowering and compilation, in the thread that asked for it.
They nest, so what counts is the time that they cover together.
"""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Generator, Hashable
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import jax

_COMPILE = "/jax/core/compile/"
_MISSES, _HITS = "/jax/compilation_cache/cache_misses", "/jax/compilation_cache/cache_hits"


@dataclass
class Meter:
    """When something was compiled: intervals of ``time.perf_counter``, in no order.

    misses, hits : programs that the persistent cache did not have, or had; where there is such a cache.
    """

    intervals: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    misses: int = 0
    hits: int = 0

    def between(self, begin: float, end: float) -> float:
        """Seconds between two times that compilations cover."""
        covered, reached = 0.0, begin
        for low, high in sorted(self.intervals):
            low, high = max(low, reached), min(high, end)
            if high > low:
                covered += high - low
                reached = high
        return covered


class _Ear:
    """Hears all compilations of the process and tells the meters that are running."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: list[tuple[int, Meter]] = []

    def add(self, meter: Meter) -> None:
        with self._lock:
            self._running.append((threading.get_ident(), meter))

    def remove(self, meter: Meter) -> None:
        with self._lock:
            self._running = [entry for entry in self._running if entry[1] is not meter]

    def duration(self, event: str, duration_secs: float, **about: Any) -> None:
        del about
        if event.startswith(_COMPILE):
            now = time.perf_counter()
            for meter in self._mine():
                meter.intervals.append((now - duration_secs, now))

    def event(self, event: str, **about: Any) -> None:
        del about
        if event in (_MISSES, _HITS):
            for meter in self._mine():
                meter.misses += event == _MISSES
                meter.hits += event == _HITS

    def _mine(self) -> list[Meter]:
        """The meters of this thread."""
        here = threading.get_ident()
        with self._lock:
            return [meter for thread, meter in self._running if thread == here]


@functools.cache
def _ear() -> _Ear:
    ear = _Ear()
    jax.monitoring.register_event_duration_secs_listener(ear.duration)
    jax.monitoring.register_event_listener(ear.event)
    return ear


@contextmanager
def metering() -> Generator[Meter]:
    """A meter of what this thread compiles meanwhile."""
    meter, ear = Meter(), _ear()
    ear.add(meter)
    try:
        yield meter
    finally:
        ear.remove(meter)


@functools.cache
def compiled_here() -> set[Hashable]:
    """What this process has fitted already, and so need not compile again: the counterpart of JAX's own cache
    of programs, which can't be asked."""
    return set()
