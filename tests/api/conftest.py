"""A running service, a small table and the means to wait for a job."""

from __future__ import annotations

import contextlib
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import uvicorn

from api.app import create_app
from api.settings import Settings

with warnings.catch_warnings():
    # Starlette's test client wants another HTTP package than the one the development group names.
    warnings.simplefilter("ignore")
    from starlette.testclient import TestClient


def small_table(seed: int = 0, tail: str = "") -> bytes:
    """Delimited text: a diffuse floor and a broad specular lobe, 1 % noise, made without the models."""
    rng = np.random.default_rng(seed)
    rows = ["# quantity: brdf", "theta_i_deg,theta_o_deg,dphi_deg,brdf_R,brdf_G,brdf_B"]
    for theta_i in (0, 20, 40, 60):
        for theta_o in range(0, 81, 10):
            for dphi in range(0, 181, 30):
                wi = _vector(theta_i, 0)
                half = wi + _vector(theta_o, dphi)
                lobe = 2.0 * (half[2] / np.linalg.norm(half)) ** 60
                value = (np.array([0.1, 0.15, 0.2]) + lobe) * (1 + 0.01 * rng.standard_normal(3))
                rows.append(f"{theta_i},{theta_o},{dphi}," + ",".join(f"{v:.8g}" for v in value))
    return ("\n".join(rows) + "\n" + tail).encode()


def _vector(theta_deg: float, phi_deg: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    theta, phi = np.deg2rad(theta_deg), np.deg2rad(phi_deg)
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def wait_for(client: TestClient, location: str, seconds: float = 180) -> dict[str, Any]:
    """The job once it has ended."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        job = client.get(location).json()
        if job["state"] in ("done", "failed", "cancelled"):
            return job
        time.sleep(0.05)
    raise AssertionError(f"still {job['state']} after {seconds} s: {job['progress']}")


@pytest.fixture(scope="session")
def table_bytes() -> bytes:
    return small_table()


@contextlib.contextmanager
def _services(folder: Path) -> Iterator[Callable[..., TestClient]]:
    opened: list[TestClient] = []

    def start(**settings: Any) -> TestClient:
        client = TestClient(create_app(Settings(**{"folder": folder / "data", **settings})))
        client.__enter__()
        opened.append(client)
        return client

    yield start
    for client in opened:
        client.__exit__(None, None, None)


@pytest.fixture
def serving(tmp_path: Path) -> Iterator[Callable[..., TestClient]]:
    """Start a service with settings of one's own: ``serving(max_queue=1)``."""
    with _services(tmp_path) as start:
        yield start


@pytest.fixture(scope="module")
def serving_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., TestClient]]:
    """The same, each in a folder of its own, for services that a module's tests share."""
    with _services(tmp_path_factory.mktemp("shared")) as start:
        yield lambda **settings: start(folder=tmp_path_factory.mktemp("data"), **settings)


@pytest.fixture(scope="session")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """One service for all tests that don't need their own."""
    with TestClient(create_app(Settings(folder=tmp_path_factory.mktemp("service")))) as opened:
        yield opened


class _Quiet(uvicorn.Server):
    """A server in a thread, which may not take signals."""

    def capture_signals(self) -> Any:
        return contextlib.nullcontext()


@contextlib.contextmanager
def listening(app: Any) -> Iterator[str]:
    """The address of a started application, on a real socket."""
    config = uvicorn.Config(app, port=0, lifespan="off", log_level="critical", ws="none", server_header=False)
    server = _Quiet(config)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        assert thread.is_alive()
        time.sleep(0.01)
    port = server.servers[0].sockets[0].getsockname()[1]
    yield f"http://127.0.0.1:{port}"
    server.should_exit = True
    thread.join(30)


@pytest.fixture(scope="session")
def address(client: TestClient) -> Iterator[str]:
    """That service on a real socket."""
    with listening(client.app) as url:
        yield url


@pytest.fixture(scope="session")
def table(client: TestClient, table_bytes: bytes) -> str:
    """The id of an uploaded table."""
    return str(client.post("/v1/tables", content=table_bytes).json()["id"])


@pytest.fixture(scope="session")
def job(client: TestClient, table: str) -> dict[str, Any]:
    """A finished fit job of the cheapest model, and of one that can't be fitted as asked."""
    wanted = {"table": table, "models": ["oren_nayar", "ward"], "fixed": {"sigma": 0.1}}
    answer = client.post("/v1/fits", json=wanted)
    assert answer.status_code == 202, answer.text
    return wait_for(client, answer.headers["location"])


@pytest.fixture(scope="session")
def fit(job: dict[str, Any]) -> str:
    """The id of a finished fit."""
    assert job["state"] == "done", job
    return str(job["results"][0]["id"])


@pytest.fixture(scope="session")
def model(client: TestClient) -> str:
    """The id of an uploaded Ward model."""
    values = {"kd": [0.1, 0.2, 0.3], "ks": 0.05, "alpha": 0.2}
    return str(client.post("/v1/models", json={"model": "ward", "values": values}).json()["id"])


@pytest.fixture(scope="session")
def wait() -> Callable[..., dict[str, Any]]:
    return wait_for


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium."""
    from .browser import opened

    with opened() as found:
        yield found


@pytest.fixture
def watch(browser: Any) -> Iterator[Callable[..., Any]]:
    """Open a page: ``watch(address)``."""
    from .browser import LAPTOP, Watched

    contexts: list[Any] = []

    def start(address: str, window: dict[str, int] | None = None, **options: Any) -> Any:
        contexts.append(browser.new_context(viewport=window or LAPTOP, accept_downloads=True, **options))
        return Watched.of(contexts[-1], address)

    yield start
    for context in contexts:
        context.close()
