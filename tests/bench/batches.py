"""Batches: MERL-size tables by four models on all cores, beside one process that has one core."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fitter.batch import batch_spec, plan
from fitter.batch import run as run_batch
from tests.bench import tables
from tests.bench.machine import ROOT
from tests.bench.measuring import Figure, Row, Size

SEED = 6
_NAMES = ("ward", "torrance_sparrow", "lafortune", "oren_nayar")
#: In a process of its own that has one core: the seconds that the batch takes there.
_CODE = """\
import json, os, sys, time
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
from fitter.batch import batch_spec, plan, run
begun = time.perf_counter()
run(plan(batch_spec(json.loads(sys.argv[1]))), sys.argv[2], workers=1)
print(time.perf_counter() - begun)
"""


def run(size: Size) -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        yield _merl(folder, size)
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
    ours = _seconds(spec, folder / "all")
    alone = _alone(spec, folder / "one")
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
        facts={"efficiency": alone / (cores * ours), "longest_table_seconds": most},
        seed=SEED,
    )


def _by_tables(folder: Path, size: Size) -> Row:
    """Small tables: how the time grows with their number."""
    counts = size.pick((1, 10, 100, 300), (1, 4))
    (folder / "small").mkdir()
    for k in range(counts[-1]):
        made = tables.merl("ward", tables.SMALL, SEED + k)
        tables.write_merl(made, folder / "small" / f"t{k:04}.binary")
    found: list[float] = []
    for count in counts:
        files = [str(folder / "small" / f"t{k:04}.binary") for k in range(count)]
        spec = {"tables": files, "models": ["ward"], "report": False}
        found.append(_seconds(spec, folder / f"small{count}", workers=1))
    exponent = float(np.log(found[-1] / found[-2]) / np.log(counts[-1] / counts[-2]))
    return Row(
        case=f"batch of {counts[-1]} small tables x ward, in one process",
        ours=Figure.of("fitter.batch.run", "s", [found[-1]]),
        others=(Figure.of(f"of {counts[-2]} tables", "s", [found[-2]]),),
        facts={"seconds": dict(zip(map(str, counts), found, strict=True)), "exponent": exponent},
        seed=SEED,
    )


def _by_samples(folder: Path, size: Size) -> Row:
    """One table: how the time grows with its samples, its program compiled."""
    shapes = size.pick(((9, 9, 18), (20, 20, 40), (42, 42, 84), tables.MERL), ((9, 9, 18), (18, 18, 36)))
    found: dict[int, float] = {}
    for shape in shapes:
        path = folder / f"of{shape[0]}.binary"
        table = tables.merl("ward", shape, SEED)
        tables.write_merl(table, path)
        spec = {"tables": [str(path)], "models": list(_NAMES), "report": False}
        _seconds(spec, folder / f"first{shape[0]}", workers=1)
        found[table.usable] = _seconds(spec, folder / f"of{shape[0]}", workers=1)
    (fewer, before), (most, last) = list(found.items())[-2:]
    return Row(
        case=f"batch of a table of {most:,} samples x 4 models, in one process",
        ours=Figure.of("fitter.batch.run", "s", [last]),
        others=(Figure.of(f"of {fewer:,} samples", "s", [before]),),
        facts={
            "seconds": {str(samples): seconds for samples, seconds in found.items()},
            "exponent": float(np.log(last / before) / np.log(most / fewer)),
        },
        seed=SEED,
    )  # fmt: skip


def _seconds(spec: Mapping[str, Any], out: Path, workers: int | None = None) -> float:
    begun = time.perf_counter()
    done = run_batch(plan(batch_spec(spec)), out, workers=workers)
    assert not done.failed
    return time.perf_counter() - begun


def _alone(spec: Mapping[str, Any], out: Path) -> float:
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    ran = subprocess.run(
        [sys.executable, "-c", _CODE, json.dumps(spec), str(out)], env=environment, check=True,
        capture_output=True, text=True,
    )  # fmt: skip
    return float(ran.stdout)


def _tables(out: Path) -> list[dict[str, Any]]:
    records = [json.loads(path.read_text()) for path in sorted(out.glob("tables/*/unit.json"))]
    return [table for record in records for table in record["tables"]]
