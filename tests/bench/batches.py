"""Batches: MERL-size tables by four models on all cores, beside one process that has one core."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from fitter.batch import batch_spec, plan
from fitter.batch import run as run_batch
from tests.bench import tables
from tests.bench.machine import ROOT
from tests.bench.measuring import Figure, Row, Size

SEED = 6
_SMALLEST = (9, 9, 18)
_NAMES = ("ward", "torrance_sparrow", "lafortune", "oren_nayar")
#: In a process of its own that has one core: the seconds that the batch takes there, and the most memory that
#: the process has had after each number of tables.
_CODE = """\
import json, os, re, sys, time
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
from fitter.batch import batch_spec, plan, run
peaks = {}
def look(share, words):
    status = open("/proc/self/status").read()
    peaks[words.split()[0]] = int(re.search(r"VmHWM:\\s+(\\d+)", status)[1]) // 1024
begun = time.perf_counter()
run(plan(batch_spec(json.loads(sys.argv[1]))), sys.argv[2], workers=1, progress=look)
print(json.dumps({"seconds": time.perf_counter() - begun, "peaks": peaks}))
"""
_SHARED = Path(os.environ.get("BRDF_SHARED", ROOT.parent / "shared")) / "measured"


def run(size: Size) -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        yield _merl(folder, size)
        curet = _SHARED / "curet"
        if curet.exists():
            yield _curet(curet, folder, size)
        else:
            print("NO MEASURED TABLES: CUReT is not there (set BRDF_SHARED)", file=sys.stderr)
        yield _by_tables(folder, size)
        yield _by_samples(folder, size)


def _merl(folder: Path, size: Size) -> Row:
    shape, count = size.pick((tables.MERL, 12), (tables.SMALL, 4))
    (folder / "merl").mkdir()
    for k in range(count):
        made = tables.merl(_NAMES[k % 4], shape, SEED + k)
        tables.write_merl(made, folder / "merl" / f"t{k:03}.binary")
    spec = {"tables": [str(folder / "merl")], "models": list(_NAMES), "report": False}
    # Programs are compiled before the clock runs, by a batch of four.
    first = [str(folder / "merl" / f"t{k:03}.binary") for k in range(4)]
    run_batch(plan(batch_spec({**spec, "tables": first})), folder / "first")
    cores = len(os.sched_getaffinity(0))
    ours, _ = _seconds(spec, folder / "all")
    single = _alone(spec, folder / "one")
    alone = single["seconds"]
    records = _tables(folder / "one")
    spent = sum(one["read_seconds"] + sum(fit["seconds"] for fit in one["fits"]) for one in records)
    most = max(one["seconds"] for one in _tables(folder / "all"))
    return Row(
        case=f"batch of {count} MERL tables x 4 models, {cores} workers",
        ours=Figure.of("fitter.batch.run, workers started and stopped", "s", [ours]),
        others=(
            Figure.of("one process on one core", "s", [alone]),
            Figure.of(f"floor: its reading and its fits, over {cores}", "s", [spent / cores]),
        ),
        facts={
            "efficiency": alone / (cores * ours),
            "longest_table_seconds": most,
            "most_memory_mb": {at: single["peaks"][at] for at in (str(count // 3), str(count))},
        },
        seed=SEED,
    )


def _curet(source: Path, folder: Path, size: Size) -> Row:
    """Measured tables with posteriors; a subset of their one file."""
    count = size.pick(20, 2)
    place = folder / "curet"
    place.mkdir()
    lines = (source / "abrdf.dat").read_bytes().splitlines(keepends=True)
    (place / "abrdf.dat").write_bytes(b"".join(lines[:count]))
    shutil.copy(source / "table.txt", place)
    asked = size.pick({}, {"ess": 50, "max_samples": 200, "rhat": 1.2})
    spec = {"tables": [str(place)], "models": list(_NAMES), "posterior": asked, "report": False}
    cores = len(os.sched_getaffinity(0))
    ours, _ = _seconds(spec, folder / "curet-out")
    records = _tables(folder / "curet-out")
    posteriors = sum(one["posterior"]["seconds"] for one in records)
    return Row(
        case=f"batch of {count} CUReT tables x 4 models with posteriors, {cores} workers",
        ours=Figure.of("fitter.batch.run, workers started and stopped", "s", [ours]),
        others=(Figure.of(f"floor: its posteriors, over {cores}", "s", [posteriors / cores]),),
        facts={
            "fits_seconds": sum(fit["seconds"] for one in records for fit in one["fits"]),
            "longest_posterior_seconds": max(one["posterior"]["seconds"] for one in records),
        },
        seed=0,
    )  # fmt: skip


def _by_tables(folder: Path, size: Size) -> Row:
    """Small tables: how the time grows with their number, and the memory."""
    counts = size.pick((1, 10, 100, 1000), (1, 4))
    (folder / "small").mkdir()
    for k in range(counts[-1]):
        made = tables.merl("ward", _SMALLEST, SEED + k)
        tables.write_merl(made, folder / "small" / f"t{k:04}.binary")

    def asked(count: int) -> dict[str, Any]:
        files = [str(folder / "small" / f"t{k:04}.binary") for k in range(count)]
        return {"tables": files, "models": ["ward"], "report": False}

    _seconds(asked(1), folder / "first", workers=1)  # compiles
    found = {count: _seconds(asked(count), folder / f"small{count}", workers=1) for count in counts}
    few, many = size.pick((5, 30), (2, 4))
    peaks = _alone(asked(many), folder / "watched")["peaks"]
    return Row(
        case=f"batch of {counts[-1]:,} small tables x ward, in one process",
        ours=Figure.of("fitter.batch.run", "s", [found[counts[-1]][0]], found[counts[-1]][1]),
        others=(
            Figure.of(f"of {counts[-2]} tables", "s", [found[counts[-2]][0]], found[counts[-2]][1]),
        ),
        facts={
            **_growth(found), "most_memory_mb": {at: peaks[at] for at in (str(few), str(many))},
            "bytes_a_table": _bytes(folder / f"small{counts[-1]}") / counts[-1],
        },
        seed=SEED,
    )  # fmt: skip


def _by_samples(folder: Path, size: Size) -> Row:
    """One table: how the time grows with its samples, its program compiled."""
    shapes = size.pick((_SMALLEST, (20, 20, 40), (42, 42, 84), tables.MERL), (_SMALLEST, (18, 18, 36)))
    found: dict[int, tuple[float, float]] = {}
    for shape in shapes:
        path = folder / f"of{shape[0]}.binary"
        table = tables.merl("ward", shape, SEED)
        tables.write_merl(table, path)
        spec = {"tables": [str(path)], "models": list(_NAMES), "report": False}
        _seconds(spec, folder / f"first{shape[0]}", workers=1)
        found[table.usable] = _seconds(spec, folder / f"of{shape[0]}", workers=1)
    fewer, most = list(found)[-2:]
    return Row(
        case=f"batch of a table of {most:,} samples x 4 models, in one process",
        ours=Figure.of("fitter.batch.run", "s", [found[most][0]], found[most][1]),
        others=(Figure.of(f"of {fewer:,} samples", "s", [found[fewer][0]], found[fewer][1]),),
        facts=_growth(found),
        seed=SEED,
    )


def _growth(found: Mapping[int, tuple[float, float]]) -> dict[str, Any]:
    """Processor seconds by size, and the exponents between neighbours: others on the machine don't matter."""
    sizes = list(found)
    return {
        "cpu_seconds": {str(size): cpu for size, (_, cpu) in found.items()},
        "exponents": [float(np.log(found[b][1] / found[a][1]) / np.log(b / a)) for a, b in pairwise(sizes)],
    }


def _seconds(spec: Mapping[str, Any], out: Path, workers: int | None = None) -> tuple[float, float]:
    """Seconds and, of this process, processor seconds."""
    begun, cpu = time.perf_counter(), time.process_time()
    done = run_batch(plan(batch_spec(spec)), out, workers=workers)
    assert not done.failed
    return time.perf_counter() - begun, time.process_time() - cpu


def _bytes(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def _alone(spec: Mapping[str, Any], out: Path) -> dict[str, Any]:
    """What _CODE prints."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    ran = subprocess.run(
        [sys.executable, "-c", _CODE, json.dumps(spec), str(out)], env=environment, check=True,
        capture_output=True, text=True,
    )  # fmt: skip
    found: dict[str, Any] = json.loads(ran.stdout)
    return found


def _tables(out: Path) -> list[dict[str, Any]]:
    records = [json.loads(path.read_text()) for path in sorted(out.glob("tables/*/unit.json"))]
    return [table for record in records for table in record["tables"]]
