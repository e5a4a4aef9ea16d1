"""Damaged uploads over HTTP: mutated files of every format, raw and as forms, sent to a server of its own.

Each answer is a 2xx or a 4xx with a problem document, within a bounded time; the server outlives them all,
grows by no more than a fixed amount, and keeps nothing of what it refused. A violation is told with its
input, seed and number: ``python -m tests.evidence.trial NAME SEED NUMBER OUT`` makes the file again.
"""

from __future__ import annotations

import io
import itertools
import json
import tempfile
import threading
import time
import zipfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import psutil

from tests.api.test_server import Server
from tests.evidence.inputs import Input, formats, inputs
from tests.evidence.mutations import mutate
from tests.evidence.study import Outcome, Study
from tests.evidence.trial import damaged

#: Uploads of a full run, at once so many; one in so many is a form whose framing is damaged with the file.
COUNT, CLIENTS, FORMS = 10_000, 4, 4
#: What the server lets its readers take: bytes of memory and seconds. And what an answer may take in all.
MEMORY, SECONDS, LONGEST = 512 << 20, 30.0, 60.0
#: Bytes that the server itself may grow by, whatever it is sent: the limit on a body, twice.
GROWTH = 128 << 20
#: So many violations are told.
_TOLD = 20
_BOUNDARY = b"----boundary-of-the-study"


@dataclass
class Tally:
    """What was answered; shared by the clients."""

    statuses: Counter[int] = field(default_factory=Counter[int])
    codes: Counter[str] = field(default_factory=Counter[str])
    longest: float = 0.0
    most: int = 0
    violations: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    lock: threading.Lock = field(default_factory=threading.Lock)


def judge(name: str, share: float, seed: int) -> Outcome:
    """All formats, through one server."""
    count = max(len(inputs()), round(COUNT * share))
    tally = Tally()
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        server = Server(data, max_parse_bytes=MEMORY, max_parse_seconds=SECONDS)
        try:
            server.ready()
            asked = {one.name: _asked(server.client, one) for one in inputs()}
            work = _numbered(count)
            process = psutil.Process(server.process.pid)
            with ThreadPoolExecutor(CLIENTS) as pool:
                # The caches of a server that has just begun are no growth.
                before = process.memory_info().rss
                for _ in pool.map(lambda one: _send(server, process, one, asked, seed, tally), work):
                    pass
            left = [path.name for path in data.glob("incoming/*")] + [p.name for p in data.glob("blobs/*/*")]
            if left:
                tally.violations.append({"what": "files are left of what was refused", "files": left})
            grown = tally.most - before
            if grown > GROWTH:
                tally.violations.append({"what": f"the server grew by {grown:,} bytes"})
        finally:
            server.close()
    stopped = ("reading-takes-too-long", "reading-takes-too-much", "reading-fails")
    statuses = tally.statuses
    figures = {
        "uploads": sum(statuses.values()), "formats": len(formats()), "whole files taken": len(asked),
        "201": statuses[201], "422": statuses[422], "400": statuses[400],
        "other": sum(n for s, n in statuses.items() if s not in (201, 422, 400)),
        "readers stopped": sum(tally.codes[code] for code in stopped),
        "longest, s": tally.longest, "server's growth, MB": max(grown, 0) / 1e6,
    }  # fmt: skip
    return Outcome(figures, tally.violations[:_TOLD])


def _numbered(count: int) -> Iterator[tuple[Input, int]]:
    """Inputs and numbers of mutations: the formats in turn, and in each its inputs in turn."""
    turns = {name: itertools.cycle([one for one in inputs() if one.format == name]) for name in formats()}
    for number, name in zip(range(count), itertools.cycle(turns), strict=False):
        yield next(turns[name]), number


def _asked(client: httpx.Client, one: Input) -> dict[str, str]:
    """The query with which the undamaged file is taken: what was not taken would prove nothing damaged."""
    query = {name: str(value) for name, value in one.options.items() if name != "columns"}
    if "columns" in one.options:
        query["columns"] = json.dumps(one.options["columns"])
    answer = client.post("/v1/tables", content=_content(one), params=query)
    if answer.status_code == 422 and answer.json()["code"] == "table-several":
        query["item"] = "0"
        answer = client.post("/v1/tables", content=_content(one), params=query)
    if answer.status_code != 201:
        raise RuntimeError(f"{one.name} is not taken: {answer.text[:300]}")
    client.delete(answer.headers["location"])
    return query


def _content(one: Input, name: str = "", data: bytes = b"") -> bytes:
    """An input as one upload, its file ``name`` replaced by ``data``: a zip archive where it is several."""
    files = {**one.files, **({name: data} if name else {})}
    if len(files) == 1:
        return next(iter(files.values()))
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for member, content in files.items():
            archive.writestr(zipfile.ZipInfo(member), content)  # with no time in it: the same bytes each time
    return packed.getvalue()


def _send(
    server: Server, process: psutil.Process, what: tuple[Input, int], asked: Mapping[str, Mapping[str, str]],
    seed: int, tally: Tally,
) -> None:  # fmt: skip
    one, number = what
    body, headers = _body(one, seed, number)
    begun, status, document = time.perf_counter(), 0, {}
    try:
        answer = server.client.post(
            "/v1/tables", content=body, headers=headers, params=asked[one.name], timeout=2 * LONGEST
        )
        status, document = answer.status_code, answer.json()
        if status == 201:
            server.client.delete(answer.headers["location"])
        wrong = _wrong(answer, document)
    except (httpx.HTTPError, ValueError) as error:
        wrong = [f"{type(error).__name__}: {error}"]
    seconds = time.perf_counter() - begun
    if seconds > LONGEST:
        wrong.append(f"it took {seconds:.0f} s")
    with tally.lock:
        tally.statuses[status] += 1
        tally.codes[str(document.get("code"))] += 1
        tally.longest = max(tally.longest, seconds)
        tally.most = max(tally.most, process.memory_info().rss)
        tally.violations += [{"what": what, "again": f"{one.name} {seed} {number}"} for what in wrong]


def _body(one: Input, seed: int, number: int) -> tuple[bytes, dict[str, str]]:
    _, name, data = damaged(one, seed, number)
    if number % FORMS:
        return _content(one, name, data), {}
    head = b'--%s\r\nContent-Disposition: form-data; name="file"; filename="x"\r\n\r\n' % _BOUNDARY
    form = head + _content(one) + b"\r\n--%s--\r\n" % _BOUNDARY
    _, form = mutate(form, data, np.random.default_rng([seed, number]))
    return form, {"Content-Type": f"multipart/form-data; boundary={_BOUNDARY.decode()}"}


def _wrong(answer: httpx.Response, document: Mapping[str, Any]) -> list[str]:
    status = answer.status_code
    if status == 201:
        return [] if document["description"]["usable"] > 0 else ["a table with nothing usable was taken"]
    wrong = [] if 400 <= status < 500 else [f"the answer is {status}: {answer.text[:200]}"]
    if answer.headers.get("content-type") != "application/problem+json" or not document["code"]:
        wrong.append(f"the {status} is no problem document")
    return wrong


def servers() -> Sequence[str]:
    return ("one server",)


STUDY = Study(
    name="uploads",
    title="Damaged uploads",
    claim=(
        f"Files of every format, damaged as above and sent over HTTP, one in {FORMS} as a form whose framing "
        f"is damaged, too, {CLIENTS} at once: every answer is a 2xx, or a 4xx with a problem document, "
        f"within {LONGEST:g} s; readers are stopped at {MEMORY >> 20} MiB and {SECONDS:g} s; the server "
        f"grows by {GROWTH >> 20} MiB at most and keeps nothing of what it refused"
    ),
    columns=(
        "uploads", "formats", "whole files taken", "201", "422", "400", "other", "readers stopped",
        "longest, s", "server's growth, MB",
    ),
    models=servers,
    judge=judge,
    subject="server",
)  # fmt: skip
