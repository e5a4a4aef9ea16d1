"""The bytes of a table come back as they were sent: in pieces, whole or a range of them."""

from __future__ import annotations

import asyncio
import hashlib
import io
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import numpy as np
import psutil
import pytest
import zstandard

from api.blobs import Blobs
from api.client import Client
from api.contents import _pieces, asked_range
from api.problems import Problem
from api.receiving import copy
from api.storage import Folder
from fitter.errors import FitterError

from .conftest import listening, small_table
from .test_server import Server


def merl(packs: bool) -> bytes:
    """A small MERL file, of one value or of noise."""
    dims = (6, 10, 18)
    count = 3 * int(np.prod(dims))
    values = np.full(count, 0.5) if packs else np.random.default_rng(0).lognormal(-1, 1, count)
    return struct.pack("<3i", *dims) + values.tobytes()


@pytest.fixture(scope="module", params=[None, "file://{}/elsewhere"])
def asked(request: pytest.FixtureRequest, serving_once: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A service with a folder, and one with an fsspec URL."""
    storage = request.param and request.param.format(tmp_path_factory.mktemp("storage"))
    return serving_once(storage=storage, workers=0)


@pytest.mark.parametrize("packs", [True, False])
def test_whole_and_in_ranges(asked: Any, packs: bool) -> None:
    body = merl(packs)
    table = asked.post("/v1/tables", content=body).json()
    here = f"/v1/tables/{table['id']}/content"
    whole = asked.get(here)
    tag = f'"{hashlib.sha256(body).hexdigest()}"'
    assert (whole.status_code, whole.content, whole.headers["etag"]) == (200, body, tag)
    assert whole.headers["content-length"] == str(len(body))
    assert whole.headers["accept-ranges"] == "bytes"
    held = asked.get(here, headers={"if-none-match": f'"other", {tag}'})
    assert (held.status_code, held.content, held.headers["etag"]) == (304, b"", tag)
    last = len(body) - 1
    for wanted, start, stop in (
        ("bytes=0-9", 0, 10), ("bytes=10-", 10, len(body)), ("bytes=-7", last - 6, len(body)),
        (f"bytes={last}-{last + 9}", last, len(body)), (f"bytes=-{10 * last}", 0, len(body)),
    ):  # fmt: skip
        part = asked.get(here, headers={"range": wanted})
        assert (part.status_code, part.content) == (206, body[start:stop]), wanted
        assert part.headers["content-range"] == f"bytes {start}-{stop - 1}/{len(body)}"
        assert asked.get(here, headers={"range": wanted, "if-range": tag}).status_code == 206
        assert asked.get(here, headers={"range": wanted, "if-range": '"other"'}).content == body
    for wanted in (
        "bytes=0-1,5-6",
        "lines=0-1",
        "bytes=-",
        "bytes=9-2",
        "bytes=a-b",
        "bytes=" + "9" * 30 + "-",
    ):
        assert asked.get(here, headers={"range": wanted}).content == body, wanted
    for wanted in (f"bytes={last + 1}-", "bytes=-0"):
        beyond = asked.get(here, headers={"range": wanted})
        assert (beyond.status_code, beyond.json()["code"]) == (416, "range-beyond-end")
        assert beyond.headers["content-range"] == f"bytes */{len(body)}"
        assert beyond.headers["content-type"] == "application/problem+json"
    assert asked.get("/v1/tables/none/content").status_code == 404


def test_ranges_of_nothing() -> None:
    with pytest.raises(Problem):
        asked_range("bytes=0-", 0)
    assert asked_range("", 0) is None


def test_a_lost_stream_is_taken_up_where_it_broke_off(client: Any) -> None:
    body = small_table()
    id = client.post("/v1/tables", content=body).json()["id"]

    class Breaks(httpx.BaseTransport):
        """Half of what is asked for comes, then the connection is gone; and once the database is away."""

        asked: list[str] = []  # noqa: RUF012

        def handle_request(self, request: httpx.Request) -> httpx.Response:
            wanted = request.headers["range"]
            self.asked.append(wanted)
            if len(self.asked) == 2:
                return httpx.Response(503)
            came = client.get(request.url.path, headers={"range": wanted})

            def pieces() -> Iterator[bytes]:
                if len(self.asked) > 2:
                    yield came.content
                    return
                yield came.content[: len(came.content) // 2]
                raise httpx.ReadError("gone")

            part = {"content-range": came.headers["content-range"]}
            return httpx.Response(came.status_code, content=pieces(), headers=part)

    with httpx.Client(transport=Breaks(), base_url="http://x") as http:
        assert b"".join(Client(http=http).content(id)) == body
    half = f"bytes={len(body) // 2}-"
    assert Breaks.asked == ["bytes=0-", half, half]


@pytest.mark.parametrize(
    ("second", "whole"),
    [
        (httpx.Response(200, content=b"everything once more"), False),
        (httpx.Response(206, content=b"x", headers={"content-range": "bytes 0-0/10"}), False),
        (httpx.Response(416, headers={"content-range": "bytes */10"}), True),
    ],
    ids=["no ranges", "another range", "nothing was left"],
)
def test_a_stream_is_not_joined_to_what_does_not_belong_to_it(second: httpx.Response, whole: bool) -> None:
    asked: list[httpx.Request] = []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(request)

        def pieces() -> Iterator[bytes]:
            yield b"0123456789"
            raise httpx.ReadError("gone")

        return httpx.Response(206, content=pieces()) if len(asked) == 1 else second

    with httpx.Client(transport=httpx.MockTransport(answer), base_url="http://x") as http:
        content = Client(http=http).content("id")
        if whole:
            assert b"".join(content) == b"0123456789"
        else:
            with pytest.raises(FitterError):
                list(content)
    assert asked[1].headers["range"] == "bytes=10-"
    assert {request.headers["accept-encoding"] for request in asked} == {"identity"}


def test_a_damaged_file_is_no_shorter_table(tmp_path: Path) -> None:
    """A packed file that ends too early unpacks without an error: its hash tells."""
    blobs = Blobs(Folder(tmp_path / "blobs"), tmp_path)
    with blobs.incoming(1 << 20) as incoming:
        incoming.write(b"theta_i,theta_o,phi,value\n" * 2000)
        sha256 = incoming.finish()
        incoming.pack()
        blobs.keep(incoming, sha256)
    (packed,) = (tmp_path / "blobs").rglob("*.zst")
    packed.write_bytes(packed.read_bytes()[: packed.stat().st_size // 2])
    with blobs.incoming(1 << 20) as again, pytest.raises((OSError, zstandard.ZstdError)):
        copy(blobs, sha256, again)


def test_a_range_of_a_plain_file_reads_no_more(tmp_path: Path) -> None:
    class Counted(io.BytesIO):
        came = 0

        def read(self, size: int | None = -1, /) -> bytes:
            found = super().read(size)
            Counted.came += len(found)
            return found

    async def last() -> bytes:
        return b"".join([piece async for piece in _pieces(Counted(bytes(1 << 20)), (1 << 20) - 3, 1 << 20)])

    assert (asyncio.run(last()), Counted.came) == (bytes(3), 3)


def test_bytes_that_are_gone_are_not_found(serving: Any) -> None:
    service = serving(workers=0)
    id = service.post("/v1/tables", content=small_table()).json()["id"]
    for path in (service.app.state.service.settings.folder / "blobs").rglob("*"):
        if path.is_file():
            path.unlink()
    assert service.get(f"/v1/tables/{id}/content").status_code == 404


def test_a_client_that_goes_leaves_no_file_open(client: Any) -> None:
    body = struct.pack("<3i", 100, 100, 100) + np.random.default_rng(1).lognormal(-1, 1, 3 * 100**3).tobytes()
    here = f"/v1/tables/{client.post('/v1/tables', content=body).json()['id']}/content"
    blobs = client.app.state.service.settings.folder / "blobs"

    def opened() -> list[str]:
        return [one.path for one in psutil.Process().open_files() if one.path.startswith(str(blobs))]

    with listening(client.app) as url:
        where = urlsplit(url)
        assert where.port is not None
        with socket.socket() as wire:
            wire.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)  # so that the server has to wait
            wire.connect((where.hostname, where.port))
            wire.sendall(f"GET {here} HTTP/1.1\r\nHost: x\r\n\r\n".encode())
            assert wire.recv(12) == b"HTTP/1.1 200"
            assert opened()
        for _ in range(200):
            if not opened():
                break
            httpx.get(f"{url}/healthz")
    assert not opened()


@pytest.mark.long
@pytest.mark.parametrize("packs", [True, False])
def test_memory_is_bounded(tmp_path: Path, packs: bool) -> None:
    """A server of its own gives 70 MB away, and grows by a tenth of that at most."""
    dims = (90, 180, 180)
    count = 3 * int(np.prod(dims))
    values = np.full(count, 0.5) if packs else np.random.default_rng(0).lognormal(-1, 1, count)
    body = struct.pack("<3i", *dims) + values.tobytes()
    server = Server(tmp_path / "data", workers=0)
    try:
        server.ready()
        id = server.client.post("/v1/tables", content=body).json()["id"]
        kept = [path.stat().st_size for path in (tmp_path / "data" / "blobs").rglob("*") if path.is_file()]
        assert (kept[0] < len(body) / 100) == packs
        process, digest = psutil.Process(server.process.pid), hashlib.sha256()
        before = most = process.memory_info().rss
        with server.client.stream("GET", f"/v1/tables/{id}/content") as answer:
            for piece in answer.iter_raw(1 << 20):
                digest.update(piece)
                most = max(most, process.memory_info().rss)
        assert digest.digest() == hashlib.sha256(body).digest()
        assert most - before < len(body) / 10
    finally:
        server.close()
