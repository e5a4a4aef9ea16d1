"""Jobs: threads that lease waiting rows and have an engine work on them."""

from __future__ import annotations

import logging
import threading
import time

from api.engine import Engine, Lost
from api.metrics import Metrics
from api.problems import document
from api.rows import JobRow
from api.store import Store, new_id
from fitter.memory_maps import forget_when_many

_log = logging.getLogger("brdf_fitter.api")

#: Seconds after which an idle thread looks at the queue without having been told to.
IDLE_LOOK = 5.0
#: Seconds between two looks whether an engine that is not ready has become so.
ENGINE_LOOK = 0.1

EXHAUSTED = document(
    500, "job-attempts-exhausted", "the process that worked on this job died each time",
    cause="the job needs more memory than the machine has, or it meets a fault of a library",
    remedy="try a smaller table or another model, and report it",
)  # fmt: skip


class Runner:
    """Leases as many jobs at a time as it has threads, renews the leases, and takes up lapsed ones."""

    def __init__(
        self, store: Store, engine: Engine, metrics: Metrics, threads: int, *, lease_seconds: float = 30.0,
        max_attempts: int = 3, name: str | None = None,
    ) -> None:  # fmt: skip
        self._store = store
        self._engine = engine
        self._metrics = metrics
        self._lease_seconds = lease_seconds
        self._max_attempts = max_attempts
        #: Under which jobs are leased.
        self.name = name or new_id()
        self._held: dict[str, JobRow] = {}
        self._news = threading.Condition()
        self._told = 0
        self._stopping = threading.Event()
        self._stopped = threading.Event()
        self._threads = [
            threading.Thread(target=self._loop, name=f"job-{k}", daemon=True) for k in range(threads)
        ]
        self._keeper = threading.Thread(target=self._keep, name="leases", daemon=True)

    def start(self) -> None:
        self._engine.start()
        for thread in (self._keeper, *self._threads):
            thread.start()

    def wake(self) -> None:
        """A job was queued."""
        with self._news:
            self._told += 1
            self._news.notify()

    def stop(self, grace_seconds: float) -> bool:
        """Ask all jobs to go back to the queue at their next safe point; True where all did in time.

        What is still running then is a row whose lease lapses.
        """
        self._stopping.set()
        with self._news:
            self._news.notify_all()
        end = time.monotonic() + grace_seconds
        for thread in self._threads:
            thread.join(max(0.0, end - time.monotonic()))
        self._stopped.set()
        self._keeper.join()
        self._engine.stop()
        return not any(thread.is_alive() for thread in self._threads)

    def _loop(self) -> None:
        while not self._stopping.is_set():
            told = self._told
            if not self._engine.ready():
                self._stopping.wait(ENGINE_LOOK)
                continue
            try:
                job = self._store.claim(self.name, self._lease_seconds)
                if job is not None:
                    self._run(job)
                    continue
            except Exception:
                # The database may be away for a while; the thread has to outlive that.
                _log.exception("the job queue can't be served; trying again")
            with self._news:
                # News that came between the look at the queue and here must not be slept through.
                if told == self._told and not self._stopping.is_set():
                    self._news.wait(IDLE_LOOK)

    def _run(self, job: JobRow) -> None:
        begun = time.monotonic()
        self._held[job.id] = job
        try:
            ended = self._engine.run(job, self._stopping)
        except Lost as error:
            _log.warning("job %s, attempt %d was lost: %s", job.id, job.attempt, error)
            if error.blame:
                self._store.give_back(job, self._max_attempts, EXHAUSTED)
            else:
                self._store.put_back(job)
            ended = "lost"
        finally:
            # Before the lease is given up: from here on nobody renews it.
            del self._held[job.id]
        if ended not in ("queued", "overtaken"):
            self._tell(job, ended, time.monotonic() - begun)

    def _tell(self, job: JobRow, ended: str, seconds: float) -> None:
        """The metrics and the log of a run that has ended."""
        row = self._store.get(JobRow, job.id)
        self._metrics.job(job.kind, ended, seconds, [] if row is None else row.results)
        about = {"job": job.id, "kind": job.kind, "attempt": job.attempt, "state": ended}
        _log.info("a job has ended", extra={**about, "seconds": round(seconds, 3)})

    def _keep(self) -> None:
        while not self._stopped.wait(self._lease_seconds / 3):
            try:
                self._store.renew(list(self._held.values()), self._lease_seconds)
                again = self._store.recover(self._max_attempts, EXHAUSTED)
            except Exception:
                _log.exception("leases can't be renewed; trying again")
                continue
            forget_when_many()
            if again:
                _log.warning("the leases of %d job(s) lapsed; they wait again", again)
                self.wake()
