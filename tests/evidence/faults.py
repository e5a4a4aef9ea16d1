"""Faults: processes killed, a full disk and a database that is away, while fits and posteriors are in flight.

A service of its own, as the command starts it, with a local Dask cluster; for PostgreSQL a cluster of its
own, made by initdb and stopped for 10 s. Its folder is a small tmpfs, which is filled to the last byte; where
there is no right to mount one the row says so. Clients believe only what they were answered.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from api.place import Place
from tests.evidence import faults_check
from tests.evidence.faults_load import Load
from tests.evidence.faults_service import Postgres, Service, full, small_disk
from tests.evidence.study import Outcome, Study

#: Kills of a full run, on both databases together.
KILLS = 100
VICTIMS = ("worker", "scheduler", "server")
#: Uploads and jobs in flight.
UPLOADS, JOBS = 2, 6
#: Most kills come when another job has ended since the last one, or after so many seconds, and then at random
#: within so many more; this share of them without waiting, which meets processes that are starting.
PATIENCE, PAUSE, AT_ONCE = 60.0, 3.0, 0.2
#: Seconds that the disk is full; that PostgreSQL is away; that the last jobs may take.
FULL, AWAY, LAST = 6.0, 10.0, 900.0
#: How often each outage comes.
OUTAGES = 2


def databases() -> Sequence[str]:
    return ("sqlite", "postgresql")


def judge(name: str, share: float, seed: int) -> Outcome:
    """One database."""
    kills = max(len(VICTIMS), round(KILLS * share / len(databases())))
    random = np.random.default_rng([seed, name == "sqlite"])
    home = Path(tempfile.mkdtemp(prefix="brdf-faults-"))
    home.chmod(0o755)
    postgres = Postgres(home / "postgres") if name == "postgresql" else None
    try:
        with small_disk(home / "data") as mounted:
            service = Service(home / "data", home / "log", postgres.url if postgres else None)
            try:
                if postgres is not None:
                    service.command("db", "upgrade")
                figures, violations = _run(service, postgres, kills, random, seed, mounted=mounted)
            finally:
                service.close()
    finally:
        if postgres is not None:
            postgres.stop()
    if violations:
        violations.append({"what": "the server's log is kept", "file": str(home / "log")})
    else:
        shutil.rmtree(home)
    return Outcome(figures, violations)


def _run(
    service: Service, postgres: Postgres | None, kills: int, random: np.random.Generator, seed: int, *,
    mounted: bool,
) -> tuple[dict[str, Any], list[dict[str, Any]]]:  # fmt: skip
    service.start()
    load = Load(service.url, seed, UPLOADS, JOBS)
    load.start()
    # Every kind as often as the others, in any order; the disk and the database somewhere on the way.
    order = [VICTIMS[k % len(VICTIMS)] for k in range(kills)]
    random.shuffle(order)
    fill, halt = (set(random.choice(kills, OUTAGES, replace=False).tolist()) for _ in range(2))
    killed: Counter[str] = Counter()
    met: Counter[str] = Counter()
    meanwhile: dict[str, Counter[str]] = {"full": Counter(), "away": Counter()}
    load.until(lambda: load.fits, PATIENCE * 4)
    for number, kind in enumerate(order):
        ended = load.ended
        if random.random() >= AT_ONCE:
            load.until(lambda ended=ended: load.ended > ended, PATIENCE)
        if number in fill and mounted:
            with _told(load, meanwhile["full"]), full(service.folder):
                time.sleep(FULL)
        if number in halt and postgres is not None:
            with _told(load, meanwhile["away"]):
                postgres.stop()
                time.sleep(AWAY)
                postgres.start()
        time.sleep(random.uniform(0.0, PAUSE))
        uploads, jobs = load.under_way()
        _kill(service, kind, random)
        killed[kind] += 1
        met.update(upload=uploads > 0, job=jobs > 0)
    late = load.stop(LAST)
    url = service.url
    place = _place(service, postgres)
    ended, violations = faults_check.everything(load.accepted, url, place)
    violations += [{"what": "a stream did not come to its end", "job": id} for id in late]
    service.stop()
    deleted = json.loads(service.command("gc", "--grace", "0", "--json").stdout)["deleted"]
    violations += faults_check.orphans(place)
    seen = load.accepted
    reasons = {code: ended[f"failed: {code}"] for code in faults_check.REASONS}
    figures: dict[str, Any] = {
        **{f"{kind}s killed": killed[kind] for kind in VICTIMS},
        "with an upload under way": met["upload"], "with a job under way": met["job"],
        "disk full, s": OUTAGES * FULL if mounted else "not tried: no right to mount",
        "answers meanwhile": _words(meanwhile["full"]),
        "database away, s": OUTAGES * AWAY if postgres is not None else "a file",
        "answers while it was": _words(meanwhile["away"]),
        "tables": len(seen.tables), "jobs": sum(ended.values()), "done": ended["done"],
        "failed with a reason": _words(reasons), "requests sent again": _words(seen.passing),
        "streams taken up again": seen.reconnected, "events": sum(len(one) for one in seen.jobs.values()),
        "files that gc deleted": sum(deleted[one] for one in ("blobs", "results", "checkpoints", "uploads")),
    }  # fmt: skip
    return figures, violations


@contextlib.contextmanager
def _told(load: Load, answers: Counter[str]) -> Generator[None]:
    """Begin an outage when an upload and a job are under way; count what requests are answered meanwhile."""
    load.until(lambda: all(load.under_way()), PATIENCE)
    before = Counter(load.accepted.passing)
    accepted = len(load.accepted.tables) + len(load.accepted.jobs)
    yield
    answers.update(Counter(load.accepted.passing) - before)
    answers["accepted"] += len(load.accepted.tables) + len(load.accepted.jobs) - accepted


def _words(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{what} {count}" for what, count in sorted(counts.items()) if count) or "none"


def _kill(service: Service, kind: str, random: np.random.Generator) -> None:
    """Kill one of a kind as soon as there is one; a killed server is started again, as by an operator."""
    end = time.monotonic() + 120
    while not (found := service.victims(kind)):
        if time.monotonic() > end:
            raise RuntimeError(f"no {kind} to kill")
        time.sleep(0.02)
    service.kill(found[int(random.integers(len(found)))])
    if kind == "server":
        service.start()


def _place(service: Service, postgres: Postgres | None) -> Place:
    url = postgres.url if postgres is not None else f"sqlite:///{service.folder / 'service.sqlite'}"
    return Place(service.folder, url, str(service.folder))


STUDY = Study(
    name="faults",
    title="Faults",
    claim=(
        "With uploads, fits and posteriors in flight: workers, schedulers and servers killed at random "
        f"moments, {KILLS} times in all, the disk full for {FULL:g} s, PostgreSQL stopped for {AWAY:g} s, "
        f"each {OUTAGES} times. Clients name their requests and send them again until they are accepted. "
        "Afterwards each request has made one table or one job, every job is published exactly once or "
        "failed with a reason, every table is readable and its hash right, no file is left that no row "
        "names, and every event stream came without a gap or a repeat"
    ),
    columns=(
        "workers killed", "schedulers killed", "servers killed", "with an upload under way",
        "with a job under way", "disk full, s", "answers meanwhile", "database away, s",
        "answers while it was", "tables", "jobs", "done", "failed with a reason", "requests sent again",
        "streams taken up again", "events", "files that gc deleted",
    ),
    models=databases,
    judge=judge,
    subject="database",
)  # fmt: skip
