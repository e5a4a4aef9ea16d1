"""The HTTP service over loopback, in a process of its own: evaluation, uploads, 64 clients at once."""

from __future__ import annotations

import hashlib
import io
import os
import random
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

import httpx
import numpy as np
import psutil

import fitter
from api.client import NPY, Client, Refused, ServiceFailed
from fitter import datasets
from tests.bench.machine import ROOT
from tests.bench.measuring import Figure, Row, Size, alternate

SEED = 9
#: Of these at once; each asks for one thing after the other.
CLIENTS, SECONDS = 64, 60.0
#: Bytes that the server may grow by while a table comes or goes, of whatever size.
GROWTH = 64 << 20
#: And while all clients are at work, over what it holds when the first job has loaded what jobs need.
GROWTH_AT_WORK = 512 << 20


@contextmanager
def served(folder: Path) -> Generator[tuple[str, psutil.Process]]:
    """A server's address and process."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    words = [sys.executable, "-m", "fitter", "serve", "--port", str(port), "--folder", str(folder / "data")]
    log = (folder / "log").open("wb")
    process = subprocess.Popen(
        words, env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=log, stderr=log, cwd=folder
    )
    url = f"http://127.0.0.1:{port}"
    try:
        with Client(url) as client:
            for _ in range(100):
                try:
                    client.request("GET", "/readyz")
                    break
                except ServiceFailed:
                    if process.poll() is not None:
                        raise
        yield url, psutil.Process(process.pid)
    finally:
        process.terminate()
        process.wait(60)
        log.close()


def run(size: Size) -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with served(folder) as (url, process), Client(url) as client:
            yield _evaluation(client, size)
            yield from _uploads(client, process, folder, size)
            yield _load(url, process, size)


def _evaluation(client: Client, size: Size) -> Row:
    rng = np.random.default_rng(SEED)
    pairs = rng.normal(size=(2, size.pick(100_000, 1000), 3))
    pairs[..., 2] = np.abs(pairs[..., 2]) + 0.05
    wi, wo = pairs / np.linalg.norm(pairs, axis=-1, keepdims=True)
    values = {"kd": [0.1, 0.2, 0.3], "ks": 0.05, "alpha": 0.2}
    model = fitter.models.create("ward", **values)
    id = client.create_model("ward", **values).id
    sent = io.BytesIO()
    np.save(sent, np.stack([wi, wo]), allow_pickle=False)
    receiving: list[float] = []
    working: list[float] = []

    def served() -> Any:
        headers = {"Content-Type": NPY, "Accept": NPY}
        path = f"/v1/models/{id}/evaluate"
        answer = client.request("POST", path, content=sent.getvalue(), headers=headers)
        spent = _spent(answer)
        receiving.append(spent["receive"])
        working.append(spent["app"])
        return np.load(io.BytesIO(answer.content))

    times = alternate(
        {"served": served, "bare": lambda: np.asarray(model.evaluate(wi, wo))}, size.pick(30, 3)
    )
    assert np.array_equal(times["served"].result, times["bare"].result)
    return Row(
        case=f"evaluate {len(wi):,} pairs of a Ward model over HTTP, binary",
        # The first call compiles.
        ours=Figure.of("the server, once it has the request", "s", working[1:]),
        others=(times["bare"].seconds("floor: the bare library call"),),
        facts={
            "receiving_seconds": median(receiving[1:]), "client_seconds": median(times["served"].wall),
            "bytes_in": len(sent.getvalue()), "bytes_out": times["served"].result.nbytes,
        },
        seed=SEED,
    )  # fmt: skip


def _uploads(client: Client, process: psutil.Process, folder: Path, size: Size) -> Iterator[Row]:
    """A MERL file: what is sent, and what the whole request takes; the server's memory with larger ones."""
    content = _merl(size.pick(90, 10))
    receiving: list[float] = []
    working: list[float] = []

    def served() -> None:
        # Others each time: bytes that the server has are deleted, not kept.
        sent = content[:-8] + struct.pack("<d", 1.0 + len(receiving))
        for name, spent in _spent(client.request("POST", "/v1/tables", content=sent)).items():
            {"receive": receiving, "app": working}[name].append(spent)

    def write() -> None:
        with (folder / "plain").open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())

    times = alternate({"served": served, "write": write}, size.pick(7, 2))
    floor = times["write"].rate("floor: writing it to the disk, B/s", len(content))
    what = f"upload a MERL file of {len(content) / 1e6:.0f} MB"
    rates = [len(content) / spent for spent in receiving[1:]]
    yield Row(
        case=f"{what}: received, hashed, written", ours=Figure.of("the server, B/s", "1/s", rates),
        others=(floor,), facts={"bytes": len(content)}, seed=SEED,
    )  # fmt: skip
    yield Row(
        case=f"{what}: also read, described and packed",
        ours=times["served"].rate("POST /v1/tables, B/s", len(content)), others=(floor,),
        facts={"bytes": len(content), "reading_seconds": median(working[1:])}, seed=SEED,
    )  # fmt: skip
    contents = [_merl(n) for n in size.pick((45, 90, 180), (10,))]
    grown = {len(one): _growths(client, process, one) for one in contents}
    for k, verb in enumerate(("sent", "fetched")):
        most = {sent: both[k] for sent, both in grown.items()}
        assert max(most.values()) < GROWTH, most
        rate = max(most.values()) / max(most)
        yield Row(
            case=f"the server's memory while a table of {max(most) / 1e6:.0f} MB is {verb}, of its size",
            ours=Figure("resident bytes more than before", "ratio", rate, rate, rate, len(most)),
            facts={"grown_bytes_by_size": {str(sent): one for sent, one in most.items()}, "bound": GROWTH},
            seed=SEED,
        )  # fmt: skip


def _growths(client: Client, process: psutil.Process, content: bytes) -> tuple[int, int]:
    """By how many bytes the server grows while a table is sent, and while its bytes are fetched."""
    ids: list[str] = []
    sent = _growth(process, lambda: ids.append(client.upload(content).id))
    fetched = _growth(process, lambda: _fetch(client, ids[0], content))
    client.delete_table(ids[0])
    return sent, fetched


def _fetch(client: Client, id: str, content: bytes) -> None:
    digest = hashlib.sha256()
    for piece in client.content(id):
        digest.update(piece)
    assert digest.digest() == hashlib.sha256(content).digest()


def _merl(n: int) -> bytes:
    dims = (n, 90, 180)
    rng = np.random.default_rng(SEED)
    return struct.pack("<3i", *dims) + rng.lognormal(-1, 1, 3 * n * 90 * 180).tobytes()


def _spent(answer: httpx.Response) -> dict[str, float]:
    """Seconds, as the server tells them: until it had the request, and from then on."""
    told = dict(part.strip().split(";dur=") for part in answer.headers["server-timing"].split(","))
    return {name: 1e-3 * float(milliseconds) for name, milliseconds in told.items()}


def _growth(process: psutil.Process, act: Callable[[], None]) -> int:
    """By how many bytes the server is larger, at most, meanwhile."""
    before = most = process.memory_info().rss
    done = threading.Event()

    def look() -> None:
        nonlocal most
        while not done.wait(0.005):
            most = max(most, process.memory_info().rss)

    looking = threading.Thread(target=look)
    looking.start()
    try:
        act()
    finally:
        done.set()
        looking.join()
    return most - before


def _load(url: str, process: psutil.Process, size: Size) -> Row:
    """Clients that upload, evaluate and fit: what was answered, what was lost, and the server's memory."""
    clients, seconds = size.pick(CLIENTS, 4), size.pick(SECONDS, 2.0)
    answered: Counter[str] = Counter()
    failures: list[str] = []
    jobs: list[str] = []
    lock = threading.Lock()
    content = datasets.sample("diffuse_plaster").read_bytes()
    with Client(url) as client:
        # What the first job loads stays, and is no growth of the load's.
        client.wait(client.start("fits", table=client.upload(content).id, model="oren_nayar"))
    memory = [process.memory_info().rss]
    end = time.monotonic() + seconds

    def one(k: int) -> None:
        rng = random.Random(SEED + k)
        wi, wo = np.array([[0.6, 0.0, 0.8]]), np.tile([[0.0, 0.6, 0.8]], (1000, 1))
        with Client(url) as client:
            model = client.create_model("ward", kd=0.1, ks=0.05, alpha=0.2).id
            table = client.upload(content).id
            while time.monotonic() < end:
                what = rng.choices(("upload", "evaluate", "fit"), (2, 7, 1))[0]
                try:
                    if what == "upload":
                        client.delete_table(client.upload(content).id)
                    elif what == "evaluate":
                        client.evaluate("models", model, wi, wo)
                    else:
                        started = client.start("fits", table=table, model="oren_nayar").id
                        with lock:
                            jobs.append(started)
                except (Refused, ServiceFailed) as error:
                    # A full queue is an answer, too; everything else is a failure.
                    what = "queue full" if isinstance(error, Refused) and error.status == 429 else "failed"
                    if what == "failed":
                        failures.append(f"{type(error).__name__}: {error}")
                with lock:
                    answered[what] += 1
                    memory.append(process.memory_info().rss)

    threads = [threading.Thread(target=one, args=(k,)) for k in range(clients)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    with Client(url) as client:
        states = Counter(client.wait(id).state for id in jobs)
    assert not failures, failures[:3]
    assert sum(states.values()) == states["done"] == len(jobs), states
    assert max(memory) - memory[0] < GROWTH_AT_WORK, memory
    facts: dict[str, Any] = {
        **answered, "server_errors": len(failures), "jobs": dict(states), "clients": clients,
        "resident_bytes_before": memory[0], "resident_bytes_most": max(memory),
    }  # fmt: skip
    rate = sum(answered.values()) / seconds
    figure = Figure("answers a second", "1/s", rate, rate, rate, 1)
    return Row(f"{clients} clients for {seconds:.0f} s: uploads, evaluations, fits", figure, (), facts, SEED)
