"""Damaged files: every measured file and every format, thousands of mutations, read in a process apart.

Each gives a TableError that names the file, with a code and a remedy, or a valid table; no warning, no hang,
no crash, and no more memory than 4 times the file beyond the result, with 1 MiB for whatever a file is, as
tracemalloc counts it (Python's objects and NumPy's arrays). A violation is told with its input, seed and
number: ``python -m tests.evidence.trial NAME SEED NUMBER`` makes it again.
"""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from tests.evidence.inputs import Input, formats, inputs
from tests.evidence.study import Outcome, Study
from tests.evidence.trial import ALLOWANCE, TIMES, work

#: Mutations of a full run, of each measured file and of each made one: more than 10,000 together.
MEASURED, MADE = 440, 100
#: A file that takes longer than this (seconds) hangs; whole ones take less than half a second.
LONGEST = 30.0
#: So many violations of an input are told.
_TOLD = 5


def records(
    one: Input, seed: int, numbers: Sequence[int], *, target: Callable[..., None] = work,
    longest: float = LONGEST,
) -> Iterator[dict[str, Any]]:  # fmt: skip
    """The record of each numbered mutation (:func:`tests.evidence.trial.trial`), hangs and crashes too.

    target : what the process does, as :func:`tests.evidence.trial.work`.
    """
    context = multiprocessing.get_context("spawn")
    left = list(numbers)
    while left:
        ours, theirs = context.Pipe(duplex=False)
        process = context.Process(target=target, args=(theirs, one.name, seed, left))
        process.start()
        theirs.close()
        try:
            # The imports take as long as they take.
            ours.poll(20 * LONGEST)
            ours.recv()
            while left:
                if not ours.poll(longest):
                    process.kill()
                    yield {"number": left.pop(0), "outcome": "fault", "what": f"longer than {longest:g} s"}
                    break
                record = ours.recv()
                left.remove(record["number"])
                yield record
        except EOFError:
            process.join()
            what = f"the process died (exit status {process.exitcode})"
            yield {"number": left.pop(0), "outcome": "fault", "what": what}
        finally:
            ours.close()
            process.kill()
            process.join()


def judge(name: str, share: float, seed: int) -> Outcome:
    """All inputs of one format."""
    outcomes: Counter[str] = Counter()
    worst = {"seconds": 0.0, "over": 0.0}
    placed = 0
    violations: list[dict[str, Any]] = []
    for one in inputs():
        if one.format != name:
            continue
        count = max(2, round((MEASURED if one.measured else MADE) * share))
        faults: list[dict[str, Any]] = []
        for record in records(one, seed, range(count)):
            outcomes[record["outcome"]] += 1
            outcomes["measured"] += one.measured
            placed += bool(record.get("placed"))
            for key in worst:
                worst[key] = max(worst[key], record.get(key, 0.0))
            if record["outcome"] == "fault":
                faults.append(record)
        violations += [
            {
                "what": record["what"], "again": f"{one.name} {seed} {record['number']}",
                "kind": record.get("kind"),
            }
            for record in faults[:_TOLD]
        ]  # fmt: skip
    return Outcome(
        {
            "mutations": outcomes["table"] + outcomes["error"] + outcomes["fault"],
            "of measured files": outcomes["measured"], "tables": outcomes["table"],
            "typed errors": outcomes["error"], "with a place in it": placed,
            "faults": outcomes["fault"], "longest, s": worst["seconds"], "memory over bound": worst["over"],
        },
        violations,
    )  # fmt: skip


STUDY = Study(
    name="fuzz",
    title="Damaged files",
    claim=(
        "Bit flips, runs of bytes, truncation, splices, pieces moved, lines, numbers and header counts "
        "changed: each damaged file gives a typed error that names it, or a valid table, within "
        f"{LONGEST:g} s and {TIMES} times its size in memory beyond the result (and {ALLOWANCE >> 20} MiB "
        "for small files)"
    ),
    columns=(
        "mutations", "of measured files", "tables", "typed errors", "with a place in it", "faults",
        "longest, s", "memory over bound",
    ),
    models=formats,
    judge=judge,
    subject="format",
)  # fmt: skip
