"""A real server process: killed in the middle of its work, it goes on; asked to stop, it stops."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

ROOT = Path(__file__).resolve().parents[2]
RUN = """
import json, sys
from pathlib import Path
from api.serve import serve
from api.settings import Settings
settings = Settings(folder=Path(sys.argv[2]), **json.loads(sys.argv[3]))
serve(settings, port=int(sys.argv[1]), log_level="warning")
"""


class Server:
    """``serve`` in a process of its own."""

    def __init__(self, folder: Path, **settings: Any) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        said = json.dumps({"workers": 1, **settings})
        command = [sys.executable, "-c", RUN, str(port), str(folder), said]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        self.log = (folder.parent / "log").open("ab+")
        self.process = subprocess.Popen(command, env=environment, stderr=self.log, cwd=folder.parent)
        self.client = httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60)

    def ready(self) -> None:
        end = time.monotonic() + 120
        while True:
            try:
                assert self.client.get("/readyz").status_code == 200
            except httpx.TransportError:
                assert self.process.poll() is None, "the server ended"
                assert time.monotonic() < end
                time.sleep(0.1)
            else:
                return

    def end(self, how: int) -> int:
        self.process.send_signal(how)
        return self.process.wait(60)

    def close(self) -> None:
        self.client.close()
        if self.process.poll() is None:
            self.end(signal.SIGKILL)
        self.log.close()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[[], Server]]:
    servers: list[Server] = []

    def one() -> Server:
        servers.append(Server(tmp_path / "data"))
        return servers[-1]

    yield one
    for server in servers:
        server.close()


@pytest.mark.long
def test_jobs_survive_kill(
    start: Callable[[], Server], table_bytes: bytes, wait: Any, tmp_path: Path
) -> None:
    first = start()
    first.ready()
    table = first.client.post("/v1/tables", content=table_bytes).json()["id"]
    wanted = {"table": table, "model": "oren_nayar"}
    jobs = [first.client.post("/v1/fits", json=wanted).headers["location"] for _ in range(3)]
    end = time.monotonic() + 60
    while first.client.get(jobs[0]).json()["state"] == "queued":
        assert time.monotonic() < end
    # One worker: the first job runs (it compiles for a second at least), the others wait.
    first.end(signal.SIGKILL)

    second = start()
    second.ready()
    found = [wait(second.client, job) for job in jobs]
    assert [job["state"] for job in found] == ["done"] * 3, found
    assert found[0]["attempt"] == 2
    fits = second.client.get("/v1/fits").json()
    assert fits["total"] == 3
    for job in found:
        document = second.client.get(job["results"][0]["links"]["self"]).json()
        assert document["status"] == "converged"
    assert second.end(signal.SIGTERM) in (0, -signal.SIGTERM)
    assert b"Traceback" not in (tmp_path / "log").read_bytes()


@pytest.mark.long
def test_a_posterior_goes_on_where_the_server_was_killed(
    start: Callable[[], Server], table_bytes: bytes, wait: Any, tmp_path: Path
) -> None:
    first = start()
    first.ready()
    table = first.client.post("/v1/tables", content=table_bytes).json()["id"]
    job = wait(first.client, first.client.post(
        "/v1/fits", json={"table": table, "model": "oren_nayar"}
    ).headers["location"])  # fmt: skip
    # It ends by its effective samples, many segments on: a slow machine spends any budget before it begins.
    wanted = {"fit": job["results"][0]["id"], "ess": 4_000, "walkers": 8, "budget_seconds": 600}
    here = first.client.post("/v1/posteriors", json=wanted).headers["location"]
    kept = tmp_path / "data" / "checkpoints"
    end = time.monotonic() + 120
    while len(list(kept.glob("*/segment-*.npz"))) < 2:
        assert time.monotonic() < end, first.client.get(here).json()
        time.sleep(0.005)
    first.end(signal.SIGKILL)

    second = start()
    second.ready()
    done = wait(second.client, here)
    assert (done["state"], done["attempt"]) == ("done", 2), done
    document = second.client.get(done["results"][0]["links"]["self"]).json()
    assert document["cost"]["resumed_at_step"] >= 100
    assert document["cost"]["phases"]["before"] > 0
    # The result is there a moment before the checkpoint is not.
    end = time.monotonic() + 60
    while list(kept.iterdir()):
        assert time.monotonic() < end
        time.sleep(0.01)


def test_upload_is_cut_on_the_wire_and_a_dropped_one_leaves_nothing(
    start: Callable[[], Server], tmp_path: Path
) -> None:
    server = start()
    server.ready()
    host, port = "127.0.0.1", server.client.base_url.port
    assert port is not None
    head = f"POST /v1/tables HTTP/1.1\r\nHost: {host}\r\nContent-Length: %d\r\n\r\n"
    with socket.create_connection((host, port)) as wire:
        wire.sendall((head % (300 << 20)).encode() + b"x" * 1000)
        assert b" 413 " in wire.recv(4096)
    with socket.create_connection((host, port)) as wire:
        wire.sendall((head % 3_000_000).encode() + b"x" * 2_000_000)
    incoming = tmp_path / "data" / "incoming"
    end = time.monotonic() + 20
    while any(incoming.iterdir()):
        assert time.monotonic() < end
        time.sleep(0.05)
    assert server.client.get("/healthz").status_code == 200


def test_what_is_no_http_gets_a_problem(start: Callable[[], Server]) -> None:
    server = start()
    server.ready()
    port = server.client.base_url.port
    assert port is not None
    for sent in (
        b"\x16\x03\x01\x02\x00 a TLS greeting\r\n\r\n",
        b"GET\r\n\r\n",
        b"POST / HTTP/1.1\r\nContent-Length: x\r\n\r\n",
    ):
        with socket.create_connection(("127.0.0.1", port), timeout=30) as wire:
            wire.sendall(sent)
            came = b"".join(iter(lambda: wire.recv(4096), b""))
        head, _, body = came.partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 400 "), (sent, came)
        assert b"application/problem+json" in head
        assert json.loads(body)["code"] == "bad-http"
    assert server.client.get("/healthz").status_code == 200


@pytest.mark.long
def test_second_server_is_refused_and_an_open_event_stream_does_not_hold_up_the_stop(
    start: Callable[[], Server], table_bytes: bytes, tmp_path: Path
) -> None:
    server = start()
    server.ready()
    assert start().process.wait(60) != 0
    assert b"another server works on this data folder" in (tmp_path / "log").read_bytes()
    table = server.client.post("/v1/tables", content=table_bytes).json()["id"]
    wanted = {"table": table, "models": ["lafortune:3"] * 16, "starts": 1000}
    here = server.client.post("/v1/fits", json=wanted).headers["location"]
    with server.client.stream("GET", f"{here}/events") as stream:
        assert "event: progress" in next(stream.iter_lines())
        begun = time.monotonic()
        server.process.send_signal(signal.SIGTERM)
        server.process.wait(60)
    assert time.monotonic() - begun < 25
