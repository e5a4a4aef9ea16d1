"""Clients of the faults study: some upload without pause, others ask for fits and posteriors and follow them.

A client believes what it was answered and nothing else: what was accepted is what came back with 201 or 202.
Each request names itself (``Idempotency-Key``) and is sent again, as documented, until it is accepted: so
what the service has in the end must be what was accepted, no less and no more.
"""

from __future__ import annotations

import contextlib
import hashlib
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import httpx

from api.states import FINAL
from tests.api.conftest import small_table

#: Answers that are no refusal: the database or the disk will be back, or an earlier attempt is at work.
PASSING = ("503", "507", "409")
#: An upload is sent in so many pieces, with so many seconds between two, so that faults meet it on its way.
PIECES, BETWEEN = 8, 0.2
#: Seconds before a request or a stream is tried again: at first, and at most.
AGAIN = (0.2, 2.0)


@dataclass
class Accepted:
    """What the service has promised, and how it got there.

    tables : by id, the sha256 of what was sent. jobs : by id, the numbers and names of the events that came.
    passing : answers after which a request was sent again, by status. refused : requests that were refused.
    """

    tables: dict[str, str] = field(default_factory=dict[str, str])
    jobs: dict[str, list[tuple[int, str]]] = field(default_factory=dict[str, list[tuple[int, str]]])
    passing: Counter[str] = field(default_factory=Counter[str])
    refused: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    reconnected: int = 0


class Load:
    """Keeps ``uploads`` uploads and ``jobs`` jobs in flight until it is told to stop."""

    def __init__(self, url: str, seed: int, uploads: int, jobs: int) -> None:
        self.accepted = Accepted()
        self._url = url
        self._seed = seed
        self._content = small_table()
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._over = threading.Event()
        self._sending = 0
        self._tables: list[str] = []
        self._fits: list[str] = []
        self._threads = [
            threading.Thread(target=self._client, args=(work, place), daemon=True)
            for work, places in ((self._upload, uploads), (self._job, jobs))
            for place in range(places)
        ]

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def until(self, condition: Callable[[], Any], seconds: float) -> None:
        """Wait for it, or so long."""
        end = time.monotonic() + seconds
        while not condition() and time.monotonic() < end:
            time.sleep(0.02)

    @property
    def fits(self) -> int:
        """Fits that posteriors can be asked of."""
        return len(self._fits)

    @property
    def ended(self) -> int:
        """Jobs whose end was told."""
        with self._lock:
            return sum(bool(seen) and seen[-1][1] in FINAL for seen in self.accepted.jobs.values())

    def under_way(self) -> tuple[int, int]:
        """Uploads on the wire, and jobs that were accepted and have not ended."""
        ended = self.ended
        with self._lock:
            return self._sending, len(self.accepted.jobs) - ended

    def stop(self, seconds: float) -> list[str]:
        """Ask for nothing more, and wait for what was asked for; the jobs that did not end in time."""
        self._stopping.set()
        end = time.monotonic() + seconds
        for thread in self._threads:
            thread.join(max(0.0, end - time.monotonic()))
        self._over.set()
        with self._lock:
            return [id for id, seen in self.accepted.jobs.items() if not seen or seen[-1][1] not in FINAL]

    def _client(self, work: Callable[[httpx.Client, int, int], None], place: int) -> None:
        with httpx.Client(base_url=self._url, timeout=60) as client:
            number = 0
            while not self._stopping.is_set():
                work(client, place, number)
                number += 1

    def _upload(self, client: httpx.Client, place: int, number: int) -> None:
        content = self._content + f"# {self._seed} {place} {number}\n".encode()
        answer = self._post(client, "/v1/tables", f"table {place} {number}", lambda: self._slowly(content))
        if answer is not None:
            with self._lock:
                self.accepted.tables[answer["id"]] = hashlib.sha256(content).hexdigest()
                self._tables.append(answer["id"])

    @contextlib.contextmanager
    def _slowly(self, content: bytes) -> Iterator[dict[str, Any]]:
        def pieces() -> Iterator[bytes]:
            size = -(-len(content) // PIECES)
            for start in range(0, len(content), size):
                yield content[start : start + size]
                time.sleep(BETWEEN)

        with self._lock:
            self._sending += 1
        try:
            yield {"content": pieces()}
        finally:
            with self._lock:
                self._sending -= 1

    def _job(self, client: httpx.Client, place: int, number: int) -> None:
        if not self._tables:
            time.sleep(0.05)
            return
        path, wanted = "/v1/fits", {"table": self._tables[-1], "model": "oren_nayar"}
        if self._fits and place % 2:
            # A quarter of a second to two seconds of work.
            path, seconds = "/v1/posteriors", 0.25 * (1 + number % 8)
            wanted = {"fit": self._fits[-1], "ess": 1_000_000, "walkers": 8, "keep": 200,
                      "budget_seconds": seconds}  # fmt: skip
        body = contextlib.nullcontext({"json": wanted})
        answer = self._post(client, path, f"job {place} {number}", lambda: body)
        if answer is not None:
            with self._lock:
                self.accepted.jobs[answer["id"]] = []
            self._follow(client, answer["id"])

    def _post(
        self, client: httpx.Client, path: str, name: str,
        body: Callable[[], contextlib.AbstractContextManager[dict[str, Any]]],
    ) -> dict[str, Any] | None:  # fmt: skip
        """What was accepted; None where it was refused, or the time is over."""
        headers, wait = {"Idempotency-Key": f"{self._seed} {name}"}, AGAIN[0]
        while not self._over.is_set():
            how = "no answer"
            with contextlib.suppress(httpx.TransportError), body() as sent:
                answer = client.post(path, headers=headers, **sent)
                if answer.status_code in (201, 202):
                    return answer.json()
                how = str(answer.status_code)
                if how not in PASSING:
                    told = {"path": path, "status": how, "answer": answer.text[:300]}
                    with self._lock:
                        self.accepted.refused.append(told)
                    return None
            with self._lock:
                self.accepted.passing[how] += 1
            self._over.wait(wait)
            wait = min(2 * wait, AGAIN[1])
        return None

    def _follow(self, client: httpx.Client, job: str) -> None:
        """Every event of a job, however often the stream breaks off."""
        seen, wait = self.accepted.jobs[job], AGAIN[0]
        while (not seen or seen[-1][1] not in FINAL) and not self._over.is_set():
            before = len(seen)
            headers = {"Last-Event-ID": str(seen[-1][0] if seen else 0)}
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
                wait = AGAIN[0] if len(seen) > before else min(2 * wait, AGAIN[1])
                self._over.wait(wait)
        if seen and seen[-1][1] == "done":
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
        # Another fit will do where this one can't be asked for just now.
        with contextlib.suppress(httpx.TransportError):
            answer = client.get(f"/v1/jobs/{job}")
            if answer.status_code == 200 and answer.json()["kind"] == "fit":
                self._fits.append(answer.json()["results"][0]["id"])
