"""Running a plan: in this process, on workers of this machine, or on somebody's Dask cluster.

Files are read and results written by the workers; through the scheduler go names, options and records. What
is finished is finished: running the same plan into the same folder again does the rest.
"""

from __future__ import annotations

import errno
import os
import tempfile
import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitter import progress as reporting
from fitter.batch import summing, working
from fitter.batch.planning import Plan, Unit
from fitter.documents import write_document
from fitter.errors import FitError, SpecError

if TYPE_CHECKING:
    from distributed import Client

#: Tasks that a scheduler holds for each worker: enough that none waits, few enough for a million tables.
_AHEAD = 4
#: Seconds between two reports of progress, and to wait for a scheduler.
_LOOK_EVERY, _PATIENCE = 0.5, 10.0
#: A worker has one core: more threads than that only stand in each other's way.
_ONE_THREAD = {
    "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false --xla_cpu_parallel_codegen_split_count=1",
}  # fmt: skip
#: A unit and the key of what is to be done.
_Task = tuple[Unit, str]
_FULL = (errno.ENOSPC, errno.EDQUOT)


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
    SpecError : the scheduler isn't there; Dask is not installed. FitError : the disk is full.
    """
    begun = time.monotonic()
    folder = Path(out).resolve()
    keys = {unit.name: unit.key(what.work) for unit in what.units}
    todo = [unit for unit in what.units if not _finished(unit, keys, folder)]
    spec = what.spec.model_dump(mode="json")
    with _disk(folder):
        write_document({"kind": "brdf-fitter/batch", "spec": spec, **what.to_dict()}, folder / "batch.json")
    counter = _Counter(len(todo), progress)
    try:
        if todo:
            count = workers or os.cpu_count() or 1
            tasks = ((unit, keys[unit.name]) for unit in todo)
            with _ends(tasks, spec, folder, min(count, len(todo)), scheduler, counter) as arriving:
                for failed in arriving:
                    counter.one(failed)
    finally:
        with _disk(folder):
            summing.write(what, keys, folder)
    return Done(
        folder, counter.done, len(what.units) - len(todo), counter.failed + len(what.refused),
        time.monotonic() - begun,
    )  # fmt: skip


def _finished(unit: Unit, keys: Mapping[str, str], folder: Path) -> bool:
    """Whether the unit was done as asked now and did not fail."""
    record = working.read_record(folder, unit.name)
    return record is not None and record.get("key") == keys[unit.name] and not working.failed(record)


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

    def say(self, running: int) -> None:
        words = f"{self.done} of {self._total} done"
        if running:
            words += f", {running} running"
        if self.failed:
            words += f", {self.failed} failed"
        if self.done:
            left = (time.monotonic() - self._begun) / self.done * (self._total - self.done)
            words += f", {left:.0f} s left" if left < 120 else f", {left / 60:.0f} min left"
        self._report(self.done / self._total, words)


@contextmanager
def _ends(
    todo: Iterator[_Task], spec: dict[str, Any], folder: Path, workers: int, scheduler: str | None,
    counter: _Counter,
) -> Generator[Iterator[bool]]:  # fmt: skip
    """Does the tasks; for each that ends, whether it failed. Its record is on the disk by then."""
    if scheduler is None and workers == 1:
        yield _here(todo, spec, folder, counter)
        return
    with _client(workers, scheduler) as client:
        yield _on_cluster(client, todo, spec, folder, counter)


def _here(todo: Iterator[_Task], spec: dict[str, Any], folder: Path, counter: _Counter) -> Iterator[bool]:
    for unit, key in todo:
        counter.say(1)
        with _disk(folder):
            failed = working.work(unit.to_dict(), spec, key, str(folder))
        yield failed


def _on_cluster(
    client: Client, todo: Iterator[_Task], spec: dict[str, Any], folder: Path, counter: _Counter
) -> Iterator[bool]:
    from distributed import KilledWorker, wait

    running: dict[Any, _Task] = {}
    try:
        while True:
            room = _AHEAD * max(1, len(client.scheduler_info(n_workers=-1)["workers"])) - len(running)
            for _, (unit, key) in zip(range(room), todo, strict=False):
                future = client.submit(
                    working.work, unit.to_dict(), spec, key, str(folder), key=f"batch-{key}", pure=False
                )
                running[future] = unit, key
            if not running:
                return
            with client.as_current(), suppress(TimeoutError):  # nothing finished meanwhile
                wait(list(running), timeout=_LOOK_EVERY, return_when="FIRST_COMPLETED")
            for future in [one for one in running if one.done()]:
                unit, key = running.pop(future)
                with _disk(folder):
                    try:
                        failed = future.result()
                    except KilledWorker as error:
                        failed = True
                        working.write_record(folder, _lost(unit, key, error))
                yield failed
            counter.say(len(running))
    finally:
        for future in running:
            future.cancel()


def _lost(unit: Unit, key: str, error: Exception) -> dict[str, Any]:
    """The record of a unit under which several workers died, one after another."""
    problem = {
        "code": "batch-worker-died", "message": "every worker that began this table died",
        "file": unit.paths[0],
        "cause": f"it needs more memory than a worker has ({error})",
        "remedy": "fit it alone with `brdf-fitter fit`, or with fewer --workers",
    }  # fmt: skip
    return working.record_of(unit, key, error=problem)


@contextmanager
def _disk(folder: Path) -> Generator[None]:
    """Turns a disk that takes no more into an error that says what to do."""
    try:
        yield
    except OSError as error:
        full = error.errno in _FULL
        raise FitError(
            f"the disk of {folder} is full" if full
            else f"results can't be written: {error.strerror or error}",
            code="disk-full" if full else "output-unwritable", file=str(folder),
            remedy=("make room" if full else "mend that") + " and give the same command again: what is "
            "finished is kept",
        ) from error  # fmt: skip


@contextmanager
def _client(workers: int, scheduler: str | None) -> Generator[Client]:
    """A client of the scheduler, or of a cluster of this machine that ends with it."""
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise SpecError(
            "several workers need Dask, which is not installed", code="needs-dask", parameter="workers",
            remedy="pip install 'brdf-fitter[dask]', or work in one process with --workers 1",
        ) from error  # fmt: skip
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            raise SpecError(
                f"no Dask scheduler answers at {scheduler}", code="scheduler-unreachable",
                parameter="scheduler", cause=str(error) or None,
                remedy="start one with `dask scheduler`, or leave the option out",
            ) from error  # fmt: skip
        with client:
            yield client
        return
    with (
        tempfile.TemporaryDirectory(prefix="brdf-batch-") as place,
        LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0",
            local_directory=place, env=_ONE_THREAD, silence_logs=50,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):  # fmt: skip
        yield client
