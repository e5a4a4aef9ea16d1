"""Migrations: a database of the version before there were any, both kinds, too old and too new."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import Engine, text

from api import migrations
from api.database import open_engine
from api.jobs import EXHAUSTED
from api.rows import Base, JobRow, TableRow
from api.store import Store
from fitter.errors import SpecError
from tests.api.databases import KINDS, database

BEFORE = (Path(__file__).parent / "before_migrations.sql").read_text()


@pytest.fixture(params=KINDS)
def empty(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Engine]:
    with database(request.param, tmp_path, upgraded=False) as url:
        engine = open_engine(url)
        yield engine
        engine.dispose()


def test_the_migrations_make_the_rows_that_the_code_has(empty: Engine) -> None:
    migrations.upgrade(empty)
    migrations.upgrade(empty)  # nothing to do
    with empty.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, Base.metadata) == []


def test_servers_that_upgrade_together(empty: Engine) -> None:
    failures: list[BaseException] = []

    def one() -> None:
        try:
            migrations.upgrade(empty)
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=one) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    assert migrations.current(empty) == migrations.head()


def test_a_later_version_is_refused(empty: Engine) -> None:
    migrations.upgrade(empty)
    with empty.execution_options(brdf_write=True).begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = 'later'"))
    for act in (migrations.upgrade, migrations.require):
        with pytest.raises(SpecError) as caught:
            act(empty)
        assert caught.value.code == "database-ahead"


def test_postgresql_is_not_upgraded_by_a_server(tmp_path: Path) -> None:
    with database("postgresql", tmp_path, upgraded=False) as url:
        for before in (None, "0001"):
            engine = open_engine(url)
            if before is not None:
                migrations.upgrade(engine, before)
            engine.dispose()
            with pytest.raises(SpecError) as caught:
                Store(url)
            assert caught.value.code == "database-behind"
            assert "db upgrade" in str(caught.value)


@pytest.mark.parametrize("url", ["nonsense", "mysql://root@127.0.0.1/x", "sqlite+aiosqlite:////x y"])
def test_addresses_that_make_no_sense(url: str) -> None:
    with pytest.raises(SpecError) as caught:
        open_engine(url.replace("sqlite+aiosqlite", "oracle"))
    assert caught.value.parameter == "database"


def _dump(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Every row of the tables that the old version had."""
    with sqlite3.connect(path) as connection:
        connection.row_factory = sqlite3.Row
        names = ("tables", "jobs", "models", "tradeoffs", "calibrations", "posteriors")
        found = {
            name: [dict(row) for row in connection.execute(f"SELECT * FROM {name} ORDER BY id")]
            for name in names
        }
    connection.close()
    return found


def test_a_database_from_before_is_taken_over_whole(tmp_path: Path) -> None:
    path = tmp_path / "rows.sqlite"
    connection = sqlite3.connect(path)
    connection.executescript(BEFORE)
    connection.close()
    before = _dump(path)
    assert all(before.values())

    store = Store(f"sqlite:///{path}")
    after = _dump(path)
    for name, rows in before.items():
        assert [{key: row[key] for key in rows[0]} for row in after[name]] == rows, name
    assert store.page(TableRow, 10, 0)[1] == 1
    # What was running is started again; of each job the log tells how it is.
    jobs = {job.state: job for job in store.page(JobRow, 10, 0)[0]}
    assert set(jobs) == {"done", "running", "queued"}
    for job in jobs.values():
        (event,) = store.events(job.id)
        assert (event.seq, event.data["state"], event.data["results"]) == (1, job.state, job.results)
    assert store.events(jobs["done"].id)[0].kind == "done"
    assert store.recover(3, EXHAUSTED) == 1
    assert [event.data["state"] for event in store.events(jobs["running"].id)] == ["running", "queued"]
    store.close()
