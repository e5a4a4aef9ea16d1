"""The bytes of a table come back as they were sent: in pieces, whole or a range of them."""

from __future__ import annotations

import hashlib
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

from api.client import Client
from api.contents import asked_range
from api.problems import Problem

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

            return httpx.Response(came.status_code, content=pieces())

    with httpx.Client(transport=Breaks(), base_url="http://x") as http:
        assert b"".join(Client(http=http).content(id)) == body
    half = f"bytes={len(body) // 2}-"
    assert Breaks.asked == ["bytes=0-", half, half]


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
