"""Running a plan: in this process, on workers of this machine, or on somebody's Dask cluster.

Files are read and results written by the workers; through the scheduler go names, options and records. What
is finished is finished: running the same plan into the same folder again does the rest.
"""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fitter import progress as reporting
from fitter.batch import cluster, records, summing, working
from fitter.batch.disk import disk
from fitter.batch.planning import Plan, Unit
from fitter.documents import write_document


@dataclass(frozen=True)
class Done:
    """A batch's end: how many units were done now, were there already, and failed; seconds."""

    folder: Path
    done: int
    kept: int
    failed: int
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "kind": "brdf-fitter/batch-done", "folder": str(self.folder), "done": self.done,
            "kept": self.kept, "failed": self.failed, "seconds": self.seconds,
        }  # fmt: skip


def run(
    what: Plan, out: str | Path, *, workers: int | None = None, scheduler: str | None = None,
    progress: reporting.Progress = reporting.ignore,
) -> Done:  # fmt: skip
    """Do the units that are not done yet, then write the summary and the index.

    workers : processes on this machine, default one a core; 1 works in this process and needs no Dask.
    scheduler : address of a running Dask scheduler whose workers see the same files, instead.

    However it ends, also by an exception out of ``progress``, what is finished is in the summary, and the
    same call goes on from there.

    Raises
    ------
    SpecError : the scheduler isn't there; Dask is not installed. FitError : the disk is full; the scheduler
    went away.
    """
    begun = time.monotonic()
    folder = Path(out).resolve()
    keys = {unit.name: unit.key(what.work) for unit in what.units}
    todo = [unit for unit in what.units if not _finished(unit, keys, folder)]
    spec = what.spec.model_dump(mode="json")
    with disk(folder):
        write_document({"kind": "brdf-fitter/batch", "spec": spec, **what.to_dict()}, folder / "batch.json")
    counter = _Counter(len(todo), progress)
    try:
        if todo:
            count = workers or os.cpu_count() or 1
            if len(todo) < count and scheduler is None:
                # No more workers than tables, of which a file may hold several.
                count = min(count, sum(working.count(unit) for unit in todo))
            tasks = ((unit, keys[unit.name]) for unit in todo)
            with _ends(tasks, spec, folder, count, scheduler, counter) as arriving:
                for failed in arriving:
                    counter.one(failed)
    finally:
        with disk(folder):
            summing.write(what, keys, folder)
    return Done(
        folder, counter.done, len(what.units) - len(todo), counter.failed + len(what.refused),
        time.monotonic() - begun,
    )  # fmt: skip


def _finished(unit: Unit, keys: Mapping[str, str], folder: Path) -> bool:
    """Whether the unit was done as asked now and did not fail."""
    record = records.read_record(folder, unit.name)
    return record is not None and record.get("key") == keys[unit.name] and not records.failed(record)


class _Counter:
    """What the progress says: how many are done and failed, and how long the rest will take."""

    def __init__(self, total: int, report: reporting.Progress) -> None:
        self._total = total
        self._report = report
        self.done = self.failed = 0
        self._begun = time.monotonic()

    def one(self, failed: bool) -> None:
        self.done += 1
        self.failed += failed
        self.say(0)

    def say(self, running: int | None, part: float = 0.0) -> None:
        """``running`` : tasks under way; None where there is no worker to do them. ``part`` : units' worth of
        what is done of unfinished ones."""
        done = self.done + part
        words = f"{self.done} of {self._total} done"
        if running is None:
            words += ", waiting for a worker"
        elif running:
            words += f", {running} running"
        if self.failed:
            words += f", {self.failed} failed"
        if done:
            left = (time.monotonic() - self._begun) / done * (self._total - done)
            words += f", {left:.0f} s left" if left < 120 else f", {left / 60:.0f} min left"
        self._report(done / self._total, words)


@contextmanager
def _ends(
    todo: Iterator[tuple[Unit, str]], spec: dict[str, Any], folder: Path, workers: int, scheduler: str | None,
    counter: _Counter,
) -> Generator[Iterator[bool]]:  # fmt: skip
    """Does the tasks; for each that ends, whether it failed. Its record is on the disk by then."""
    if scheduler is None and workers == 1:
        yield _here(todo, spec, folder, counter)
        return
    with cluster.client(workers, scheduler) as client:
        yield cluster.ends(client, todo, spec, folder, counter.say)


def _here(
    todo: Iterator[tuple[Unit, str]], spec: dict[str, Any], folder: Path, counter: _Counter
) -> Iterator[bool]:
    for unit, key in todo:
        counter.say(1)
        with disk(folder):
            told = functools.partial(counter.say, 1)
            failed = working.work(unit.to_dict(), spec, key, str(folder), told=told)["failed"]
        yield failed
