"""The database: an engine for a URL; SQLite prepared for several writers, PostgreSQL for being restarted."""

from __future__ import annotations

import importlib.util
from typing import Any

import orjson
from sqlalchemy import URL, Engine, create_engine, event, make_url
from sqlalchemy.engine import Connection
from sqlalchemy.exc import ArgumentError

from fitter.errors import SpecError

#: Connections that one process keeps open, and how many more it opens when it is busy. PostgreSQL grants 100
#: in all by default: several servers and their workers have to share those.
_POOLS = {"sqlite": (48, 16), "postgresql": (5, 15)}
_REMEDY = "give sqlite:////path/to/file or postgresql://user:password@host/database"


def parsed(url: str) -> URL:
    """The URL of a database that we work with. Raises SpecError."""
    try:
        found = make_url(url)
    except ArgumentError as error:
        # Not the text itself: it may hold a password.
        raise SpecError(
            "the database's address is no URL", code="bad-call", parameter="database", remedy=_REMEDY
        ) from error
    kind = found.get_backend_name()
    if kind not in _POOLS:
        raise SpecError(
            f"a database of the kind {kind!r} is not supported", code="bad-call", parameter="database",
            remedy=_REMEDY,
        )  # fmt: skip
    if kind == "postgresql":
        found = found.set(drivername="postgresql+psycopg")
        if importlib.util.find_spec("psycopg") is None:
            raise SpecError(
                "PostgreSQL needs a driver that is not installed", code="extra-missing", parameter="database",
                remedy="pip install 'brdf-fitter[postgres]'",
            )  # fmt: skip
    return found


def open_engine(url: str) -> Engine:
    """An engine; writing transactions are those of ``execution_options(brdf_write=True)``."""
    where = parsed(url)
    size, more = _POOLS[where.get_backend_name()]
    engine = create_engine(
        where, pool_size=size, max_overflow=more, pool_pre_ping=where.get_backend_name() != "sqlite",
        json_serializer=lambda o: orjson.dumps(o).decode(), json_deserializer=orjson.loads,
    )  # fmt: skip
    if engine.dialect.name == "sqlite":
        _prepare_sqlite(engine)
    return engine


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
