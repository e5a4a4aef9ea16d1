"""Sessions: the database's transactions, its clock, and what every row has in common."""

from __future__ import annotations

import re
import uuid
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from sqlalchemy import ColumnElement, Float, func, select
from sqlalchemy.exc import OperationalError
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.orm import Session
from sqlalchemy.sql.functions import FunctionElement

from api import migrations
from api.database import open_engine
from api.rows import Row
from fitter.errors import FitError

_R = TypeVar("_R", bound=Row)
_ID = re.compile("[0-9a-f]{32}")


def new_id() -> str:
    """A random id: it says nothing about what it names, and can't be guessed."""
    return uuid.uuid4().hex


def is_id(text: str) -> bool:
    """Whether the text could be an id at all."""
    return _ID.fullmatch(text) is not None


class Now(FunctionElement[float]):
    """Seconds since 1970 by the database's clock: the one that all servers share."""

    type = Float(53)
    inherit_cache = True


@compiles(Now, "sqlite")
def _sqlite_now(element: Any, compiler: Any, **more: Any) -> str:
    return "((julianday('now') - 2440587.5) * 86400.0)"


@compiles(Now, "postgresql")
def _postgresql_now(element: Any, compiler: Any, **more: Any) -> str:
    return "CAST(extract(epoch FROM clock_timestamp()) AS double precision)"


class Sessions:
    """An open database. SQLite is brought to this version's rows, PostgreSQL has to have been.

    Raises SpecError for a URL that can't be used, and for a database of another version; FitError where it
    does not answer.
    """

    def __init__(self, url: str) -> None:
        self._engine = open_engine(url)
        try:
            if self.shared:
                migrations.require(self._engine)
            else:
                migrations.upgrade(self._engine)
        except OperationalError as error:
            self._engine.dispose()
            raise FitError(
                f"the database does not answer: {error.orig}", code="database-away",
                remedy="see that it runs and that its address is right",
            ) from error  # fmt: skip
        except BaseException:
            self._engine.dispose()
            raise
        self._writer = self._engine.execution_options(brdf_write=True)

    @property
    def shared(self) -> bool:
        """Whether several servers may work on this database: not on SQLite."""
        return self._engine.dialect.name != "sqlite"

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

    def add(self, row: Row) -> None:
        with self.writing() as session:
            session.add(row)

    def get(self, kind: type[_R], id: str) -> _R | None:
        """The row of that id; None too for text that can't be an id."""
        if not is_id(id):
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
