"""Jobs: threads that take waiting rows, do the work and publish what came of it."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from sqlalchemy.exc import OperationalError, SQLAlchemyError

from api.metrics import Metrics
from api.problems import Problem, document, internal, of_fitter_error
from api.rows import JobRow
from api.store import Store
from api.work import Outcome, Worker
from fitter.errors import FitterError
from fitter.progress import Cancelled, Progress

_log = logging.getLogger("brdf_fitter.api")

#: Seconds between two writes of one job's progress.
PROGRESS_EVERY = 0.2
#: Seconds between attempts to write how a job ended. After the last one the row stays "running", and the
#: next start of the server queues the job again.
RETRY_AFTER = (0.5, 2.0, 8.0)
#: Seconds after which an idle thread looks at the queue without having been told to.
IDLE_LOOK = 5.0

EXHAUSTED = document(
    500, "job-attempts-exhausted", "the server died each time it worked on this job",
    cause="the job needs more memory than the machine has, or it meets a fault of a library",
    remedy="try a smaller table or another model, and report it",
)  # fmt: skip


class Runner:
    """A pool of threads. The numerics release the interpreter's lock, so threads of one process do."""

    def __init__(self, store: Store, worker: Worker, metrics: Metrics, threads: int) -> None:
        self._store = store
        self._worker = worker
        self._metrics = metrics
        self._news = threading.Condition()
        self._told = 0
        self._stopping = threading.Event()
        self._threads = [
            threading.Thread(target=self._loop, name=f"job-{k}", daemon=True) for k in range(threads)
        ]

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def wake(self) -> None:
        """A job was queued."""
        with self._news:
            self._told += 1
            self._news.notify()

    def stop(self, grace_seconds: float) -> bool:
        """Ask all jobs to go back to the queue at their next safe point; True where all did in time.

        What is still running then is a row that the next start queues again.
        """
        self._stopping.set()
        with self._news:
            self._news.notify_all()
        end = time.monotonic() + grace_seconds
        for thread in self._threads:
            thread.join(max(0.0, end - time.monotonic()))
        return not any(thread.is_alive() for thread in self._threads)

    def _loop(self) -> None:
        while not self._stopping.is_set():
            told = self._told
            try:
                job = self._store.claim()
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
        try:
            outcome = self._worker.run(job, self._reporter(job))
        except Cancelled:
            if self._stopping.is_set() and self._store.put_back(job):
                return
            self._store.stop(job)
            state = "cancelled"
        except FitterError as error:
            state = self._failed(job, Outcome(problem=of_fitter_error(error)))
        except Problem as error:
            found = document(error.status_code, error.code, error.detail, **error.more)
            state = self._failed(job, Outcome(problem=found))
        except Exception:
            _log.exception("job %s failed", job.id)
            state = self._failed(job, Outcome(problem=internal()))
        else:
            state = self._finish(job, outcome)
        self._worker.forget(job)
        self._metrics.job(job.kind, state, time.monotonic() - begun)

    def _finish(self, job: JobRow, outcome: Outcome) -> str:
        if outcome.problem is not None:
            return self._failed(job, outcome)
        try:
            published = self._persist(lambda: self._store.publish(job, outcome.rows, outcome.results))
        except Exception:
            self._worker.discard(outcome)
            raise
        if not published:
            self._worker.discard(outcome)
        return "done"

    def _failed(self, job: JobRow, outcome: Outcome) -> str:
        problem = outcome.problem
        assert problem is not None
        self._persist(lambda: self._store.fail(job, problem, outcome.results))
        return "failed"

    def _persist(self, write: Callable[[], bool]) -> bool:
        """Write to the row, again a few times while the database does not take it."""
        for wait in RETRY_AFTER:
            try:
                return write()
            except OperationalError:
                _log.warning("the database does not take a job's end; again in %g s", wait, exc_info=True)
                self._stopping.wait(wait)
        return write()

    def _reporter(self, job: JobRow) -> Progress:
        last = 0.0

        def progress(share: float, what: str) -> None:
            nonlocal last
            if self._stopping.is_set():
                raise Cancelled
            now = time.monotonic()
            if now - last >= PROGRESS_EVERY:
                last = now
                try:
                    stop = self._store.advance(job, share, what)
                except SQLAlchemyError:
                    # The work is worth more than the record of how far it is.
                    _log.warning("the progress of job %s can't be recorded", job.id, exc_info=True)
                    return
                if stop:
                    raise Cancelled

        return progress
