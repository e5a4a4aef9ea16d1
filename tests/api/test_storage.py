"""Storage: a folder, and fsspec's file systems, keep the same promises."""

from __future__ import annotations

import uuid
from pathlib import Path

import pytest

from api.blobs import Blobs
from api.results import Results
from api.storage import Storage, open_storage
from fitter.errors import SpecError

KINDS = ("folder", "file://", "memory://")


@pytest.fixture(params=KINDS)
def storage(request: pytest.FixtureRequest, tmp_path: Path) -> Storage:
    kept = tmp_path / "kept"
    where = {"folder": str(kept), "file://": f"file://{kept}", "memory://": f"memory://{uuid.uuid4().hex}"}
    return open_storage(where[request.param])


def test_write_read_drop(storage: Storage, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        storage.read("results/x.json")
    storage.drop("results/x.json")  # nothing to do
    assert list(storage.ages("results")) == []
    storage.write("results/x.json", b"one")
    storage.write("results/x.json", b"two")
    (tmp_path / "file").write_bytes(b"three")
    storage.take("blobs/ab/abc", tmp_path / "file")
    assert (storage.read("results/x.json"), storage.read("blobs/ab/abc")) == (b"two", b"three")
    assert storage.holds("blobs/ab/abc")
    assert not storage.holds("blobs/ab/abcd")
    ((name, age),) = storage.ages("blobs")
    assert name == "blobs/ab/abc"
    assert -5 < age < 3600
    storage.drop("blobs/ab/abc")
    assert not storage.holds("blobs/ab/abc")
    assert [name for name, _ in storage.ages("results")] == ["results/x.json"]


def test_blobs_and_results(storage: Storage, tmp_path: Path) -> None:
    blobs, results = Blobs(storage, tmp_path), Results(storage, tmp_path)
    for content in (b"0.25,1,2\n" * 10_000, bytes(range(256))):  # packed, and not worth it
        with blobs.incoming(1 << 20) as incoming:
            incoming.write(content)
            sha256 = incoming.finish()
            incoming.pack()
            blobs.keep(incoming, sha256)
            blobs.keep(incoming, sha256)
        assert blobs.read(sha256) == content
        with blobs.open(sha256) as file:
            assert b"".join(iter(lambda: file.read(1000), b"")) == content
        blobs.drop(sha256)
        for look in (blobs.read, blobs.open):
            with pytest.raises(FileNotFoundError):
                look(sha256)
    results.write("a" * 32, {"x": 1})
    results.write_report("a" * 32, "png", b"picture")
    assert results.read("a" * 32) == {"x": 1}
    assert results.report("a" * 32, "png") == b"picture"
    assert results.report("a" * 32, "pdf") is None
    results.write_report("a" * 32, "exr", b"picture")
    results.drop("a" * 32)
    assert results.report("a" * 32, "png") is None
    assert results.report("a" * 32, "exr") is None
    with pytest.raises(SpecError) as caught:
        results.read("a" * 32)
    assert caught.value.code == "result-missing"


def test_what_breaks_on_the_way_never_appears(tmp_path: Path) -> None:
    storage = open_storage(f"file://{tmp_path}/kept")
    with pytest.raises(IsADirectoryError):
        storage.take("blobs/ab/abc", tmp_path)
    assert not storage.holds("blobs/ab/abc")


@pytest.mark.parametrize("url", ["nonsense://x", "s3://bucket/x"])
def test_storage_that_is_not_there(url: str) -> None:
    with pytest.raises(SpecError) as caught:
        open_storage(url)
    assert caught.value.parameter == "storage"


def test_the_service_on_other_storage(serving: object, table_bytes: bytes, tmp_path: Path) -> None:
    assert callable(serving)
    client = serving(storage=f"file://{tmp_path}/elsewhere", workers=0)
    table = client.post("/v1/tables", content=table_bytes).json()["id"]
    assert client.get(f"/v1/tables/{table}/slices?theta_i_deg=20&n=2").status_code == 200
    assert len(list((tmp_path / "elsewhere").rglob("*.zst"))) == 1
    assert client.delete(f"/v1/tables/{table}").status_code == 204
    assert not list((tmp_path / "elsewhere").rglob("*.zst"))
