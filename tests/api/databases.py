"""Databases for the tests: SQLite files, and PostgreSQL schemas of their own over real connections."""

from __future__ import annotations

import os
import uuid
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import psycopg
import pytest

from api import migrations
from api.database import open_engine

KINDS = ("sqlite", "postgresql")
#: The PostgreSQL that the tests use: named in BRDF_POSTGRES, where it then has to answer, or this machine's.
NAMED = os.environ.get("BRDF_POSTGRES")
ADDRESS = NAMED or "postgresql://postgres@127.0.0.1:5432/test"


def _answers() -> bool:
    try:
        psycopg.connect(ADDRESS, connect_timeout=5).close()
    except psycopg.OperationalError:
        return False
    return True


@contextmanager
def database(kind: str, folder: Path, *, upgraded: bool = True) -> Generator[str]:
    """The address of an empty database, gone afterwards; of PostgreSQL with this version's rows."""
    if kind == "sqlite":
        yield f"sqlite:///{folder / 'rows.sqlite'}"
        return
    if not _answers() and NAMED is None:
        pytest.skip(f"NO POSTGRESQL: {ADDRESS} does not answer (set BRDF_POSTGRES)")
    schema = f"t{uuid.uuid4().hex}"
    with psycopg.connect(ADDRESS, autocommit=True) as connection:
        connection.execute(f"CREATE SCHEMA {schema}".encode())
        try:
            url = f"{ADDRESS}?options=-csearch_path%3D{schema}"
            if upgraded:
                engine = open_engine(url)
                migrations.upgrade(engine)
                engine.dispose()
            yield url
        finally:
            connection.execute(f"DROP SCHEMA {schema} CASCADE".encode())
