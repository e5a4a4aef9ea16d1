"""One damaged file, read: what became of it, how long it took and how much memory it needed.

``python -m tests.evidence.trial NAME SEED NUMBER [OUT]`` makes one again, and writes the damaged file to OUT.
"""

from __future__ import annotations

import json
import resource
import sys
import time
import traceback
import tracemalloc
import warnings
from collections.abc import Sequence
from io import BytesIO
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from fitter.errors import TableError
from fitter.formats import describe, load_all
from fitter.table import Table
from tests.evidence.inputs import Input, inputs
from tests.evidence.mutations import mutate

#: Address space of the process that reads, bytes: a header that claims more must not get it.
ADDRESS_SPACE = 6 << 30
#: Memory beyond the result: so many times the file, and so many bytes for whatever a file is.
TIMES, ALLOWANCE = 4, 1 << 20


def damaged(one: Input, seed: int, number: int) -> tuple[str, str, bytes]:
    """``(kind, name of the file, its bytes)`` of a numbered mutation of an input."""
    rng = np.random.default_rng([seed, number, *one.name.encode()])
    name = list(one.files)[int(rng.integers(len(one.files)))]
    others = [file for other in inputs() if other is not one for file in other.files.values()]
    kind, data = mutate(one.files[name], others[int(rng.integers(len(others)))], rng)
    return kind, name, data


def trial(one: Input, seed: int, number: int) -> dict[str, Any]:
    """The record of one mutation: its kind, the outcome ("table", "error" or "fault"), seconds, memory.

    A fault says what is wrong: another exception than TableError, a warning, an error without a place or a
    remedy, a table that contradicts itself, or too much memory.
    """
    kind, name, data = damaged(one, seed, number)
    sources = one.sources(name, data)
    size = sum(len(source.getvalue()) for source in sources)
    record: dict[str, Any] = {"number": number, "kind": kind, "file": name, "outcome": "table"}
    wrong: list[str] = []
    tables: list[Table] = []
    tracemalloc.start()
    began = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            tables = read(one, sources)
    except TableError as error:
        # Its traceback keeps what was read; all of that counts.
        record |= {"outcome": "error", "code": error.code, "placed": _placed(error)}
        wrong += _of_error(error, one)
    except BaseException as error:  # Whatever it is, it is the finding.
        wrong.append(_told(error))
    record["seconds"] = time.perf_counter() - began
    kept, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    beyond = peak - (kept if tables else 0)
    record["times"] = beyond / max(size, 1)
    record["over"] = beyond / (TIMES * size + ALLOWANCE)
    if record["over"] > 1:
        wrong.append(f"{beyond:,} bytes beyond the result for a file of {size:,}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for table in tables:
                wrong += _of_table(table)
    except BaseException as error:
        wrong.append(f"of the table: {_told(error)}")
    if wrong:
        record |= {"outcome": "fault", "what": "; ".join(wrong)}
    return record


def read(one: Input, sources: Sequence[BytesIO]) -> list[Table]:
    """The tables of an input's files."""
    return load_all(sources[0] if len(sources) == 1 else list(sources), **one.options)


def _placed(error: TableError) -> bool:
    """Whether the error says where in the file, not only which file."""
    return bool({"row", "column", "offset", "parameter"} & set(error.where()))


def _of_error(error: TableError, one: Input) -> list[str]:
    wrong: list[str] = []
    if error.file not in one.files:
        wrong.append(f"the error names the file {error.file!r}: {error}")
    if not error.code or not error.remedy or not error.message:
        wrong.append(f"the error has no code or no remedy: {error}")
    try:
        json.dumps(error.to_dict())
        str(error).encode()
    except (TypeError, ValueError) as unwritable:
        wrong.append(f"the error can't be written: {unwritable}")
    return wrong


def _of_table(table: Table) -> list[str]:
    n = len(table)
    usable, counted = table.mask, sum(table.metadata.masked.values())
    wi, wo = table.directions(np.flatnonzero(usable))
    checks = {
        "a usable value is not finite": bool(np.isfinite(table.value[usable]).all()),
        "a usable value is negative": bool((table.value[usable] >= 0).all()),
        "nothing is usable": bool(usable.any()),
        "a usable direction is no unit vector": all(
            bool((np.abs(np.linalg.norm(w, axis=1) - 1) < 1e-6).all()) for w in (wi, wo)
        ),
        "a usable direction is below the horizon": bool((wi[:, 2] > 0).all() and (wo[:, 2] >= 0).all()),
        "the masked samples are not all counted": int(usable.sum()) + counted == n,
        "a usable sigma is not positive": table.sigma is None or bool((table.sigma[usable] > 0).all()),
    }  # fmt: skip
    wrong = [what for what, holds in checks.items() if not holds]
    json.dumps(describe(table), allow_nan=False)
    return wrong


def _told(error: BaseException) -> str:
    last = traceback.extract_tb(error.__traceback__)[-3:]
    places = " < ".join(f"{Path(f.filename).name}:{f.lineno}" for f in reversed(last))
    return f"{type(error).__name__}: {str(error)[:160]} ({places})"


def work(pipe: Connection, name: str, seed: int, numbers: Sequence[int]) -> None:
    """Send the record of each numbered mutation of one input, in order."""
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    one = find(name)
    read(one, one.sources("", b""))
    pipe.send(None)  # ready: imports and caches are not the first file's
    for number in numbers:
        pipe.send(trial(one, seed, number))
    pipe.close()


def find(name: str) -> Input:
    """The input of that name."""
    return next(one for one in inputs() if one.name == name)


def main(words: Sequence[str]) -> None:
    name, seed, number, *out = words
    one = find(name)
    print(json.dumps(trial(one, int(seed), int(number)), indent=1))
    if out:
        Path(out[0]).write_bytes(damaged(one, int(seed), int(number))[2])


if __name__ == "__main__":
    main(sys.argv[1:])
