"""Migrations: the steps by which a database comes to the rows of this version.

Each step is a file of ``versions``, named by its number; its ``down_revision`` is the one before. A database
made before there were migrations is taken over by the first: what is there stays as it is.
"""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, text

from fitter.errors import SpecError

#: The number under which PostgreSQL knows that somebody upgrades; any number that nobody else uses.
_ADVISORY_LOCK = 7_023_451


def _config(connection: Connection | None = None) -> Config:
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent).replace("%", "%%"))
    config.attributes["connection"] = connection
    return config


def head() -> str:
    """The revision that this version works with."""
    found = ScriptDirectory.from_config(_config()).get_current_head()
    assert found is not None
    return found


def current(engine: Engine) -> str | None:
    """The database's revision; None where it has none yet."""
    with engine.connect() as connection:
        return MigrationContext.configure(connection).get_current_revision()


def upgrade(engine: Engine, revision: str = "head") -> None:
    """Bring the database to the rows of this version, in one transaction; nothing that it holds is lost.

    Raises SpecError where a later version of the program made it.
    """
    refuse_later(current(engine))
    with engine.execution_options(brdf_write=True).begin() as connection:
        if engine.dialect.name == "postgresql":
            # Two servers that start together: the second waits, and finds that there is nothing to do.
            connection.execute(text(f"SELECT pg_advisory_xact_lock({_ADVISORY_LOCK})"))
        command.upgrade(_config(connection), revision)


def require(engine: Engine) -> None:
    """Raises SpecError where the database is not that of this version."""
    found = current(engine)
    refuse_later(found)
    if found != head():
        state = "is empty" if found is None else f"is at revision {found}"
        raise SpecError(
            f"the database {state}, and this version works with revision {head()}",
            code="database-behind", parameter="database",
            remedy="make a backup, stop every server, and run `brdf-fitter db upgrade`",
        )  # fmt: skip


def refuse_later(found: str | None) -> None:
    """Raises SpecError for a revision that this version does not know."""
    known = {one.revision for one in ScriptDirectory.from_config(_config()).walk_revisions()}
    if found is not None and found not in known:
        raise SpecError(
            f"the database is at revision {found}, which a later version of the program made",
            code="database-ahead", parameter="database", remedy="install that version again",
        )  # fmt: skip
