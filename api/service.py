"""The service: everything one server holds while it runs."""

from __future__ import annotations

import fcntl
import logging
import threading
from typing import BinaryIO

from api import idempotency
from api.blobs import Blobs
from api.jobs import EXHAUSTED, InProcess, Runner
from api.metrics import Metrics
from api.parsing import Limits, Parsers
from api.problems import Problem
from api.results import Results
from api.rows import QUEUED, JobRow
from api.settings import Settings
from api.store import Missing, QueueFull, Store
from api.tables import OpenTables
from api.work import Worker
from fitter.errors import SpecError

_log = logging.getLogger("brdf_fitter.api")


class Service:
    """One server's parts, opened on its data folder, which no other process may serve meanwhile."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        settings.folder.mkdir(parents=True, exist_ok=True)
        self._lock = _lock(settings)
        self.metrics = Metrics()
        self.store = Store(settings.url)
        self.blobs = Blobs(settings.folder)
        self.results = Results(settings.folder)
        limits = Limits(
            settings.max_parse_bytes, settings.max_parse_seconds, settings.max_samples, settings.max_channels
        )
        self.parsers = Parsers(settings.parsers, limits)
        self.tables = OpenTables(self.blobs, settings.cached_tables)
        #: Set when the server is asked to stop: event streams end, so that nothing holds it up.
        self.stopping = threading.Event()
        #: One report at a time: drawing figures takes memory and every core there is.
        self.report_lock = threading.Lock()
        worker = Worker(self.store, self.results, self.tables)
        self._runner = Runner(
            self.store, InProcess(self.store, worker), self.metrics, settings.workers,
            lease_seconds=settings.lease_seconds, max_attempts=settings.max_attempts,
        )  # fmt: skip

    def start(self) -> None:
        """Clear up after a process that died, then work."""
        self.blobs.clear_incoming()
        again = self.store.recover(self.settings.max_attempts, EXHAUSTED, everything=not self.store.shared)
        if again:
            _log.warning("%d job(s) of a server that died wait again", again)
        if not self.store.shared:
            idempotency.reset(self.store)
        for id in self.results.checkpoints():
            job = self.store.get(JobRow, id)
            if job is None or job.state != QUEUED:
                self.results.drop_checkpoint(id)
        self._runner.start()

    def stop(self) -> None:
        self.stopping.set()
        if not self._runner.stop(self.settings.grace_seconds):
            _log.warning("a job did not stop in time; the next start takes it up again")
        self.store.close()
        self._lock.close()

    def submit(self, job: JobRow) -> None:
        """Queue a job. Raises Problem: 404 where its table is gone, 429 where the queue is full."""
        try:
            self.store.add_job(job, self.settings.max_queue)
        except Missing as error:
            raise Problem.not_found("table", job.table_id) from error
        except QueueFull as error:
            raise Problem(
                429, "queue-full", f"{self.settings.max_queue} jobs are waiting already",
                headers={"Retry-After": "30"}, remedy="try again later, or cancel jobs that are not needed",
            ) from error  # fmt: skip
        self._runner.wake()


def check_folder(settings: Settings) -> None:
    """Raises SpecError where another server works on the data folder; for callers that start one."""
    settings.folder.mkdir(parents=True, exist_ok=True)
    _lock(settings).close()


def _lock(settings: Settings) -> BinaryIO:
    file = (settings.folder / "lock").open("wb")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        file.close()
        raise SpecError(
            "another server works on this data folder", code="folder-in-use", file=str(settings.folder),
            remedy="stop it, or give this one a folder of its own",
        ) from error  # fmt: skip
    return file
