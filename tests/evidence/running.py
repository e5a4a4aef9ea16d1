"""Running studies over models, one process per core, into one JSON document."""

from __future__ import annotations

import multiprocessing
import os
import sys
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from datetime import UTC, datetime
from typing import Any

from tests.evidence.study import Outcome, Study, studies

KIND = "brdf-fitter/evidence"


def run(chosen: Sequence[Study], names: Sequence[str], share: float, seed: int) -> dict[str, Any]:
    """The document of all rows; ``names`` empty means every model a study asks by itself."""
    from tests.bench import machine

    began = time.perf_counter()
    if names:
        chosen = [study for study in chosen if study.subject == "model"]
    work = [(study, name) for study in chosen for name in names or study.asked(share, seed)]
    rows: dict[str, dict[str, dict[str, Any]]] = {study.name: {} for study in chosen}
    for study, name, row in _rows(work, share, seed):
        rows[study.name][name] = row
        state = f"{len(row['violations'])} VIOLATION(S)" if row["violations"] else "ok"
        print(f"{study.name}: {name}: {state}, {row['seconds']:.0f} s", file=sys.stderr, flush=True)
        for one in row["violations"]:
            print(f"    {one}", file=sys.stderr, flush=True)
    about = {
        "created": datetime.now(UTC).isoformat(timespec="seconds"), "share": share, "seed": seed,
        "seconds": time.perf_counter() - began, **machine.describe(),
    }  # fmt: skip
    return {
        "kind": KIND, "version": 2,
        "studies": [
            {
                "name": study.name, "title": study.title, "claim": study.claim, "columns": study.columns,
                "subject": study.subject, "run": about,
                "skipped": {} if names else dict(study.skipped),
                "rows": [rows[study.name][name] for one, name in work if one is study],
            }
            for study in chosen
        ],
    }  # fmt: skip


def merged(before: Mapping[str, Any], document: Mapping[str, Any]) -> dict[str, Any]:
    """``document`` with the studies of an earlier one that were not run again."""
    found = {study["name"]: study for one in (before, document) for study in one["studies"]}
    return {**document, "studies": [found[name] for name in studies() if name in found]}


def _rows(
    work: Sequence[tuple[Study, str]], share: float, seed: int
) -> Iterator[tuple[Study, str, Mapping[str, Any]]]:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    # A fresh interpreter each: JAX does not survive a fork.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(cores, len(work)) or 1, mp_context=context) as pool:
        waiting: dict[Future[dict[str, Any]], tuple[Study, str]] = {
            pool.submit(_row, study.name, name, share, seed): (study, name) for study, name in work
        }
        for done in as_completed(waiting):
            yield *waiting[done], done.result()


def _row(study: str, name: str, share: float, seed: int) -> dict[str, Any]:
    began = time.perf_counter()
    try:
        found = studies()[study].judge(name, share, seed)
    except Exception as error:  # One model that fails to run must not cost the figures of the others.
        told = traceback.format_exception(error)
        found = Outcome({}, [{"what": f"{type(error).__name__}: {error}", "traceback": "".join(told[-4:])}])
    seconds = time.perf_counter() - began
    return {
        "model": name, "figures": dict(found.figures), "violations": [dict(v) for v in found.violations],
        "seconds": round(seconds, 2),
    }  # fmt: skip
