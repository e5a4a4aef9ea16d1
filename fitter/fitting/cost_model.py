"""The cost model of a machine: what a fit will take here, from a calibration and from the fits made since.

Seconds of each phase are a + b x, x being the work: samples x channels for what looks at the table, starts x
subset x channels for the search. The calibration finds a and b of one model; another model's are those times
its number of derivatives, until it has been fitted here: then its own runs of nearly the same size correct
them.

The file lies beside the cache of compiled programs. One that is damaged, of another machine or of other
versions is never used.
"""

from __future__ import annotations

import functools
import hashlib
import math
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import numpy as np
from pydantic import AfterValidator, Field, ValidationError

from fitter import _jax
from fitter._version import __version__
from fitter.documents import read_document, write_document
from fitter.errors import SpecError
from fitter.fitting.compiling import compiled_here
from fitter.fitting.effort import PHASES, Case, Effort, Phase
from fitter.model_spec import Frozen
from fitter.versions import installed

KIND = "brdf-fitter/cost-model"
VERSION = 1
#: Runs kept of each kind of fit and in all, and programs known to be compiled.
EACH, ALL, PROGRAMS = 24, 600, 4000
#: Of a kind of fit's runs those nearest in size speak for it.
NEAREST = 5
#: By what factor a prediction may be off: where nothing of its kind was run here, and at least.
UNSEEN, LEAST = 2.5, 1.2
#: Seconds of compiling that the persistent cache leaves, as a share; until a run says it.
LEFT_BY_CACHE = 0.4

Seconds = Annotated[float, Field(ge=0, le=1e6)]


class Line(Frozen):
    """Seconds = fixed + each x work."""

    fixed: Seconds
    each: Annotated[float, Field(gt=0, le=1e3)]


def _of_every_phase(found: Mapping[Phase, Any]) -> Mapping[Phase, Any]:
    if set(found) != set(PHASES):
        raise ValueError(f"phases {sorted(found)} instead of {sorted(PHASES)}")
    return found


class Calibration(Frozen):
    """Of one model: the lines of the phases, and seconds of compiling its search and everything else."""

    lines: Annotated[Mapping[Phase, Line], AfterValidator(_of_every_phase)]
    compile_search: Seconds
    compile_rest: Seconds
    seconds: Seconds


class Run(Frozen):
    """A fit made here: what it was, and what it took and found."""

    key: Annotated[str, Field(max_length=500)]
    samples: Annotated[int, Field(ge=1)]
    channels: Annotated[int, Field(ge=1)]
    subset: Annotated[int, Field(ge=1)]
    starts: Annotated[int, Field(ge=0)]
    full: bool
    passes: Annotated[int, Field(ge=0)]
    seconds: Annotated[Mapping[Phase, Seconds], AfterValidator(_of_every_phase)]
    compile_search: Seconds | None
    compile_rest: Seconds | None
    cached: bool
    #: Search error of a subset's optimum in units of what independent samples would give.
    spread: Annotated[float, Field(ge=0, le=1e9)] | None


class Book(Frozen):
    """The file."""

    kind: Literal["brdf-fitter/cost-model"] = KIND
    version: Literal[1] = VERSION
    machine: Mapping[str, str]
    calibration: Calibration
    runs: tuple[Run, ...] = ()
    compiled: tuple[str, ...] = ()


@dataclass(frozen=True)
class Prediction:
    """Seconds of a fit by phase and of compiling; ``factor`` by which the sum may be off either way;
    ``error``, its search error at most (95 %)."""

    phases: Mapping[Phase, float]
    compiling: float
    factor: float
    error: float

    @property
    def running(self) -> float:
        return sum(self.phases.values())

    @property
    def seconds(self) -> float:
        return self.running + self.compiling


def path() -> Path:
    return _jax.default_cache_folder().parent / "cost-model.json"


@functools.cache
def machine() -> Mapping[str, str]:
    """What seconds depend on: the machine and the versions."""
    versions = {name: installed(name) for name in ("numpy", "jax", "jaxlib", "optimistix")}
    return {
        "system": f"{platform.system()} {platform.machine()}", "cpu": _cpu(), "cores": str(_cores()),
        "brdf-fitter": __version__, "python": platform.python_version(), **versions,
    }  # fmt: skip


def load(file: Path) -> tuple[Book | None, list[str]]:
    """The stored model of this machine, or None and a note that says why there is none to be used."""
    if not file.exists():
        return None, []
    try:
        book = Book.model_validate(dict(read_document(file, "cost-model")))
    except (SpecError, ValidationError, ValueError):
        return None, [f"the stored cost model was damaged and is calibrated anew ({file})"]
    if dict(book.machine) != dict(machine()):
        return None, ["the stored cost model is of another machine or other versions and is calibrated anew"]
    return book, []


def save(book: Book, file: Path) -> list[str]:
    """Write it aside and rename; a note where it can't be kept: the next process calibrates again."""
    try:
        write_document(book.model_dump(mode="json"), file)
    except OSError as error:
        return [f"the cost model can't be kept: {file}: {error.strerror}"]
    return []


def predictions(book: Book, case: Case, efforts: Sequence[Effort]) -> list[Prediction]:
    """What a fit with each effort will take. What the runs say is worked out once, which takes as long as a
    small fit."""
    runs = [run for run in book.runs if run.key == case.key]
    seen = [_Seen.of(book, case, run) for run in runs]
    return [_predicted(book, case, effort, runs, seen) for effort in efforts]


@dataclass(frozen=True)
class _Seen:
    """A run's work by phase, and logarithms of measured over expected seconds where something was done."""

    work: Mapping[Phase, float]
    ratios: Mapping[Phase, float]

    @staticmethod
    def of(book: Book, case: Case, run: Run) -> _Seen:
        effort = Effort(run.subset, run.starts, "full" if run.full else "subset")
        work = case.sized(run.samples, run.channels).work(effort, run.passes)
        ratios: dict[Phase, float] = {
            phase: float(np.log(run.seconds[phase] / _prior(book, case.weight[phase], phase, work[phase])))
            for phase in PHASES
            if work[phase] > 0 and run.seconds[phase] > 0
        }
        return _Seen(work, ratios)


def _predicted(
    book: Book, case: Case, effort: Effort, runs: Sequence[Run], seen: Sequence[_Seen]
) -> Prediction:
    phases: dict[Phase, float] = {}
    factors: list[float] = []
    work = case.work(effort, _usual_passes(runs))
    for phase in PHASES:
        prior = _prior(book, case.weight[phase], phase, work[phase])
        ratios = _ratios(seen, phase, work[phase])
        middle = float(np.exp(np.median(ratios))) if len(ratios) else 1.0
        phases[phase] = prior * middle if work[phase] > 0 else 0.0
        off = float(np.exp(np.max(np.abs(ratios - np.median(ratios))))) if len(ratios) > 1 else 1.5
        factors.append(min(UNSEEN, max(LEAST, off)) if len(ratios) else UNSEEN)
    total = sum(phases.values())
    factor = sum(f * phases[phase] for f, phase in zip(factors, PHASES, strict=True)) / max(total, 1e-12)
    spreads = [run.spread for run in runs if run.spread is not None]
    return Prediction(phases, _compiling(book, case, effort, runs), factor, case.error(effort, spreads))


def _prior(book: Book, weight: float, phase: Phase, work: float) -> float:
    line = book.calibration.lines[phase]
    return line.fixed + line.each * weight * work


def _ratios(seen: Sequence[_Seen], phase: Phase, work: float) -> np.ndarray[Any, Any]:
    """Logarithms of measured over expected seconds of the runs that are nearest in size."""
    found = [
        (abs(math.log(max(work, 1.0) / run.work[phase])), run.ratios[phase])
        for run in seen
        if phase in run.ratios
    ]
    # The latest first, so that among equals they count: machines change.
    found.reverse()
    found.sort(key=lambda pair: round(pair[0], 1))
    return np.array([ratio for _, ratio in found[:NEAREST]])


def _usual_passes(runs: Sequence[Run]) -> int:
    """Passes over the table that a fit of this kind needs: more than most."""
    passes = [run.passes for run in runs if run.full and run.passes > 0]
    return int(np.ceil(np.quantile(passes[-NEAREST:], 0.8))) if passes else 5


def _compiling(book: Book, case: Case, effort: Effort, runs: Sequence[Run]) -> float:
    kept = bool(jax.config.jax_compilation_cache_dir)  # pyright: ignore[reportAttributeAccessIssue]
    found = 0.0
    for part, program in case.programs(effort).items():
        if program in compiled_here():
            continue
        cached = kept and digest(program) in book.compiled
        spent = [
            seconds for run in runs
            if run.cached == cached and (seconds := getattr(run, f"compile_{part}")) is not None
        ]  # fmt: skip
        if spent:
            # The longest: where nearly all was compiled before, what was left says little.
            found += max(spent[-NEAREST:])
        else:
            whole = getattr(book.calibration, f"compile_{part}") * case.weight["compile"]
            found += whole * (LEFT_BY_CACHE if cached else 1.0)
    return found


def digest(program: object) -> str:
    """A program's name in the file."""
    return hashlib.sha256(repr(program).encode()).hexdigest()[:24]


def with_run(book: Book, run: Run, programs: Sequence[object]) -> Book:
    """The model that knows one more run, and the oldest ones no longer."""
    same = [one for one in book.runs if one.key == run.key][-(EACH - 1) :]
    others = [one for one in book.runs if one.key != run.key][-(ALL - EACH) :]
    new = [name for program in programs if (name := digest(program)) not in book.compiled]
    compiled = (*book.compiled, *new)[-PROGRAMS:]
    return book.model_copy(update={"runs": (*others, *same, run), "compiled": compiled})


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _cpu() -> str:
    listing = Path("/proc/cpuinfo")
    if listing.exists():
        for line in listing.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"
