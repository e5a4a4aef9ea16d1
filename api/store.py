"""The store: rows in, rows out, each step one transaction. The jobs' part of it is in :mod:`api.queue`."""

from __future__ import annotations

import fcntl
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import func, select, text

from api.queue import Missing, Queue, QueueFull
from api.rows import RESULTS, JobRow, TableRow
from api.sessions import is_id, new_id
from api.states import QUEUED, RUNNING

__all__ = ["InUse", "Missing", "QueueFull", "Store", "new_id"]

#: The number under which PostgreSQL knows :meth:`Store.guarding`; any number that nobody else uses.
_ADVISORY_LOCK = 7_023_452


class InUse(Exception):
    """A waiting or running job needs the row."""


class Store(Queue):
    """The database behind the service. Portable SQL; SQLite in WAL mode, or PostgreSQL."""

    @contextmanager
    def guarding(self) -> Generator[None]:
        """Alone, among all servers and commands on this database, with the question which blobs are named.

        Whoever adds a row that names a blob, or deletes a blob that no row names any more, does it in here.
        """
        if self.shared:
            with self._engine.execution_options(isolation_level="AUTOCOMMIT").connect() as connection:
                connection.execute(text(f"SELECT pg_advisory_lock({_ADVISORY_LOCK})"))
                try:
                    yield
                finally:
                    connection.execute(text(f"SELECT pg_advisory_unlock({_ADVISORY_LOCK})"))
        else:
            with Path(f"{self._engine.url.database}.guard").open("wb") as file:
                fcntl.flock(file, fcntl.LOCK_EX)
                yield

    def delete_table(self, id: str) -> str | None:
        """Delete the row; the hash of its blob where that is now nobody's.

        Raises Missing where there is no such row, InUse where a job still needs it.
        """
        with self.writing() as session:
            row = session.get(TableRow, id, with_for_update=True) if is_id(id) else None
            if row is None:
                raise Missing
            busy = select(JobRow.id).where(JobRow.table_id == id, JobRow.state.in_((QUEUED, RUNNING)))
            if session.scalar(busy.limit(1)):
                raise InUse
            session.delete(row)
            session.flush()
            used = session.scalar(select(TableRow.id).where(TableRow.sha256 == row.sha256).limit(1))
            return row.sha256 if used is None else None

    def counts(self) -> dict[str, dict[str, int]]:
        """Rows of each kind, jobs by state."""
        with self.reading() as session:
            by_state = session.execute(select(JobRow.state, func.count()).group_by(JobRow.state))
            found = {"jobs": {str(state): int(count) for state, count in by_state}}
            for kind in (TableRow, *RESULTS):
                found[kind.__tablename__] = {"": session.scalar(select(func.count()).select_from(kind)) or 0}
            return found
