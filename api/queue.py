"""The queue: jobs, their leases, and the log of what became of each.

A job's row changes and its event is written in one transaction, so that the log has no gap and no repeat. Who
runs a job holds a lease on it; a lease that lapses gives the job back to the queue. Everything that a worker
writes is a compare-and-set on (id, attempt): what an overtaken attempt writes changes nothing.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import orjson
from sqlalchemy import func, or_, select
from sqlalchemy.orm import Session

from api.rows import EventRow, JobRow, Row, TableRow
from api.sessions import Now, Sessions, is_id
from api.states import CANCELLED, DONE, FAILED, FINAL, QUEUED, RUNNING

#: What of a job changes, and so what its events hold.
SHOWN = ("state", "attempt", "share", "what", "started", "finished", "results", "problem")
#: A job is given up after so many losses that may be its own doing, or after this many times as many starts.
STARTS = 10


class QueueFull(Exception):
    """As many jobs wait as the server lets wait."""


class Missing(Exception):
    """There is no such row."""


class Queue(Sessions):
    """The jobs of the database."""

    def add_job(self, job: JobRow, max_queue: int) -> None:
        """Queue it. Raises Missing where its table was deleted meanwhile, and QueueFull."""
        with self.writing() as session:
            # The lock keeps the table from being deleted between this look and the insertion.
            if job.table_id and session.get(TableRow, job.table_id, with_for_update=True) is None:
                raise Missing
            waiting = session.scalar(select(func.count()).select_from(JobRow).where(JobRow.state == QUEUED))
            if (waiting or 0) >= max_queue:
                raise QueueFull
            session.add(job)
            session.flush()
            _log(session, job)

    def claim(self, server: str, lease_seconds: float) -> JobRow | None:
        """The oldest waiting job, now running under a new attempt and leased to ``server``."""
        with self.writing() as session:
            query = select(JobRow).where(JobRow.state == QUEUED).order_by(JobRow.created, JobRow.id)
            row = session.scalar(query.limit(1).with_for_update(skip_locked=True))
            if row is None:
                return None
            row.state, row.attempt, row.started = RUNNING, row.attempt + 1, time.time()
            row.share, row.what = 0.0, "starting"
            row.server, row.worker, row.lease = server, None, _now(session) + lease_seconds
            _log(session, row)
            return row

    def renew(self, jobs: Sequence[JobRow], lease_seconds: float) -> dict[str, JobRow]:
        """Prolong the leases of those jobs that still run under the same attempt; their rows, by id.

        Only of jobs that the caller knows: one whose claim got lost on the wire has to lapse.
        """
        held: dict[str, JobRow] = {}
        with self.writing() as session:
            # In one order everywhere, so that two servers never wait for each other.
            for job in sorted(jobs, key=lambda one: one.id):
                row = _mine(session, job)
                if row is not None:
                    row.lease = _now(session) + lease_seconds
                    held[row.id] = row
        return held

    def begin(self, job: JobRow, worker: str) -> bool:
        """Let ``worker`` work on this attempt; False where another has begun it or it is over. A server that
        works on it itself gives its own name.

        An engine that starts a task again by itself, after its worker died, gets no further than this: the
        next start has to be the next attempt, or a job that kills its workers would be started without end.
        """
        with self.writing() as session:
            row = _mine(session, job)
            if row is None or row.worker not in (None, worker):
                return False
            row.worker = worker
            return True

    def stopped(self, job: JobRow) -> bool:
        """Whether the job should stop: it is cancelled, or no longer this attempt's."""
        with self.reading() as session:
            row = session.scalar(select(JobRow).where(*_still(job)))
            return row is None or row.cancel

    def advance(self, job: JobRow, share: float, what: str) -> bool:
        """Record progress; True when the job should stop (cancelled, or no longer this attempt's)."""
        with self.writing() as session:
            row = _mine(session, job)
            if row is None:
                return True
            row.share, row.what = min(max(share, 0.0), 1.0), what[:255]
            _log(session, row)
            return row.cancel

    def publish(self, job: JobRow, rows: Sequence[Row], results: list[dict[str, Any]]) -> bool:
        """Make the results visible and the job done, in one step; False where it is not ours any more.

        May be called again when it is not known whether the database took it: it is published once.
        """
        with self.writing() as session:
            row = _mine(session, job)
            if row is None:
                there = session.get(JobRow, job.id)
                if there is None or (there.state, there.attempt) != (DONE, job.attempt):
                    return False
                return _json(there.results) == _json(results)
            for made in rows:
                made.owner = row.owner
            session.add_all(rows)
            _end(session, row, DONE, share=1.0, what="done", results=results)
            return True

    def fail(self, job: JobRow, problem: dict[str, Any], results: list[dict[str, Any]]) -> bool:
        with self.writing() as session:
            row = _mine(session, job)
            if row is not None:
                _end(session, row, FAILED, problem=problem, results=results)
            return row is not None

    def stop(self, job: JobRow) -> bool:
        """A cancelled job has stopped."""
        with self.writing() as session:
            row = _mine(session, job)
            if row is not None:
                _end(session, row, CANCELLED)
            return row is not None

    def put_back(self, job: JobRow) -> bool:
        """The server stops before the job is done: it waits again, and nothing is held against it."""
        with self.writing() as session:
            row = _mine(session, job)
            if row is not None:
                _queue_again(session, row)
            return row is not None

    def give_back(self, job: JobRow, max_losses: int, problem: dict[str, Any]) -> str | None:
        """The attempt was lost with its worker: the next one, or the end (``problem``). The job's state then;
        None where it is not ours any more.

        Nothing is held against a job at which the worker was not yet: it stood in line for it.
        """
        with self.writing() as session:
            row = _mine(session, job)
            if row is None:
                return None
            _lost(session, row, max_losses, problem, blame=row.worker is not None)
            return row.state

    def recover(self, max_losses: int, problem: dict[str, Any], *, everything: bool = False) -> int:
        """Jobs whose lease has lapsed wait again, or are given up. Returns how many wait again.

        The death of a server is held against the jobs that ran in it, and not against those at which a worker
        of a cluster was: theirs is told by :meth:`give_back`.

        everything : all that are running, for who knows that nobody else can be at work.
        """
        with self.writing() as session:
            lapsed = or_(JobRow.lease.is_(None), JobRow.lease < Now())
            where = (JobRow.state == RUNNING,) if everything else (JobRow.state == RUNNING, lapsed)
            query = select(JobRow).where(*where).order_by(JobRow.id).with_for_update(skip_locked=True)
            found = session.scalars(query).all()
            own = [row.worker is not None and row.worker == row.server for row in found]
            return sum(
                _lost(session, row, max_losses, problem, blame=mine)
                for row, mine in zip(found, own, strict=True)
            )

    def cancel(self, id: str) -> JobRow:
        """A waiting job is cancelled at once, a running one is asked to stop."""
        with self.writing() as session:
            row = session.get_one(JobRow, id, with_for_update=True)
            if row.state in (QUEUED, RUNNING):
                row.cancel = True
            if row.state == QUEUED:
                _end(session, row, CANCELLED)
            return row

    def events(self, job_id: str, after: int = 0, limit: int = 500) -> Sequence[EventRow]:
        """The job's events with a number above ``after``, in order."""
        if not is_id(job_id):
            return []
        with self.reading() as session:
            query = select(EventRow).where(EventRow.job_id == job_id, EventRow.seq > after)
            return session.scalars(query.order_by(EventRow.seq).limit(limit)).all()


def _still(job: JobRow) -> tuple[Any, ...]:
    return JobRow.id == job.id, JobRow.state == RUNNING, JobRow.attempt == job.attempt


def _mine(session: Session, job: JobRow) -> JobRow | None:
    """The compare of compare-and-set: the row, locked, while it still runs under this attempt."""
    return session.scalar(select(JobRow).where(*_still(job)).with_for_update())


def _end(session: Session, row: JobRow, state: str, **values: Any) -> None:
    for name, value in values.items():
        setattr(row, name, value)
    row.state, row.finished, row.lease = state, time.time(), None
    _log(session, row)


def _queue_again(session: Session, row: JobRow) -> None:
    row.state, row.started, row.share, row.what = QUEUED, None, 0.0, "queued again"
    row.server = row.worker = row.lease = None
    _log(session, row)


def _lost(session: Session, row: JobRow, max_losses: int, problem: dict[str, Any], *, blame: bool) -> bool:
    row.losses += blame
    if row.cancel:
        _end(session, row, CANCELLED)
    elif row.losses >= max_losses or row.attempt >= STARTS * max_losses:
        _end(session, row, FAILED, problem=problem)
    else:
        _queue_again(session, row)
    return row.state == QUEUED


def _log(session: Session, row: JobRow) -> None:
    """Write the next event: how the row is now. The row is locked, so the number is nobody else's."""
    row.events = (row.events or 0) + 1
    session.add(
        EventRow(
            job_id=row.id, seq=row.events, created=time.time(),
            kind=row.state if row.state in FINAL else "progress",
            data={name: getattr(row, name) for name in SHOWN},
        )
    )  # fmt: skip


def _json(results: list[dict[str, Any]]) -> bytes:
    return orjson.dumps(results, option=orjson.OPT_SORT_KEYS)


def _now(session: Session) -> float:
    now = session.scalar(select(Now()))
    assert now is not None
    return now
