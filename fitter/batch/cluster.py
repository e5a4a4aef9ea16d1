"""The workers of a batch: processes of this machine, or somebody's Dask cluster.

Through the scheduler go names, options and, of files that hold several tables, their records.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitter.batch import records, working
from fitter.batch.disk import disk
from fitter.batch.planning import Unit
from fitter.errors import FitError, SpecError

if TYPE_CHECKING:
    from distributed import Client

#: Tasks that a scheduler holds for each worker: enough that none waits, few enough for a million tables.
_AHEAD = 4
#: Seconds between two reports of progress, and to wait for a scheduler.
_LOOK_EVERY, _PATIENCE = 0.5, 10.0
#: Seconds of all workers together that may go into reading a file of several tables again and again.
_READING = 10.0
#: A worker has one core: more threads than that only stand in each other's way.
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
_XLA_ONE_THREAD = "--xla_cpu_multi_thread_eigen=false --xla_cpu_parallel_codegen_split_count=1"


@dataclass
class _Parts:
    """A unit of several tables that is done in shares: what is left and what has come."""

    count: int
    left: int
    records: list[Mapping[str, Any]] = field(default_factory=list[Mapping[str, Any]])
    tables: dict[int, Mapping[str, Any]] = field(default_factory=dict[int, Mapping[str, Any]])

    @property
    def done(self) -> float:
        return 1.0 - self.left / self.count


@dataclass(frozen=True)
class _Task:
    """What a worker is sent; ``share`` as of :func:`fitter.batch.working.work`.

    alone : it is sent again, with nothing beside it, since workers died that had it.
    """

    unit: Unit
    key: str
    share: tuple[int, int] | None = None
    parts: _Parts | None = None
    alone: bool = False

    def name(self, folder: Path) -> str:
        """The task's key on the scheduler, which does what has one key once: nothing that writes to another
        folder, or does another share, may have it."""
        place = hashlib.sha256(str(folder).encode()).hexdigest()[:8]
        part = "" if self.share is None else "-{}-of-{}".format(*self.share)
        return f"batch-{self.key}-{place}{part}{'-alone' if self.alone else ''}"


def ends(
    client: Client, todo: Iterator[tuple[Unit, str]], spec: dict[str, Any], folder: Path,
    say: Callable[[int | None, float], None],
) -> Iterator[bool]:  # fmt: skip
    """Does the units; for each that ends, whether it failed. ``say`` is told how many tasks are under way,
    None where there is no worker, and how much is done of the units that are done in shares."""
    shares: deque[_Task] = deque()
    suspects: deque[_Task] = deque()
    running: dict[Any, _Task] = {}
    open_units: dict[str, _Parts] = {}
    try:
        while True:
            with _scheduler():
                workers = len(client.scheduler_info(n_workers=-1)["workers"])
                room = max(0, _AHEAD * max(1, workers) - len(running))
                chosen = [shares.popleft() for _ in range(min(room, len(shares)))]
                chosen += [_Task(*one) for one in islice(todo, room - len(chosen))]
                if suspects and not running and not chosen:
                    chosen.append(suspects.popleft())
                running.update(_submitted(client, chosen, spec, folder))
                if not running:
                    return
                ended = _ended(client, list(running))
            for future in ended:
                task = running.pop(future)
                with disk(folder), _scheduler():
                    end = _end(future, task)
                if end is None:
                    suspects.append(replace(task, alone=True))
                    continue
                if "tables" in end:
                    # Every share reads the file again: as many shares as that may cost, tables at most.
                    bearable = max(_AHEAD * workers, 1, int(_READING / max(end["seconds"], 1e-3)))
                    count = min(end["tables"], bearable)
                    parts = open_units[task.unit.name] = _Parts(count, count)
                    shares += [_Task(task.unit, task.key, (k, count), parts) for k in range(count)]
                    continue
                record = end.get("record")
                if task.parts is not None:
                    record = _joined(task.parts, end, task)
                    if record is None:
                        continue
                    del open_units[task.unit.name]
                if record is not None:
                    with disk(folder):
                        records.write_record(folder, record)
                yield end["failed"] if record is None else records.failed(record)
            say(len(running) if workers else None, sum(one.done for one in open_units.values()))
    finally:
        for future in running:
            future.cancel()


def _submitted(
    client: Client, tasks: Iterable[_Task], spec: dict[str, Any], folder: Path
) -> Iterator[tuple[Any, _Task]]:
    for task in tasks:
        future = client.submit(
            working.work, task.unit.to_dict(), spec, task.key, str(folder), task.share,
            split=task.share is None, key=task.name(folder), pure=False,
        )  # fmt: skip
        yield future, task


def _ended(client: Client, futures: Sequence[Any]) -> list[Any]:
    """Those that have ended, once there is one, or after a while."""
    from distributed import wait

    with client.as_current(), suppress(TimeoutError):  # nothing finished meanwhile
        wait(futures, timeout=_LOOK_EVERY, return_when="FIRST_COMPLETED")
    return [one for one in futures if one.done()]


@contextmanager
def _scheduler() -> Generator[None]:
    """Turns the end of the scheduler into an error that says what to do."""
    from distributed import CancelledError
    from distributed.comm.core import CommClosedError

    try:
        yield
    except (CancelledError, CommClosedError) as error:
        raise FitError(
            "the scheduler is gone", code="scheduler-lost", cause="it has ended, or the network",
            remedy="start it again and give the same command: what is finished is kept",
        ) from error  # fmt: skip


def _joined(parts: _Parts, end: Mapping[str, Any], task: _Task) -> dict[str, Any] | None:
    """The unit's record once its last share has come."""
    parts.left -= 1
    parts.records.append(end["record"])
    parts.tables.update(zip(end["order"], end["record"]["tables"], strict=True))
    if parts.left:
        return None
    error = next((record["error"] for record in parts.records if record["error"] is not None), None)
    seconds = sum(record["seconds"] or 0.0 for record in parts.records)
    return records.record_of(
        task.unit, task.key, seconds, [table for _, table in sorted(parts.tables.items())], error
    )


def _end(future: Any, task: _Task) -> dict[str, Any] | None:
    """What the worker says, or that workers died under the task, one after another; None where they may have
    died under another one: the scheduler counts a death against all tasks that wait at the worker."""
    from distributed import KilledWorker

    try:
        return future.result()
    except KilledWorker as error:
        if not task.alone:
            return None
        problem = {
            "code": "batch-worker-died", "message": "every worker that began this table died",
            "file": task.unit.paths[0],
            "cause": f"it needs more memory than a worker has ({error})",
            "remedy": "fit it alone with `brdf-fitter fit`, or with fewer --workers",
        }  # fmt: skip
        record = records.record_of(task.unit, task.key, error=problem)
        return {"failed": True, "record": record, "order": []}


@contextmanager
def client(workers: int, scheduler: str | None) -> Generator[Client]:
    """A client of the scheduler, or of a cluster of this machine that ends with it."""
    try:
        from distributed import Client, LocalCluster
        from distributed.comm.addressing import get_address_host_port
    except ImportError as error:
        raise SpecError(
            "several workers need Dask, which is not installed", code="needs-dask", parameter="workers",
            remedy="pip install 'brdf-fitter[dask]', or work in one process with --workers 1",
        ) from error  # fmt: skip
    if scheduler is not None:
        try:
            get_address_host_port(scheduler, strict=True)  # a client of no address takes long to end
            found = Client(scheduler, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            raise SpecError(
                f"no Dask scheduler answers at {scheduler}", code="scheduler-unreachable",
                parameter="scheduler", cause=str(error) or None,
                remedy="start one with `dask scheduler`, or leave the option out",
            ) from error  # fmt: skip
        with found:
            yield found
        return
    # What the environment says to XLA stands, or workers would compile other programs than this process does.
    flags = f"{os.environ.get('XLA_FLAGS', '')} {_XLA_ONE_THREAD}".strip()
    with (
        tempfile.TemporaryDirectory(prefix="brdf-batch-") as place,
        LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0",
            local_directory=place, env=_ONE_THREAD | {"XLA_FLAGS": flags}, silence_logs=50,
        ) as own,
        Client(own, set_as_default=False) as found,
    ):  # fmt: skip
        yield found
