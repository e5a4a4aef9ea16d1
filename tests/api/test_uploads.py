"""Uploads: what becomes a table, what is refused, and that nothing half-written stays."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from api.blobs import Blobs
from api.storage import open_storage

from .conftest import small_table


def files(folder: Path) -> list[str]:
    """Names of all blobs and uploads on their way."""
    return sorted(p.name for room in ("blobs", "incoming") for p in (folder / room).rglob("*") if p.is_file())


def test_raw_upload(client: Any, table_bytes: bytes) -> None:
    answer = client.post("/v1/tables?name=paint", content=table_bytes)
    assert answer.status_code == 201
    found = answer.json()
    assert answer.headers["location"] == f"/v1/tables/{found['id']}"
    assert found["name"] == "paint"
    assert found["sha256"] == hashlib.sha256(table_bytes).hexdigest()
    assert found["bytes"] == len(table_bytes)
    assert found["description"]["format"] == "delimited"
    assert client.get(answer.headers["location"]).json() == found


def test_form_upload(client: Any, table_bytes: bytes) -> None:
    answer = client.post("/v1/tables", files={"file": ("../../a\\b/paint.csv", table_bytes)})
    assert answer.status_code == 201
    assert answer.json()["name"] == "paint.csv"
    named = client.post("/v1/tables?name=mine", files={"file": ("paint.csv", table_bytes)})
    assert named.json()["name"] == "mine"


@pytest.mark.parametrize(
    "form",
    [
        {"files": {"other": b"x"}}, {"files": {"file": b"x"}, "data": {"a": "b"}},
        {"files": {"a": b"", "file": b""}},
    ],
)  # fmt: skip
def test_wrong_form_is_refused(client: Any, form: dict[str, Any]) -> None:
    answer = client.post("/v1/tables", **form)
    assert answer.status_code in (400, 422)
    assert answer.headers["content-type"] == "application/problem+json"


def test_truncated_form_is_refused(client: Any) -> None:
    framed = {"content-type": "multipart/form-data; boundary=b"}
    body = b'--b\r\nContent-Disposition: form-data; name="file"; filename="a"\r\n\r\n1,2'
    for broken in (body, b"--b--\r\n", b"no form", b"--b\r\n" + b"a" * 20_000, body + b"\r\n--b"):
        answer = client.post("/v1/tables", content=broken, headers=framed)
        assert answer.status_code in (400, 422)
        assert answer.json()["code"] == "bad-form"
    no_boundary = client.post("/v1/tables", content=b"x", headers={"content-type": "multipart/form-data"})
    assert no_boundary.status_code == 400


def test_reading_options(client: Any) -> None:
    rows = small_table().replace(b"# quantity: brdf\n", b"").replace(b"brdf_", b"v")
    plain = client.post("/v1/tables", content=rows)
    assert plain.status_code == 422
    columns = '{"3": "brdf_R", "4": "brdf_G", "5": "brdf_B"}'
    told = client.post("/v1/tables", content=rows, params={"quantity": "ccbrdf", "columns": columns})
    assert told.status_code == 201, told.text
    assert told.json()["description"]["quantity"] == "ccbrdf"
    assert told.json()["options"]["quantity"] == "ccbrdf"


@pytest.mark.parametrize(
    ("params", "parameter"),
    [
        ({"quantity": "radiance"}, "quantity"),
        ({"convention": "sideways"}, "convention"),
        ({"negatives": "clamp"}, "negatives"),
        ({"columns": "{"}, "columns"),
        ({"columns": "[[[1]]]"}, "columns"),
        ({"columns": "7"}, "columns"),
        ({"colums": "{}"}, "colums"),
        ({"name": "a\nb"}, "name"),
    ],
)  # fmt: skip
def test_bad_options_name_the_parameter(
    client: Any, table_bytes: bytes, params: dict[str, str], parameter: str
) -> None:
    answer = client.post("/v1/tables", content=table_bytes, params=params)
    assert answer.status_code == 422
    assert answer.json()["parameter"] == parameter


@pytest.mark.parametrize(
    "body",
    [
        b"", b"\n\n", b"\x00\x01\x02" * 50, b"<!doctype html><html><body></body></html>", b"PK\x03\x04junk",
        b"\xff" * 1000, b"\x1f\x8b\x08", b"{}", small_table()[:60], b"\x7f\xff\xff\x7f" * 3 + b"\0" * 24,
        "theta_i_deg,theta_o_deg,dphi_deg,brdf\n1,2,3,\ud800".encode("utf-8", "surrogatepass"),
    ],
)  # fmt: skip
def test_junk_is_a_problem_and_leaves_nothing(
    serving: Callable[..., Any], tmp_path: Path, body: bytes
) -> None:
    answer = serving().post("/v1/tables", content=body)
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    found = answer.json()
    assert found["type"] == f"/problems/{found['code']}"
    assert found["status"] == 422
    assert found["file"]
    assert files(tmp_path / "data") == []


def test_bad_row_is_named(client: Any) -> None:
    answer = client.post("/v1/tables?name=paint", content=small_table(tail="10,20,thirty,1,1,1\n"))
    assert answer.status_code == 422
    found = answer.json()
    assert found["file"] == "paint"
    assert found["row"] == len(small_table().splitlines()) + 1
    assert found["column"]


def test_archive_with_several_tables_asks_which(client: Any, table_bytes: bytes) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("a.csv", table_bytes)
        archive.writestr("b.csv", small_table(1))
    assert client.post("/v1/tables", content=packed.getvalue()).json()["parameter"] == "item"
    assert client.post("/v1/tables?item=1", content=packed.getvalue()).status_code == 201


def test_same_bytes_are_one_blob_until_the_last_row_goes(serving: Callable[..., Any], tmp_path: Path) -> None:
    client, body = serving(), small_table()
    first, second = (client.post("/v1/tables", content=body).json()["id"] for _ in range(2))
    sha256 = hashlib.sha256(body).hexdigest()
    assert first != second
    assert files(tmp_path / "data") == [sha256 + ".zst"]
    assert client.delete(f"/v1/tables/{first}").status_code == 204
    assert files(tmp_path / "data") == [sha256 + ".zst"]
    assert client.delete(f"/v1/tables/{second}").status_code == 204
    assert files(tmp_path / "data") == []
    assert client.delete(f"/v1/tables/{second}").status_code == 404


@pytest.mark.parametrize(
    "content",
    [b"0.25,0.5\n" * 1000, np.random.default_rng(0).bytes(5000), b"", b"x", b"0.25,0.5\n" * 200_000,
     np.random.default_rng(0).bytes(2 << 20)],
)  # fmt: skip
@pytest.mark.parametrize("before", [False, True])
def test_bytes_come_back_as_they_came(tmp_path: Path, content: bytes, before: bool) -> None:
    blobs = Blobs(open_storage(tmp_path), tmp_path)
    sha256 = hashlib.sha256(content).hexdigest()
    if before:  # one that is not packed, as earlier versions left them
        (tmp_path / "blobs" / sha256[:2]).mkdir(parents=True)
        (tmp_path / "blobs" / sha256[:2] / sha256).write_bytes(content)
    with blobs.incoming(1 << 22) as incoming:
        incoming.write(content)
        assert incoming.finish() == sha256
        incoming.pack()
        blobs.keep(incoming, sha256)
    assert blobs.read(sha256) == content
    kept = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert len(kept) == 1
    smaller = content.startswith(b"0.25") and not before
    assert (kept[0].stat().st_size < 0.1 * len(content)) == smaller
    assert (kept[0].suffix == ".zst") == smaller
    blobs.drop(sha256)
    assert files(tmp_path) == []


def test_large_upload_is_cut(serving: Callable[..., Any], tmp_path: Path) -> None:
    client = serving(max_upload_bytes=100_000)
    sent = 0

    def endless() -> Iterator[bytes]:
        nonlocal sent
        while sent < 1 << 20:
            sent += 1 << 16
            yield b"x" * (1 << 16)

    declared = client.post("/v1/tables", content=b"x" * 300_000)
    form = client.post("/v1/tables", files={"file": b"x" * 130_000})
    for answer in (declared, form, client.post("/v1/tables", content=b"x" * 100_001)):
        assert answer.status_code == 413
        assert answer.json()["code"] == "too-large"
    assert client.post("/v1/tables", content=endless()).status_code == 413
    assert files(tmp_path / "data") == []


def test_what_a_dead_process_left_is_cleared(serving: Callable[..., Any], tmp_path: Path) -> None:
    left = tmp_path / "data" / "incoming" / "half"
    left.parent.mkdir(parents=True)
    left.write_bytes(b"half an upload")
    serving()
    assert not left.exists()


def test_folder_has_one_server(serving: Callable[..., Any]) -> None:
    from fitter.errors import SpecError

    serving()
    with pytest.raises(SpecError, match="another server works on this data folder"):
        serving()
