"""The service: everything one server holds while it runs."""

from __future__ import annotations

import fcntl
import importlib.util
import logging
import threading
from typing import BinaryIO

from anyio import CapacityLimiter

from api import idempotency
from api.blobs import Blobs
from api.database import parsed
from api.engine import Engine, InProcess
from api.jobs import EXHAUSTED, Runner
from api.metrics import Metrics
from api.open_models import OpenModels
from api.parsing import Limits, Parsers
from api.problems import Problem
from api.results import Results
from api.rows import JobRow
from api.settings import Settings
from api.states import FINAL
from api.storage import open_storage
from api.store import Missing, QueueFull, Store
from api.tables import OpenTables
from api.work import Worker
from fitter.errors import SpecError

_log = logging.getLogger("brdf_fitter.api")

#: Seconds after which an upload on its way, to a server that shares its folder with others, is nobody's.
OLD_UPLOAD = 86_400.0
#: Exports that are worked on at once, but for those that only print.
EXPORTS = 2


class Service:
    """One server's parts.

    With SQLite no other process may serve the data folder meanwhile; with PostgreSQL any number may.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        settings.folder.mkdir(parents=True, exist_ok=True)
        self._lock = _lock(settings)
        self.metrics = Metrics()
        self.store = Store(settings.url)
        place = settings.place
        storage = open_storage(place.storage)
        self.blobs = Blobs(storage, place.folder)
        self.results = Results(storage, place.folder)
        limits = Limits(
            settings.max_parse_bytes, settings.max_parse_seconds, settings.max_samples, settings.max_channels
        )
        self.parsers = Parsers(settings.parsers, limits)
        #: Who waits for another's export waits without a thread: those are for who is at work.
        self.exports = CapacityLimiter(EXPORTS)
        self.tables = OpenTables(self.blobs, settings.cached_tables)
        self.models = OpenModels(settings.cached_models)
        #: Set when the server is asked to stop: event streams end, so that nothing holds it up.
        self.stopping = threading.Event()
        #: One report at a time: drawing figures takes memory and every core there is.
        self.report_lock = threading.Lock()
        self.engine = self._open_engine()
        self._runner = Runner(
            self.store, self.engine, self.metrics, settings.workers, lease_seconds=settings.lease_seconds,
            max_attempts=settings.max_attempts,
        )  # fmt: skip

    @property
    def name(self) -> str:
        """Under which this server leases jobs."""
        return self._runner.name

    def _open_engine(self) -> Engine:
        if self.settings.engine == "threads":
            return InProcess(self.store, Worker(self.store, self.results, self.tables))
        # Only here: it takes a second, and is not installed everywhere.
        from api.dask_engine import Dask

        return Dask(self.store, self.settings.place, self.settings.scheduler, self.settings.workers)

    def start(self) -> None:
        """Clear up after a process that died, then work."""
        self.blobs.clear_incoming(OLD_UPLOAD if self.store.shared else 0.0)
        again = self.store.recover(self.settings.max_attempts, EXHAUSTED, everything=not self.store.shared)
        if again:
            _log.warning("%d job(s) of a server that died wait again", again)
        if not self.store.shared:
            idempotency.reset(self.store)
        for id in self.results.checkpoints():
            job = self.store.get(JobRow, id)
            if job is None or job.state in FINAL:
                self.results.drop_checkpoint(id)
        self._runner.start()

    def stop(self) -> None:
        self.stopping.set()
        if not self._runner.stop(self.settings.grace_seconds):
            _log.warning("a job did not stop in time; the next start takes it up again")
        self.parsers.close()
        self.store.close()
        if self._lock is not None:
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
    lock = _lock(settings)
    if lock is not None:
        lock.close()


def check_parts(settings: Settings) -> None:
    """Raises SpecError where the database, the storage or the engine can't be used."""
    Store(settings.url).close()
    open_storage(settings.place.storage)
    if settings.engine == "dask" and importlib.util.find_spec("distributed") is None:
        raise SpecError(
            "Dask is not installed", code="extra-missing", parameter="engine",
            remedy="pip install 'brdf-fitter[dask]'",
        )  # fmt: skip


def _lock(settings: Settings) -> BinaryIO | None:
    """The folder's lock; None where the database is one that servers share."""
    if parsed(settings.url).get_backend_name() != "sqlite":
        return None
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
