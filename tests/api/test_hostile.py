"""Hostile uploads: each is refused with a problem, in bounded memory and time, and the service goes on."""

from __future__ import annotations

import gzip
import io
import re
import socket
import struct
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import psutil
import pytest

from api import parsing
from api.parsing import Limits
from tests.formats.samples import SAMPLES

from . import bad_readers
from .conftest import small_table
from .test_uploads import files


@pytest.fixture(scope="module")
def strict(serving_once: Callable[..., Any]) -> Any:
    """A service with tight limits; what a table of this size needs is far below them."""
    return serving_once(
        max_parse_bytes=300 << 20, max_parse_seconds=3.0, max_samples=5000, max_channels=8,
        max_upload_bytes=64 << 20,
    )  # fmt: skip


def zipped(*entries: tuple[zipfile.ZipInfo | str, bytes]) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries:
            archive.writestr(name, content)
    return packed.getvalue()


def link(name: str, target: bytes) -> tuple[zipfile.ZipInfo, bytes]:
    info = zipfile.ZipInfo(name)
    info.create_system, info.external_attr = 3, 0o120777 << 16
    return info, target


def lying_zip() -> bytes:
    """An archive whose directory says 100 bytes where 60 MB come out."""
    content = zipped(("a.csv", b"1,2,3\n" * 10_000_000))
    at = content.rindex(b"PK\x01\x02")
    return content[: at + 24] + struct.pack("<I", 100) + content[at + 28 :]


def merl() -> bytes:
    """35 MB that become a table of 1.5 million samples."""
    return struct.pack("<3i", 90, 90, 180) + np.full(3 * 90 * 90 * 180, 0.5).tobytes()


COLUMNS = b",".join(b"brdf_%d" % k for k in range(1_000_000))
WIDE = b"# quantity: brdf\n" + COLUMNS + b"\n" + b"1," * 999_999 + b"1\n"
HOSTILE: dict[str, Callable[[], bytes]] = {
    "gzip bomb": lambda: gzip.compress(bytes(50_000_000)),
    "zip bomb": lambda: zipped(("a.csv", b"1,2,3\n" * 10_000_000)),
    "many bombs": lambda: zipped(*((f"{k}.csv", b"1,2,3\n" * 2_000_000) for k in range(20))),
    "zip that lies": lying_zip,
    "zip in zips": lambda: zipped(("a.zip", zipped(("b.zip", zipped(("c.csv", small_table())))))),
    "a million columns": lambda: WIDE,
    "links": lambda: zipped(link("a.csv", b"/etc/passwd"), link("../../b.csv", b"../../../etc/shadow")),
    "too many samples": merl,
    "too many channels": lambda: (
        b"# quantity: brdf\ntheta_i_deg,theta_o_deg,dphi_deg," + b",".join(b"brdf_%d" % k for k in range(9))
        + b"\n" + b"1,2,3" + b",0.5" * 9 + b"\n"
    ),
    "a line without end": lambda: b"theta_i_deg," * 4_000_000,
    "nested markup": lambda: b"<?xml version='1.0'?><!DOCTYPE a [<!ENTITY a 'aaaa'>"
    + b"".join(b"<!ENTITY a%d '%s'>" % (k, b"&a%d;" % (k - 1) * 10) for k in range(1, 9)) + b"]><a>&a8;</a>",
}  # fmt: skip


@pytest.mark.parametrize("kind", HOSTILE)
def test_is_refused_and_leaves_nothing(strict: Any, kind: str) -> None:
    folder = strict.app.state.service.settings.folder
    before, memory = files(folder), psutil.Process().memory_info().rss
    body = HOSTILE[kind]()
    answer = strict.post("/v1/tables", content=body)
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["remedy"]
    assert files(folder) == before
    # The limits are of the reader; these are only far from what a bomb would take.
    assert psutil.Process().memory_info().rss - memory < 400 << 20
    codes = {"too many samples": "too-many-samples", "too many channels": "too-many-channels"}
    assert answer.json()["code"] == codes.get(kind, answer.json()["code"])


def test_names_in_archives_are_only_names(strict: Any, tmp_path: Path) -> None:
    table = small_table()
    for name in ("../../../tmp/x.csv", "/etc/x.csv", "C:\\x.csv", "a\r\nSet-Cookie: x=1.csv", "a\x00b.csv"):
        answer = strict.post("/v1/tables", content=zipped((name, table)))
        assert answer.status_code in (201, 422)
        assert "set-cookie" not in answer.headers
    form = {"file": ("a\r\nSet-Cookie: x=1\r\n\r\nb.csv", table)}
    answer = strict.post("/v1/tables", files=form)
    assert answer.status_code == 201
    assert answer.json()["name"].isprintable()
    assert "set-cookie" not in answer.headers


def test_names_do_not_break_out_of_headers(strict: Any) -> None:
    for name in ('a"; filename="b.exe', "a\\b/c", "\u202eexe.\u00e9", "..", "a;b,c"):
        table = strict.post("/v1/tables", content=small_table(), params={"name": name}).json()["id"]
        answer = strict.get(f"/v1/tables/{table}/export/openexr")
        assert answer.status_code == 200
        said = answer.headers["content-disposition"]
        assert re.fullmatch(r'attachment; filename="[A-Za-z0-9_-][A-Za-z0-9_.-]*\.exr"', said), said
    links = strict.get("/v1/jobs?x=%0d%0aSet-Cookie:%20a%3e;%20rel%3d%22&limit=1").headers
    assert "set-cookie" not in links
    assert links["link"].count("rel=") == links["link"].count(">;")


def test_a_reader_that_needs_too_much_memory_is_stopped(tmp_path: Path) -> None:
    path = tmp_path / "merl.binary"
    path.write_bytes(merl())
    enough = parsing.Parsers(1, Limits(2 << 30, 60, 10**7, 10))
    assert enough.parse(path, {}, "0" * 64).description["format"] == "merl"
    with pytest.raises(parsing.Problem) as stopped:
        parsing.Parsers(1, Limits(32 << 20, 60, 10**7, 10)).parse(path, {}, "0" * 64)
    assert stopped.value.code == "reading-takes-too-much"


def test_a_small_parquet_file_needs_little_memory(tmp_path: Path) -> None:
    path = tmp_path / "small.parquet"
    path.write_bytes(next(one.data for one in SAMPLES if one.name == "parquet"))
    parsers = parsing.Parsers(1, Limits(256 << 20, 60, 10**6, 10))
    assert parsers.parse(path, {}, "0" * 64).description["format"] == "parquet"


def test_a_reader_that_crashes_or_hangs_is_the_file_s_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(small_table())
    limits = Limits(1 << 30, 2, 10**6, 10)
    # Of other tests' servers some may have ended unnoticed.
    before = set(psutil.Process().children(recursive=True))
    for what, code in ((bad_readers.crashes, "reading-fails"), (bad_readers.hangs, "reading-takes-too-long")):
        with monkeypatch.context() as patched:
            patched.setattr(parsing, "_read", what)
            with closing(parsing.Parsers(1, limits)) as parsers, pytest.raises(parsing.Problem) as ended:
                parsers.parse(path, {}, "0" * 64)
        assert (ended.value.status_code, ended.value.code) == (422, code)
    with monkeypatch.context() as patched:
        patched.setattr(parsing, "_read", bad_readers.fails)
        with closing(parsing.Parsers(1, limits)) as parsers, pytest.raises(RuntimeError):
            parsers.parse(path, {}, "0" * 64)
    with closing(parsing.Parsers(1, limits)) as parsers:
        assert parsers.parse(path, {}, "0" * 64).name
    left = set(psutil.Process().children(recursive=True)) - before
    assert not [process for process in left if process.status() == psutil.STATUS_ZOMBIE]


def test_each_upload_has_a_reader_of_its_own_and_the_next_one_waits(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(small_table())

    def waiting() -> psutil.Process | None:
        """The process that waits, once there is one."""
        for _ in range(600):
            with parsers._lock:
                if parsers._next is not None:
                    return psutil.Process(parsers._next.process.pid)
            time.sleep(0.05)
        return None

    with closing(parsing.Parsers(1, Limits(1 << 30, 60, 10**6, 10))) as parsers:
        seen: list[psutil.Process] = []
        for _ in range(3):
            assert parsers.parse(path, {}, "0" * 64).name
            found = waiting()
            assert found is not None
            assert found not in seen
            assert not [one for one in seen if one.is_running() and one.status() != psutil.STATUS_ZOMBIE]
            seen.append(found)
        # Somebody else ends it: no fault of the next upload's.
        seen[-1].kill()
        seen[-1].wait(10)
        assert parsers.parse(path, {}, "0" * 64).name
        last = waiting()
    assert last is not None
    assert not last.is_running() or last.status() == psutil.STATUS_ZOMBIE


def _sent(address: str, head: str, body: bytes) -> Iterator[int]:
    """The statuses that come back for these bytes."""
    where = urlsplit(address)
    with socket.create_connection((where.hostname, where.port or 80), timeout=30) as wire:
        start = f"POST /v1/tables HTTP/1.1\r\nHost: x\r\nConnection: close\r\n{head}\r\n\r\n"
        wire.sendall(start.encode() + body)
        wire.shutdown(socket.SHUT_WR)
        came = b""
        while chunk := wire.recv(65536):
            came += chunk
    for line in came.split(b"\r\n"):
        if line.startswith(b"HTTP/1.1 "):
            yield int(line.split()[1])


def test_wrong_lengths_on_the_wire(address: str, client: Any) -> None:
    table = small_table()
    folder = client.app.state.service.settings.folder
    for head, body in (
        (f"Content-Length: {len(table) + 1000}", table),  # ends too early
        (f"Content-Length: {len(table) - 1000}", table),  # goes on as a request that is none
        ("Content-Length: -1", table), ("Content-Length: x", table),
        ("Content-Length: 5\r\nContent-Length: 6", table),
        ("Transfer-Encoding: chunked", b"zz\r\nabc"), ("Transfer-Encoding: chunked", b"ffffffffffff\r\nabc"),
        ("Content-Length: 99999999999999999999", b""),
    ):  # fmt: skip
        statuses = list(_sent(address, head, body))
        assert all(200 <= status < 500 for status in statuses), (head, statuses)
    assert client.get("/healthz").status_code == 200
    end = time.monotonic() + 20
    while any((folder / "incoming").iterdir()):
        assert time.monotonic() < end
        time.sleep(0.02)
