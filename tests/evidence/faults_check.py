"""What has to hold when the faults are over: of every job, every table, every file and every event."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import httpx

from api.blobs import Blobs
from api.place import Place
from api.results import Results
from api.rows import CalibrationRow, JobRow, ModelRow, PosteriorRow, TableRow, TradeoffRow
from api.states import FINAL
from api.storage import open_storage
from api.store import Store
from tests.evidence.faults_load import Accepted

#: Why a job may have failed here, by the code of its problem.
REASONS = ("job-attempts-exhausted", "disk-full")
Violation = dict[str, Any]


def everything(accepted: Accepted, url: str, place: Place) -> tuple[Counter[str], list[Violation]]:
    """Jobs by how they ended, and what is wrong. The server still runs, and nothing is in flight."""
    store = Store(place.database)
    try:
        with httpx.Client(base_url=url, timeout=60) as client:
            ended, wrong = _jobs(accepted, client, store)
            wrong += _tables(accepted, client, store, Blobs(open_storage(place.storage), place.folder))
        wrong += _events(accepted, store)
        wrong += [{"what": "a request was refused", **one} for one in accepted.refused]
    finally:
        store.close()
    return ended, wrong


def _jobs(accepted: Accepted, client: httpx.Client, store: Store) -> tuple[Counter[str], list[Violation]]:
    """Every job in the database."""
    ended: Counter[str] = Counter()
    wrong: list[Violation] = []
    jobs = {job.id: job for job in _all(store, JobRow)}
    wrong += _both("job", accepted.jobs, jobs)
    made: dict[str, list[str]] = {}
    for kind in (ModelRow, PosteriorRow, TradeoffRow, CalibrationRow):
        for row in _all(store, kind):
            made.setdefault(str(row.job_id), []).append(row.id)
    for id, job in jobs.items():
        code = (job.problem or {}).get("code", "none")
        ended[job.state if job.state != "failed" else f"failed: {code}"] += 1
        if job.state not in FINAL:
            wrong.append({"what": "a job did not end", "job": id, "state": job.state})
        if job.state == "failed" and code not in REASONS:
            wrong.append({"what": "a job failed for another reason", "job": id, "problem": job.problem})
        told = [one["id"] for one in job.results] if job.state == "done" else []
        if sorted(made.get(id, [])) != sorted(told) or (job.state == "done") != (len(told) == 1):
            found = {"job": id, "made": made.get(id), "told": told}
            wrong.append({"what": "not published exactly once", **found})
        for one in told:
            where = "fits" if job.kind == "fit" else "posteriors"
            answer = client.get(f"/v1/{where}/{one}")
            if answer.status_code != 200 or answer.json()["id"] != one:
                wrong.append({"what": "a result can't be read", "job": id, "answer": answer.text[:300]})
    return ended, wrong


def _both(noun: str, accepted: Iterable[str], there: Iterable[str]) -> list[Violation]:
    """What was accepted is there, and nothing else: no request was lost, and none made two things."""
    said, found = set(accepted), set(there)
    gone, untold = f"an accepted {noun} is gone", f"no request was told of a {noun}"
    return [
        *({"what": gone, noun: id} for id in sorted(said - found)),
        *({"what": untold, noun: id} for id in sorted(found - said)),
    ]


def _tables(accepted: Accepted, client: httpx.Client, store: Store, blobs: Blobs) -> Iterator[Violation]:
    rows = {row.id: row for row in _all(store, TableRow)}
    yield from _both("table", accepted.tables, rows)
    for id, sha256 in accepted.tables.items():
        row = rows.get(id)
        answer = client.get(f"/v1/tables/{id}/slices?theta_i_deg=20&n=2")
        if row is None or answer.status_code != 200:
            yield {"what": "an accepted table can't be read", "table": id, "answer": answer.text[:300]}
        elif not row.sha256 == sha256 == hashlib.sha256(blobs.read(sha256)).hexdigest():
            yield {"what": "a table's hash is wrong", "table": id}


def _events(accepted: Accepted, store: Store) -> Iterator[Violation]:
    """What the clients received is the whole log: numbers from 1 without gap or repeat, one end."""
    for id, seen in accepted.jobs.items():
        log = [(event.seq, event.kind) for event in store.events(id, limit=100_000)]
        ends = [kind for _, kind in log if kind in FINAL]
        if [number for number, _ in log] != list(range(1, len(log) + 1)) or len(ends) != 1:
            yield {"what": "a job's log has a gap, or not one end", "job": id, "log": log[-5:]}
        if seen != log:
            yield {"what": "a stream is not the log", "job": id, "received": seen[-5:], "log": log[-5:]}


def orphans(place: Place) -> list[Violation]:
    """Files that no row names, of a service that is stopped and cleaned up."""
    store = Store(place.database)
    storage = open_storage(place.storage)
    try:
        blobs = {row.sha256 for row in _all(store, TableRow)}
        results = {row.id for kind in (ModelRow, PosteriorRow) for row in _all(store, kind)}
        found = [
            name
            for folder, known in (("blobs", blobs), ("results", results))
            for name, _ in storage.ages(folder)
            if Path(name).name.partition(".")[0] not in known
        ]
        found += [f"checkpoints/{id}" for id in Results(storage, place.folder).checkpoints()]
        found += [f"incoming/{path.name}" for path in (place.folder / "incoming").iterdir()]
    finally:
        store.close()
    return [{"what": "a file that nothing names", "file": name} for name in found]


def _all(store: Store, kind: type[Any]) -> list[Any]:
    found: list[Any] = []
    while True:
        rows, total = store.page(kind, 200, len(found))
        found += rows
        if len(found) >= total:
            return found
