"""The store: rows in, rows out, each step one transaction."""

from __future__ import annotations

import re
import time
import uuid
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import orjson
from sqlalchemy import ColumnElement, Engine, create_engine, event, func, select, update
from sqlalchemy.engine import Connection, CursorResult
from sqlalchemy.orm import Session

from api.rows import (
    CANCELLED,
    DONE,
    FAILED,
    QUEUED,
    RUNNING,
    CalibrationRow,
    JobRow,
    ModelRow,
    PosteriorRow,
    Row,
    TableRow,
    TradeoffRow,
)

_R = TypeVar("_R", bound=Row)


_ID = re.compile("[0-9a-f]{32}")


def new_id() -> str:
    """A random id: it says nothing about what it names, and can't be guessed."""
    return uuid.uuid4().hex


class QueueFull(Exception):
    """As many jobs wait as the server lets wait."""


class Missing(Exception):
    """There is no such row."""


class InUse(Exception):
    """A waiting or running job needs the row."""


class Store:
    """The database behind the service. Portable SQL; SQLite in WAL mode, or whatever the URL names."""

    def __init__(self, url: str) -> None:
        # More connections than the framework has threads, so that no request waits for one.
        self._engine = create_engine(
            url, pool_size=48, max_overflow=16, json_serializer=lambda o: orjson.dumps(o).decode(),
            json_deserializer=orjson.loads,
        )  # fmt: skip
        if self._engine.dialect.name == "sqlite":
            _prepare_sqlite(self._engine)
        self._writer = self._engine.execution_options(brdf_write=True)
        Row.metadata.create_all(self._writer)

    def close(self) -> None:
        self._engine.dispose()

    def ping(self) -> None:
        """Raises when the database does not answer."""
        with self.reading() as session:
            session.scalar(select(1))

    @contextmanager
    def reading(self) -> Generator[Session]:
        """A session for queries; rows stay usable after it."""
        with Session(self._engine, expire_on_commit=False) as session:
            yield session

    @contextmanager
    def writing(self) -> Generator[Session]:
        """One transaction: committed on leaving, undone on an exception."""
        with Session(self._writer, expire_on_commit=False) as session, session.begin():
            yield session

    # Any row ----------------------------------------------------------------------------------------

    def add(self, row: Row) -> None:
        with self.writing() as session:
            session.add(row)

    def get(self, kind: type[_R], id: str) -> _R | None:
        """The row of that id; None too for text that can't be an id."""
        if not _ID.fullmatch(id):
            return None
        with self.reading() as session:
            return session.get(kind, id)

    def page(
        self, kind: type[_R], limit: int, offset: int, *where: ColumnElement[bool]
    ) -> tuple[Sequence[_R], int]:
        """Rows, newest first, and how many there are in all."""
        with self.reading() as session:
            total = session.scalar(select(func.count()).select_from(kind).where(*where)) or 0
            query = select(kind).where(*where).order_by(kind.created.desc(), kind.id)
            return session.scalars(query.limit(limit).offset(offset)).all(), total

    # Tables -----------------------------------------------------------------------------------------

    def delete_table(self, id: str) -> str | None:
        """Delete the row; the hash of its blob where that is now nobody's.

        Raises Missing where there is no such row, InUse where a job still needs it.
        """
        with self.writing() as session:
            row = session.get(TableRow, id, with_for_update=True) if _ID.fullmatch(id) else None
            if row is None:
                raise Missing
            busy = select(JobRow.id).where(JobRow.table_id == id, JobRow.state.in_((QUEUED, RUNNING)))
            if session.scalar(busy.limit(1)):
                raise InUse
            session.delete(row)
            session.flush()
            used = session.scalar(select(TableRow.id).where(TableRow.sha256 == row.sha256).limit(1))
            return row.sha256 if used is None else None

    # Jobs -------------------------------------------------------------------------------------------

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

    def claim(self) -> JobRow | None:
        """The oldest waiting job, now running under a new attempt."""
        with self.writing() as session:
            query = select(JobRow).where(JobRow.state == QUEUED).order_by(JobRow.created, JobRow.id)
            row = session.scalar(query.limit(1).with_for_update(skip_locked=True))
            if row is None:
                return None
            row.state, row.attempt, row.started = RUNNING, row.attempt + 1, time.time()
            row.share, row.what = 0.0, "starting"
            return row

    def advance(self, job: JobRow, share: float, what: str) -> bool:
        """Record progress; True when the job should stop (cancelled, or no longer this attempt's)."""
        with self.writing() as session:
            mine = self._move(session, job, share=min(max(share, 0.0), 1.0), what=what[:255])
            return not mine or bool(session.scalar(select(JobRow.cancel).where(JobRow.id == job.id)))

    def publish(self, job: JobRow, rows: Sequence[Row], results: list[dict[str, Any]]) -> bool:
        """Make the results visible and the job done, in one step; False where it is not ours any more."""
        with self.writing() as session:
            mine = self._move(
                session, job, state=DONE, share=1.0, what="done", finished=time.time(), results=results
            )
            if mine:
                session.add_all(rows)
            return mine

    def fail(self, job: JobRow, problem: dict[str, Any], results: list[dict[str, Any]]) -> bool:
        with self.writing() as session:
            return self._move(
                session, job, state=FAILED, finished=time.time(), problem=problem, results=results
            )

    def stop(self, job: JobRow) -> bool:
        """A cancelled job has stopped."""
        with self.writing() as session:
            return self._move(session, job, state=CANCELLED, finished=time.time())

    def put_back(self, job: JobRow) -> bool:
        """The server stops before the job is done: it waits again, and the attempt does not count."""
        with self.writing() as session:
            return self._move(session, job, state=QUEUED, attempt=job.attempt - 1, started=None, share=0.0)

    def cancel(self, id: str) -> JobRow:
        """A waiting job is cancelled at once, a running one is asked to stop."""
        with self.writing() as session:
            row = session.get_one(JobRow, id, with_for_update=True)
            if row.state == QUEUED:
                row.state, row.finished, row.cancel = CANCELLED, time.time(), True
            elif row.state == RUNNING:
                row.cancel = True
            return row

    def recover(self, max_attempts: int, problem: dict[str, Any]) -> int:
        """What a dead process left running waits again, or is given up. Returns how many wait again."""
        with self.writing() as session:
            left = JobRow.state == RUNNING
            session.execute(
                update(JobRow).where(left, JobRow.cancel).values(state=CANCELLED, finished=time.time())
            )
            session.execute(
                update(JobRow).where(left, JobRow.attempt >= max_attempts)
                .values(state=FAILED, finished=time.time(), problem=problem)
            )  # fmt: skip
            again = session.execute(
                update(JobRow).where(left).values(state=QUEUED, started=None, share=0.0, what="queued again")
            )
            return _count(again)

    def counts(self) -> dict[str, dict[str, int]]:
        """Rows of each kind, jobs by state."""
        with self.reading() as session:
            by_state = session.execute(select(JobRow.state, func.count()).group_by(JobRow.state))
            found = {"jobs": {str(state): int(count) for state, count in by_state}}
            for kind in (TableRow, ModelRow, PosteriorRow, TradeoffRow, CalibrationRow):
                found[kind.__tablename__] = {"": session.scalar(select(func.count()).select_from(kind)) or 0}
            return found

    @staticmethod
    def _move(session: Session, job: JobRow, **values: Any) -> bool:
        """Compare and set: only while the row still runs under this attempt."""
        still = (JobRow.id == job.id, JobRow.state == RUNNING, JobRow.attempt == job.attempt)
        return _count(session.execute(update(JobRow).where(*still).values(**values))) == 1


def _count(result: Any) -> int:
    assert isinstance(result, CursorResult)
    return result.rowcount


def _prepare_sqlite(engine: Engine) -> None:
    """WAL mode, and transactions that begin when asked and take the write lock at once when they write.

    The driver's own begin is deferred: a transaction that reads first and writes later would fail
    with "database is locked" instead of waiting.
    """

    @event.listens_for(engine, "connect")
    def on_connect(connection: Any, record: Any) -> None:
        del record
        connection.isolation_level = None
        cursor = connection.cursor()
        for pragma in ("busy_timeout = 30000", "journal_mode = WAL", "foreign_keys = ON"):
            cursor.execute(f"PRAGMA {pragma}")
        cursor.close()

    @event.listens_for(engine, "begin")
    def on_begin(connection: Connection) -> None:
        write = connection.get_execution_options().get("brdf_write", False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")
