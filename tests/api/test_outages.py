"""Outages: PostgreSQL goes away and comes back, behind a proxy that cuts its connections."""

from __future__ import annotations

import errno
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psycopg
import pytest

from api.outages import outage
from api.store import Store
from fitter.errors import FitError
from tests.api.databases import ADDRESS, database


class Proxy:
    """Passes connections on to PostgreSQL until it is cut; none comes through while it is."""

    def __init__(self, host: str, port: int) -> None:
        self._to = (host, port)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._open: list[socket.socket] = []
        self.cut = False
        threading.Thread(target=self._accept, daemon=True).start()

    def cut_all(self) -> None:
        self.cut = True
        for one in self._open:
            one.close()
        self._open.clear()

    def close(self) -> None:
        self.cut_all()
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                ours, _ = self._listener.accept()
            except OSError:
                return
            if self.cut:
                ours.close()
                continue
            theirs = socket.create_connection(self._to)
            self._open += [ours, theirs]
            for pair in ((ours, theirs), (theirs, ours)):
                threading.Thread(target=self._pass, args=pair, daemon=True).start()

    def _pass(self, source: socket.socket, sink: socket.socket) -> None:
        try:
            while data := source.recv(1 << 16):
                sink.sendall(data)
        except OSError:
            pass  # cut
        for one in (source, sink):
            try:
                one.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue  # closed already


def test_a_database_that_goes_away_and_comes_back(
    serving: Callable[..., Any], table_bytes: bytes, tmp_path: Path
) -> None:
    with database("postgresql", tmp_path) as url:
        with psycopg.connect(ADDRESS) as connection:
            host, port = connection.info.host, connection.info.port
        proxy = Proxy(host, port)
        address = url.replace(f"{host}:{port}", f"127.0.0.1:{proxy.port}")
        client = serving(database_url=address, workers=0)
        table = client.post("/v1/tables", content=table_bytes)
        assert table.status_code == 201
        proxy.cut_all()
        for answer in (
            client.get("/v1/tables"), client.post("/v1/tables", content=table_bytes),
            client.delete(f"/v1/tables/{table.json()['id']}"),
        ):  # fmt: skip
            assert (answer.status_code, answer.json()["code"]) == (503, "database-away")
            assert answer.headers["retry-after"] == "5"
        assert client.get("/readyz").status_code == 503
        with pytest.raises(FitError) as caught:
            Store(address)
        assert caught.value.code == "database-away"
        proxy.cut = False
        assert client.get("/readyz").status_code == 200
        assert client.get("/v1/tables").json()["total"] == 1
        client.app.state.service.store.close()
        proxy.close()


def test_a_full_disk_is_told_from_other_errors() -> None:
    full = outage(OSError(errno.ENOSPC, "No space left on device"))
    assert full is not None
    assert (full["status"], full["code"]) == (507, "disk-full")
    assert outage(OSError(errno.EACCES, "Permission denied")) is None
    assert outage(ValueError("x")) is None
