"""Clients of the faults study: they upload, ask for fits and posteriors, and follow every job's events.

A client believes what it was answered and nothing else: what was accepted is what came back with 201 or 202.
Requests that fail are told by their kind and tried again.
"""

from __future__ import annotations

import contextlib
import hashlib
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import httpx

from tests.api.conftest import small_table

FINAL = ("done", "failed", "cancelled")


@dataclass
class Accepted:
    """What the service has promised: tables by id with the sha256 of what was sent, jobs by id with the
    numbers and names of the events that came."""

    tables: dict[str, str] = field(default_factory=dict[str, str])
    jobs: dict[str, list[tuple[int, str]]] = field(default_factory=dict[str, list[tuple[int, str]]])
    refused: Counter[str] = field(default_factory=Counter[str])
    reconnected: int = 0


class Load:
    """Keeps ``places`` jobs in flight until it is told to stop."""

    def __init__(self, url: str, seed: int, places: int) -> None:
        self.accepted = Accepted()
        self._url = url
        self._seed = seed
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._fits: list[str] = []
        self._threads = [threading.Thread(target=self._client, args=(k,), daemon=True) for k in range(places)]

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def until_fitted(self, seconds: float) -> None:
        """Wait until there is a fit, so that posteriors are asked for, too."""
        end = time.monotonic() + seconds
        while not self._fits and time.monotonic() < end:
            time.sleep(0.05)

    def until_events(self, count: int, seconds: float) -> None:
        """Wait until so many more events came, or so long."""
        end = time.monotonic() + seconds
        before = self._count()
        while self._count() < before + count and time.monotonic() < end:
            time.sleep(0.02)

    def _count(self) -> int:
        with self._lock:
            return sum(len(seen) for seen in self.accepted.jobs.values())

    def stop(self, seconds: float) -> list[str]:
        """Ask for nothing more, and wait for what was asked for; the jobs that did not end in time."""
        self._stopping.set()
        end = time.monotonic() + seconds
        for thread in self._threads:
            thread.join(max(0.0, end - time.monotonic()))
        with self._lock:
            return [id for id, seen in self.accepted.jobs.items() if not seen or seen[-1][1] not in FINAL]

    def _client(self, place: int) -> None:
        number = 0
        with httpx.Client(base_url=self._url, timeout=60) as client:
            while not self._stopping.is_set():
                number += 1
                table = self._upload(client, f"# {self._seed} {place} {number}\n".encode())
                if table is None:
                    continue
                job = self._job(client, place, number, table)
                if job is not None:
                    self._follow(client, job)

    def _upload(self, client: httpx.Client, tail: bytes) -> str | None:
        content = small_table(tail=tail.decode())
        answer = self._ask(client, "/v1/tables", content=content)
        if answer is None:
            return None
        id = str(answer.json()["id"])
        with self._lock:
            self.accepted.tables[id] = hashlib.sha256(content).hexdigest()
        return id

    def _job(self, client: httpx.Client, place: int, number: int, table: str) -> str | None:
        with self._lock:
            fit = self._fits[-1] if self._fits else None
        if fit is not None and place % 2:
            # A quarter of a second to two seconds of work.
            seconds = 0.25 * (1 + number % 8)
            wanted: dict[str, Any] = {"fit": fit, "ess": 1_000_000, "walkers": 8, "budget_seconds": seconds}
            answer = self._ask(client, "/v1/posteriors", json=wanted)
        else:
            answer = self._ask(client, "/v1/fits", json={"table": table, "model": "oren_nayar"})
        if answer is None:
            return None
        id = str(answer.json()["id"])
        with self._lock:
            self.accepted.jobs[id] = []
        return id

    def _ask(self, client: httpx.Client, path: str, **body: Any) -> httpx.Response | None:
        try:
            answer = client.post(path, **body)
        except httpx.TransportError:
            self._refused("no answer")
            return None
        if answer.status_code in (201, 202):
            return answer
        self._refused(str(answer.status_code))
        return None

    def _refused(self, how: str) -> None:
        with self._lock:
            self.accepted.refused[how] += 1
        self._stopping.wait(0.2)

    def _follow(self, client: httpx.Client, job: str) -> None:
        """Every event of a job, however often the stream breaks off."""
        seen = self.accepted.jobs[job]
        while not seen or seen[-1][1] not in FINAL:
            after = seen[-1][0] if seen else 0
            headers = {"Last-Event-ID": str(after)}
            # What breaks off is taken up again below, as often as it takes.
            with (
                contextlib.suppress(httpx.TransportError),
                client.stream("GET", f"/v1/jobs/{job}/events", headers=headers) as stream,
            ):
                if stream.status_code == 200:
                    self._read(stream, seen)
            if not seen or seen[-1][1] not in FINAL:
                with self._lock:
                    self.accepted.reconnected += 1
                time.sleep(0.1)
        if seen[-1][1] == "done":
            self._remember_fit(client, job)

    def _read(self, stream: httpx.Response, seen: list[tuple[int, str]]) -> None:
        fields: dict[str, str] = {}
        for line in stream.iter_lines():
            if line:
                name, _, value = line.partition(": ")
                fields[name] = value
            else:
                if "id" in fields:
                    seen.append((int(fields["id"]), fields["event"]))
                fields = {}

    def _remember_fit(self, client: httpx.Client, job: str) -> None:
        try:
            answer = client.get(f"/v1/jobs/{job}")
        except httpx.TransportError:
            return
        if answer.status_code == 200 and answer.json()["kind"] == "fit":
            with self._lock:
                self._fits.append(answer.json()["results"][0]["id"])
