"""Contenders timed in turn, and the rows that come of it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from statistics import median
from typing import Any, Literal

Unit = Literal["s", "1/s", "ratio"]


@dataclass(frozen=True)
class Size:
    """How much to measure: everything, or (quick) cases small enough to show that the benchmark works."""

    quick: bool = False

    def pick(self, full: Any, quick: Any) -> Any:
        return quick if self.quick else full


@dataclass(frozen=True)
class Figure:
    """One contender's figure. ``unit`` "s" is better small; "1/s" and "ratio" are better large.

    ``cpu_seconds`` is the median processor time of a call ("s") or of an item ("1/s"), which depends less
    on who else uses the machine; None where another process did the work or nothing was timed. A name
    that begins with "floor: " is no alternative but what can't be undercut.
    """

    name: str
    unit: Unit
    median: float
    lowest: float
    highest: float
    repeats: int
    cpu_seconds: float | None = None

    @staticmethod
    def of(name: str, unit: Unit, values: list[float], cpu_seconds: float | None = None) -> Figure:
        return Figure(name, unit, median(values), min(values), max(values), len(values), cpu_seconds)


@dataclass(frozen=True)
class Row:
    """One line of the table: what was measured, ours, and the alternatives.

    ``facts`` are numbers that belong to it: sizes, errors, acceptances. ``seed`` gives its data again.
    """

    case: str
    ours: Figure
    others: tuple[Figure, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict[str, Any])
    seed: int | None = None

    def to_dict(self) -> dict[str, Any]:
        document = asdict(self) | {"others": [asdict(other) for other in self.others]}
        for other, written in zip(self.others, document["others"], strict=True):
            # How many times better ours is; below 1 it is worse.
            written["advantage"] = (
                other.median / self.ours.median if other.unit == "s" else self.ours.median / other.median
            )
            if self.ours.cpu_seconds and other.cpu_seconds:
                written["cpu_advantage"] = other.cpu_seconds / self.ours.cpu_seconds
        return document


@dataclass
class Times:
    """Wall and processor seconds of one contender's calls, and what the last call returned."""

    wall: list[float] = field(default_factory=list[float])
    cpu: list[float] = field(default_factory=list[float])
    result: Any = None

    def seconds(self, name: str) -> Figure:
        return Figure.of(name, "s", self.wall, median(self.cpu))

    def rate(self, name: str, work: float) -> Figure:
        """``work`` items a call, as items a second."""
        return Figure.of(name, "1/s", [work / s for s in self.wall], median(self.cpu) / work)


def alternate(
    contenders: Mapping[str, Callable[[], Any]], repeats: int, once: frozenset[str] = frozenset()
) -> dict[str, Times]:
    """Times of every contender, called in turn (A B A B ...) so that all see the same machine.

    Each is called once untimed first, except those named in ``once``, which are timed a single time: the
    slow ones, whose caller has compiled beforehand what there is to compile.
    """
    for name, call in contenders.items():
        if name not in once:
            call()
    found = {name: Times() for name in contenders}
    for turn in range(repeats):
        for name, call in contenders.items():
            if turn and name in once:
                continue
            cpu, wall = time.process_time(), time.perf_counter()
            found[name].result = call()
            found[name].wall.append(time.perf_counter() - wall)
            found[name].cpu.append(time.process_time() - cpu)
    return found


def load_average() -> float | None:
    """Processes that wanted a core over the last minute, where the system says so."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None
