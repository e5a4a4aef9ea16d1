"""The Dask engine: leased jobs become tasks of a cluster, under a key made of the job's id and its attempt.

Dask keeps nothing across a scheduler's death, and does not have to: what is lost goes back to the queue, and
the row says which attempt counts.
"""

from __future__ import annotations

import logging
import threading
import time
from typing import TYPE_CHECKING, Any

from distributed import Client, KilledWorker
from sqlalchemy.exc import SQLAlchemyError

from api import tasks
from api.attempt import Ended
from api.dask_local import LocalCluster
from api.engine import Lost
from api.place import Place
from api.rows import JobRow
from api.store import Store

if TYPE_CHECKING:
    from distributed import Future

_log = logging.getLogger("brdf_fitter.api")

#: Seconds between two looks at the client, and at a job that runs.
LOOK_EVERY = 0.5
#: Seconds that a task gets to notice that its job is cancelled; then the row says so without it.
PATIENCE = 30.0
#: Seconds to wait for a scheduler that is called.
TIMEOUT = 5.0


class Dask:
    """``scheduler`` is the address of a running one; None starts a cluster of ``workers`` here."""

    def __init__(self, store: Store, place: Place, scheduler: str | None, workers: int) -> None:
        self._store = store
        self._place = place
        self.cluster = None if scheduler else LocalCluster(workers, place.folder / "dask")
        self._scheduler = scheduler
        self._client: Client | None = None
        self._client_of: str | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="dask-client", daemon=True)

    def start(self) -> None:
        # What it says of a lost scheduler are tracebacks of its own parts; we say it in a line.
        for name in ("client", "core", "utils"):
            logging.getLogger(f"distributed.{name}").setLevel(logging.CRITICAL)
        if self.cluster is not None:
            self.cluster.start()
        self._thread.start()

    def stop(self) -> None:
        self._stopping.set()
        self._thread.join()
        self._close_client()
        if self.cluster is not None:
            self.cluster.stop()

    def ready(self) -> bool:
        client = self._client
        return client is not None and client.status == "running"

    def run(self, job: JobRow, stopping: threading.Event) -> Ended:
        client = self._client
        if client is None:
            raise Lost("there is no scheduler", blame=False)
        over = threading.Event()
        try:
            future: Future[Any] = client.submit(
                tasks.work, self._place, job.id, job.attempt, key=f"job-{job.id}-{job.attempt}", pure=False,
                retries=0,
            )  # fmt: skip
            future.add_done_callback(lambda _: over.set())
        except Exception as error:
            raise Lost(f"the scheduler does not take it: {error}", blame=False) from error
        ended = self._follow(job, client, future, over, stopping)
        return ended if ended is not None else _outcome(future)

    def _follow(
        self,
        job: JobRow,
        client: Client,
        future: Future[Any],
        over: threading.Event,
        stopping: threading.Event,
    ) -> Ended | None:
        """Wait for the task. An end that is not the task's own: put back, or cancelled without it."""
        asked: float | None = None
        while not over.wait(LOOK_EVERY):
            if client is not self._client or client.status == "closed":
                raise Lost("the scheduler is gone", blame=False)
            if stopping.is_set():
                # From here on the task is an overtaken attempt, and stops when it sees that.
                self._store.put_back(job)
                future.cancel()
                return "queued"
            try:
                row = self._store.get(JobRow, job.id)
            except SQLAlchemyError:
                continue  # away for a while; the task has its own patience
            if row is None or row.attempt != job.attempt or row.state != "running":
                # The task wrote its end a moment ago, or another server has taken over.
                if over.wait(LOOK_EVERY):
                    return None
                continue
            if row.cancel:
                asked = asked or time.monotonic()
                if row.worker is None or time.monotonic() - asked > PATIENCE:
                    future.cancel()
                    return "cancelled" if self._store.stop(job) else "overtaken"
        return None

    def _keep(self) -> None:
        """Have a client of the scheduler that there is."""
        while not self._stopping.wait(LOOK_EVERY if self._client else 0.05):
            try:
                self._look()
            except Exception as error:
                # The scheduler is not there yet, or not any more; the thread has to outlive that.
                _log.warning("the Dask scheduler does not answer: %s", error)
                self._stopping.wait(1.0)

    def _look(self) -> None:
        address = self.cluster.address if self.cluster is not None else self._scheduler
        client = self._client
        if client is not None and (client.status == "closed" or address != self._client_of):
            self._close_client()
        if self._client is None and address is not None:
            self._client = Client(address, timeout=TIMEOUT, set_as_default=False)
            self._client_of = address

    def _close_client(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            client.close(timeout=TIMEOUT)


def _outcome(future: Future[Any]) -> Ended:
    """How the task says that it ended. Raises Lost where it was not the task that ended."""
    if future.status != "finished":
        error = future.exception(timeout=TIMEOUT) if future.status == "error" else None
        if isinstance(error, KilledWorker):
            raise Lost("its worker died")
        if isinstance(error, SQLAlchemyError):
            raise Lost("its worker does not reach the database", blame=False)
        if error is not None:
            raise Lost(f"its worker can't do it: {error!r}")
        raise Lost("the scheduler is gone", blame=False)
    ended = future.result(timeout=TIMEOUT)
    if ended == "lost":
        raise Lost("its worker died")
    return ended
