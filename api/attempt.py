"""Attempts: one run of a job, from the leased row to its end in the row.

The same in a thread of the server and in a worker of a cluster.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Literal, TypeVar

from sqlalchemy.exc import SQLAlchemyError

from api.outages import DATABASE, outage
from api.problems import Problem, document, internal, of_fitter_error
from api.queue import Queue
from api.rows import JobRow
from api.states import CANCELLED, QUEUED
from api.work import Outcome, Worker
from fitter.errors import FitterError
from fitter.progress import Cancelled

_log = logging.getLogger("brdf_fitter.api")

#: Seconds between two writes of one job's progress, or this share of its time, whichever is longer: its log
#: grows with the logarithm of the time.
PROGRESS_EVERY, PROGRESS_SHARE = 0.2, 0.01
#: Seconds between two looks whether the job should stop.
LOOK_EVERY = 1.0
#: Seconds between attempts to write how a job ended. After the last one the lease lapses, and the job is
#: started again.
RETRY_AFTER = (0.2, 0.5, 1.0, 2.0, 2.0, 2.0, 4.0, 4.0, 8.0, 8.0, 16.0)

#: Attempts of a job that may meet a database that does not answer.
OUTAGES = 3

_T = TypeVar("_T")
#: How it went: a final state of the row, "queued" where it was put back, "overtaken" where it is not ours.
Ended = Literal["done", "failed", "cancelled", "queued", "overtaken"]


class Attempt:
    """One attempt. ``stopping`` says whether the server wants its jobs back."""

    def __init__(self, store: Queue, worker: Worker, job: JobRow, stopping: Callable[[], bool]) -> None:
        self._store = store
        self._worker = worker
        self._job = job
        self._stopping = stopping
        self._begun = self._written = self._looked = time.monotonic()

    def run(self) -> Ended:
        """Do the work and write how it ended. Raises SQLAlchemyError where the database stays away."""
        job = self._job
        try:
            outcome = self._worker.run(job, self._progress)
        except Cancelled:
            if self._stopping() and self._persist(lambda: self._store.put_back(job)):
                return "queued"
            return self._ended("cancelled", self._persist(lambda: self._store.stop(job)))
        except FitterError as error:
            outcome = Outcome(problem=of_fitter_error(error))
        except Problem as error:
            outcome = Outcome(problem=document(error.status_code, error.code, error.detail, **error.more))
        except DATABASE as error:
            # What the work reads was not to be had for a while: that says nothing of the job.
            _log.warning("job %s is given back: the database did not answer", job.id, exc_info=True)
            problem = outage(error) or internal()
            state = self._persist(lambda: self._store.give_back(job, OUTAGES, problem))
            if state == QUEUED:
                return "queued"
            return self._ended("cancelled" if state == CANCELLED else "failed", state is not None)
        except Exception as error:
            _log.exception("job %s failed", job.id)
            outcome = Outcome(problem=outage(error) or internal())
        return self._finish(outcome)

    def _finish(self, outcome: Outcome) -> Ended:
        job, problem = self._job, outcome.problem
        if problem is not None:
            written = self._persist(lambda: self._store.fail(job, problem, outcome.results))
            return self._ended("failed", written)
        # Where the database stays away, it is not known whether it took the result: its files stay, and
        # `gc` deletes them if it did not.
        published = self._persist(lambda: self._store.publish(job, outcome.rows, outcome.results))
        if not published:
            self._worker.discard(outcome)
        return self._ended("done", published)

    def _ended(self, state: Ended, ours: bool) -> Ended:
        if not ours:
            return "overtaken"
        self._worker.forget(self._job)
        return state

    def _persist(self, write: Callable[[], _T]) -> _T:
        """Write to the row, again and again while the database does not take it."""
        for wait in RETRY_AFTER:
            try:
                return write()
            except DATABASE:
                _log.warning("the database does not take a job's end; again in %g s", wait, exc_info=True)
                time.sleep(wait)
        return write()

    def _progress(self, share: float, what: str) -> None:
        if self._stopping():
            raise Cancelled
        now = time.monotonic()
        try:
            if now - self._written >= max(PROGRESS_EVERY, PROGRESS_SHARE * (now - self._begun)):
                self._written = self._looked = now
                stop = self._store.advance(self._job, share, what)
            elif now - self._looked >= LOOK_EVERY:
                self._looked = now
                stop = self._store.stopped(self._job)
            else:
                return
        except SQLAlchemyError:
            # The work is worth more than the record of how far it is.
            _log.warning("the progress of job %s can't be recorded", self._job.id, exc_info=True)
            return
        if stop:
            raise Cancelled
