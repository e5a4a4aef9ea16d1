"""Two servers on one PostgreSQL and one Dask scheduler, and what happens when a process of them is killed."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from api.app import create_app
from api.dask_engine import Dask
from api.rows import JobRow, ModelRow, PosteriorRow
from api.service import Service
from api.settings import Settings
from tests.api.conftest import TestClient, wait_for
from tests.api.databases import database
from tests.api.test_server import Server

#: A posterior that does not end by itself while a test looks.
ENDLESS = {"ess": 1_000_000, "walkers": 8, "budget_seconds": 600}


@dataclass
class Pair:
    """``one`` runs here and has the cluster; ``other`` is a process, and uses it."""

    one: TestClient
    other: Server
    service: Service
    folder: Path

    @property
    def pids(self) -> dict[str, list[int]]:
        engine = self.service.engine
        assert isinstance(engine, Dask)
        assert engine.cluster is not None
        return engine.cluster.pids()

    def row(self, location: str) -> JobRow:
        row = self.service.store.get(JobRow, location.rpartition("/")[2])
        assert row is not None
        return row

    def until(self, location: str, condition: Callable[[JobRow], bool]) -> JobRow:
        end = time.monotonic() + 180
        while not condition(row := self.row(location)):
            assert time.monotonic() < end, (row.state, row.attempt, row.what, row.problem)
            time.sleep(0.05)
        return row

    def segments(self, location: str) -> int:
        kept = self.folder / "checkpoints" / location.rpartition("/")[2]
        return len(list(kept.glob("segment-*.npz")))


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pair]:
    folder = tmp_path_factory.mktemp("pair") / "data"
    with database("postgresql", folder) as url:
        settings = Settings(folder=folder, database_url=url, engine="dask", workers=2, lease_seconds=3.0)
        with TestClient(create_app(settings)) as one:
            service: Service = one.app.state.service  # type: ignore[attr-defined]
            engine = service.engine
            assert isinstance(engine, Dask)
            end = time.monotonic() + 120
            while engine.cluster is None or engine.cluster.address is None:
                assert time.monotonic() < end
                time.sleep(0.05)
            other = Server(
                folder, database_url=url, engine="dask", scheduler=engine.cluster.address, workers=2,
                lease_seconds=3.0,
            )  # fmt: skip
            try:
                other.ready()
                yield Pair(one, other, service, folder)
            finally:
                other.close()


def events(client: Any, location: str, after: int = 0) -> list[tuple[int, str]]:
    """(number, name) of every event that the stream sends."""
    found: list[tuple[int, str]] = []
    with client.stream("GET", f"{location}/events", headers={"Last-Event-ID": str(after)}) as stream:
        fields: dict[str, str] = {}
        for line in stream.iter_lines():
            if line:
                name, _, value = line.partition(": ")
                fields[name] = value
            elif "id" in fields:
                found.append((int(fields["id"]), fields["event"]))
                fields = {}
    return found


@pytest.mark.long
def test_two_servers_share_the_work_and_publish_each_job_once(pair: Pair, table_bytes: bytes) -> None:
    table = pair.one.post("/v1/tables", content=table_bytes).json()["id"]
    wanted = {"table": table, "model": "oren_nayar"}
    # Each has two places; the jobs come to both, and are asked of both.
    jobs = [
        client.post("/v1/fits", json=wanted).headers["location"]
        for _ in range(6)
        for client in (pair.one, pair.other.client)
    ]
    done = [wait_for(pair.one, job) for job in jobs]
    assert [job["state"] for job in done] == ["done"] * 12, done
    with_results = [result["id"] for job in done for result in job["results"]]
    assert pair.service.store.page(ModelRow, 100, 0)[1] == len(with_results) == len(set(with_results)) == 12
    assert len({pair.row(job).server for job in jobs}) == 2
    assert len({pair.row(job).worker for job in jobs}) == 2
    for id in with_results:
        assert pair.other.client.get(f"/v1/fits/{id}").json()["status"] == "converged"
    # The log of a job is the same wherever it is read, and from any number on.
    whole = events(pair.one, jobs[0])
    assert [number for number, _ in whole] == list(range(1, len(whole) + 1))
    assert [name for _, name in whole] == ["progress"] * (len(whole) - 1) + ["done"]
    assert events(pair.other.client, jobs[0], after=2) == whole[2:]
    assert events(pair.other.client, jobs[0], after=len(whole)) == []


@pytest.mark.long
def test_killed_worker_server_and_scheduler(
    pair: Pair, table_bytes: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = pair.one.post("/v1/tables", content=table_bytes).json()["id"]
    job = wait_for(pair.one, pair.one.post(
        "/v1/fits", json={"table": table, "model": "oren_nayar"}
    ).headers["location"])  # fmt: skip
    wanted = {"fit": job["results"][0]["id"], **ENDLESS}
    with monkeypatch.context() as patched:
        # The other server has the job, for as long as it lives.
        patched.setattr(pair.service.store, "claim", lambda *_: None)
        here = pair.other.client.post("/v1/posteriors", json=wanted).headers["location"]
        pair.until(here, lambda row: pair.segments(here) > 0)

        # The worker: the job goes on where it was, on another one, under the next attempt.
        worker = str(pair.row(here).worker).rpartition(":")[2]
        os.kill(int(worker), signal.SIGKILL)
        row = pair.until(here, lambda row: row.attempt == 2 and row.worker is not None)
        assert row.losses == 1
        assert not str(row.worker).endswith(f":{worker}")
        before = pair.segments(here)
        pair.until(here, lambda row: pair.segments(here) > before)
        assert pair.row(here).server != pair.service.name
        pair.other.end(signal.SIGKILL)

    # This one takes the job over when the lease has lapsed; a server that only asked for the work is not what
    # the job killed.
    row = pair.until(here, lambda row: row.attempt == 3 and row.worker is not None)
    assert (row.server, row.losses) == (pair.service.name, 1)

    # The scheduler: the job starts again when there is one, and nothing is held against it, either.
    os.kill(pair.pids["scheduler"][0], signal.SIGKILL)
    row = pair.until(here, lambda row: row.attempt == 4 and row.worker is not None)
    assert row.losses == 1

    # Cancelling is cooperative, wherever the job runs.
    assert pair.one.post(f"{here}/cancel").json()["state"] == "running"
    assert wait_for(pair.one, here)["state"] == "cancelled"
    assert pair.service.store.page(PosteriorRow, 10, 0)[1] == 0
    whole = events(pair.one, here)
    assert [number for number, _ in whole] == list(range(1, len(whole) + 1))
    assert whole[-1][1] == "cancelled"


def test_a_stopped_server_gives_its_jobs_back(pair: Pair, table_bytes: bytes) -> None:
    table = pair.one.post("/v1/tables", content=table_bytes).json()["id"]
    wanted = {"table": table, "models": ["lafortune:3"] * 8, "starts": 1000}
    here = pair.one.post("/v1/fits", json=wanted).headers["location"]
    attempt = pair.until(here, lambda row: row.worker is not None).attempt
    pair.service.stop()
    store = pair.service.store
    row = store.get(JobRow, here.rpartition("/")[2])
    assert row is not None
    assert (row.state, row.attempt, row.losses, row.lease) == ("queued", attempt, 0, None)
    store.cancel(row.id)
