"""Upkeep: delete what nobody needs any more, and copy what there is."""

from __future__ import annotations

import shutil
import sqlite3
import time
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from sqlalchemy import delete, select

from api.blobs import Blobs
from api.place import Place
from api.results import Results
from api.rows import RESULTS, EventRow, JobRow, TableRow
from api.states import FINAL
from api.storage import Storage, open_storage
from api.store import Store
from fitter.errors import SpecError

#: Seconds for which a file may lie there without a row: its upload or its job may be about to make one.
GRACE = 86_400.0


def collect(
    place: Place, *, keep_jobs_days: float | None = None, grace_seconds: float = GRACE
) -> dict[str, int]:
    """Delete files that no row names, and, where asked, jobs that ended so many days ago with their logs.

    Results, models and tables stay: those are deleted over HTTP, by who owns them. Servers may run meanwhile.
    Returns how many went of each: ``jobs``, ``events``, ``blobs``, ``results``, ``checkpoints``, ``uploads``.
    """
    store, storage = Store(place.database), open_storage(place.storage)
    blobs, results = Blobs(storage, place.folder), Results(storage, place.folder)
    gone: Counter[str] = Counter()
    try:
        if keep_jobs_days is not None:
            gone.update(_forget_jobs(store, time.time() - 86_400.0 * keep_jobs_days))
        gone["blobs"] = _stray_blobs(store, storage, grace_seconds)
        gone["results"] = _stray(storage, "results", grace_seconds, lambda id: _has_result(store, id))
        gone["checkpoints"] = _stray_checkpoints(store, results)
        gone["uploads"] = blobs.clear_incoming(grace_seconds)
    finally:
        store.close()
    return {name: gone[name] for name in ("jobs", "events", "blobs", "results", "checkpoints", "uploads")}


def _forget_jobs(store: Store, before: float) -> dict[str, int]:
    with store.writing() as session:
        old = select(JobRow.id).where(JobRow.state.in_(FINAL), JobRow.finished < before)
        ids = session.scalars(old.with_for_update(skip_locked=True)).all()
        events = sum(
            len(session.scalars(delete(EventRow).where(EventRow.job_id == id).returning(EventRow.seq)).all())
            for id in ids
        )
        for id in ids:
            session.execute(delete(JobRow).where(JobRow.id == id))
    return {"jobs": len(ids), "events": events}


def _stray_blobs(store: Store, storage: Storage, grace: float) -> int:
    def named(sha256: str) -> bool:
        with store.reading() as session:
            return session.scalar(select(TableRow.id).where(TableRow.sha256 == sha256).limit(1)) is not None

    # An upload of the same bytes may be about to rely on the blob: nobody adds such a row meanwhile.
    with store.guarding():
        return _stray(storage, "blobs", grace, named)


def _has_result(store: Store, id: str) -> bool:
    return any(store.get(kind, id) is not None for kind in RESULTS)


def _stray(storage: Storage, folder: str, grace: float, named: Callable[[str], bool]) -> int:
    """Delete the files of a folder that are old enough and whose id no row has, or that were never whole."""
    count = 0
    known: dict[str, bool] = {}
    for name, age in storage.ages(folder):
        if age < grace:
            continue
        file = name.rpartition("/")[2]
        # Files on their way begin with a dot, or end with .part.
        id = file.partition(".")[0]
        if id not in known:
            known[id] = named(id)
        if file.startswith(".") or file.endswith(".part") or not known[id]:
            storage.drop(name)
            count += 1
    return count


def _stray_checkpoints(store: Store, results: Results) -> int:
    count = 0
    for id in results.checkpoints():
        job = store.get(JobRow, id)
        if job is None or job.state in FINAL:
            results.drop_checkpoint(id)
            count += 1
    return count


def backup(place: Place, target: Path) -> dict[str, int]:
    """A consistent copy of an SQLite database, its blobs and its results, in a new folder that can be served.

    The database first: what its rows name is on the disk already, and no server deletes it while this runs.
    Raises SpecError for PostgreSQL, for other storage than a folder, and where the target holds something.
    """
    source = place.database.removeprefix("sqlite:///")
    if source == place.database or "://" in place.storage:
        raise SpecError(
            "only SQLite and a folder can be copied by this", code="bad-call", parameter="database",
            remedy="use pg_dump, then copy the storage with its own tools; see docs/operating.md",
        )  # fmt: skip
    if not Path(source).exists():
        raise SpecError(
            "there is no database in this folder", code="no-database", file=source,
            remedy="name the --folder of a service",
        )  # fmt: skip
    if target.exists() and any(target.iterdir()):
        raise SpecError(
            "the folder holds something already", code="out-exists", file=str(target), parameter="out",
            remedy="name a new one: a backup never overwrites another",
        )  # fmt: skip
    target.mkdir(parents=True, exist_ok=True)
    store = Store(place.database)
    copied: Counter[str] = Counter()
    try:
        with store.guarding():
            aside = target / ".service.sqlite"
            with closing(sqlite3.connect(source)) as one, closing(sqlite3.connect(aside)) as other:
                one.backup(other)
            for folder in ("blobs", "results"):
                copied[folder] = _copy(Path(place.storage), target, folder)
            aside.rename(target / "service.sqlite")  # last: a folder without it is no backup
    finally:
        store.close()
    return dict(copied)


def _copy(source: Path, target: Path, folder: str) -> int:
    count = 0
    for path in sorted((source / folder).rglob("*")):
        if path.is_file() and not path.name.startswith("."):
            to = target / path.relative_to(source)
            to.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(path, to)
            count += 1
    return count
