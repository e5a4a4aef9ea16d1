"""Upkeep: what gc deletes and what it leaves alone, and a backup that can be served."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from api.app import create_app
from api.blobs import Blobs
from api.place import Place
from api.results import Results
from api.rows import JobRow, PosteriorRow, TableRow
from api.settings import Settings
from api.storage import open_storage
from api.store import Store, new_id
from api.upkeep import backup, collect
from fitter.errors import SpecError
from tests.api.conftest import TestClient
from tests.api.databases import KINDS, database

NOTHING = {"jobs": 0, "events": 0, "blobs": 0, "results": 0, "checkpoints": 0, "uploads": 0}


@pytest.fixture(params=KINDS)
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Place]:
    with database(request.param, tmp_path) as url:
        yield Place(tmp_path, url, str(tmp_path))


def test_gc_deletes_what_nothing_names(place: Place) -> None:
    store, storage = Store(place.database), open_storage(place.storage)
    blobs, results = Blobs(storage, place.folder), Results(storage, place.folder)
    table = TableRow(id=new_id(), created=0.0, name="t", sha256="ab" * 32, size=1, options={}, description={})
    store.add(table)
    job = JobRow(id=new_id(), created=time.time(), kind="posterior", table_id=table.id, request={})
    store.add_job(job, 10)
    for sha256 in ("ab" * 32, "cd" * 32):
        storage.write(f"blobs/{sha256[:2]}/{sha256}.zst", b"x")
    row = PosteriorRow(id=new_id(), created=0.0, fit_id="0" * 32, job_id=job.id, summary={})
    store.add(row)
    for id in (row.id, new_id()):
        results.write(id, {})
        results.write_report(id, "html", b"")
    (place.folder / "results" / f".{row.id}.json.x1").write_bytes(b"half")
    for id in (job.id, new_id()):
        results.checkpoint(id).mkdir(parents=True)
    (place.folder / "incoming" / "tmp1").write_bytes(b"half")

    # As young as these are they may belong to work that goes on; a checkpoint belongs to a job or to none.
    assert collect(place) == NOTHING | {"checkpoints": 1}
    found = collect(place, grace_seconds=0.0)
    assert found == NOTHING | {"blobs": 1, "results": 3, "uploads": 1}
    assert collect(place, grace_seconds=0.0) == NOTHING
    assert blobs.holds("ab" * 32)
    assert results.read(row.id) == {}
    assert results.checkpoints() == [job.id]

    claimed = store.claim("here", 30.0)
    assert claimed is not None
    assert store.publish(claimed, [], [])
    assert collect(place, keep_jobs_days=1.0) == NOTHING | {"checkpoints": 1}
    assert collect(place, keep_jobs_days=0.0) == NOTHING | {"jobs": 1, "events": 3}
    assert store.get(JobRow, job.id) is None
    assert store.events(job.id) == []
    store.close()


def test_a_backup_made_while_tables_come_and_go_can_be_served(tmp_path: Path, table_bytes: bytes) -> None:
    settings = Settings(folder=tmp_path / "data", workers=0)
    with TestClient(create_app(settings)) as client:
        stop = threading.Event()
        known: set[str] = set()

        def churn() -> None:
            for number in range(1000):
                if stop.is_set():
                    return
                content = table_bytes + f"# {number}\n".encode()
                id = client.post("/v1/tables", content=content).json()["id"]
                if number % 2:
                    client.delete(f"/v1/tables/{id}")
                else:
                    known.add(id)

        thread = threading.Thread(target=churn)
        thread.start()
        while len(known) < 3:
            time.sleep(0.01)
        before = set(known)
        copied = backup(settings.place, tmp_path / "copy")
        stop.set()
        thread.join()
        with pytest.raises(SpecError) as caught:
            backup(settings.place, tmp_path / "copy")
        assert caught.value.code == "out-exists"
    shutil.rmtree(tmp_path / "data")
    with TestClient(create_app(Settings(folder=tmp_path / "copy", workers=0))) as client:
        page: dict[str, Any] = client.get("/v1/tables?limit=200").json()
        assert before <= {one["id"] for one in page["items"]}
        assert page["total"] <= copied["blobs"]
        for one in page["items"]:
            assert client.get(f"/v1/tables/{one['id']}/slices?theta_i_deg=20&n=2").status_code == 200


def test_backup_says_what_it_can_not_copy(tmp_path: Path) -> None:
    for place, code in (
        (Place(tmp_path, "postgresql://x@127.0.0.1/y", str(tmp_path)), "bad-call"),
        (Place(tmp_path, f"sqlite:///{tmp_path}/service.sqlite", "s3://bucket"), "bad-call"),
        (Place(tmp_path, f"sqlite:///{tmp_path}/service.sqlite", str(tmp_path)), "no-database"),
    ):
        with pytest.raises(SpecError) as caught:
            backup(place, tmp_path / "copy")
        assert caught.value.code == code


def test_a_place_does_not_show_the_password() -> None:
    place = Settings(folder=Path("x"), database_url="postgresql://me:secret@host/name")
    assert "secret" not in repr(place) + repr(place.place)
