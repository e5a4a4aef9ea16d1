"""``python -m tests.bench``: run the benchmarks, print their table, write one JSON document."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

from fitter.documents import read_document, write_bytes
from tests.bench import page
from tests.bench.measuring import Row, Size, load_average

KIND, VERSION = "brdf-fitter/bench", 2
GROUPS = {
    "load": "loading", "evaluate": "evaluation", "fit": "fits", "posterior": "posteriors",
    "sampler": "samplers", "compression": "compressions", "report": "reports", "budget": "budgets",
    "service": "service", "page": "browsing", "batch": "batches",
}  # fmt: skip


class Group(Protocol):
    """A file of cases."""

    def run(self, size: Size) -> Iterator[Row]: ...


def measure(names: Sequence[str], size: Size) -> dict[str, Any]:
    """The document of one run of the groups ``names``; each row is told on standard error as it is done."""
    from importlib import import_module

    from tests.bench import machine

    began, load = time.perf_counter(), load_average()
    rows: list[dict[str, Any]] = []
    for name in names:
        group: Group = import_module(f"tests.bench.{GROUPS[name]}")
        for row in group.run(size):
            rows.append({"group": name, **row.to_dict(), "load_average": load_average()})
            print("\n".join(page.table(rows[-1:])[2:]), file=sys.stderr, flush=True)
    run = {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "quick": size.quick,
        "seconds": time.perf_counter() - began,
        "load_average": [load, load_average()],
        **machine.describe(),
        "rows": rows,
    }
    return {"kind": KIND, "version": VERSION, "runs": [run]}


def merged(before: Mapping[str, Any], document: Mapping[str, Any]) -> dict[str, Any]:
    """``document`` with those groups of an earlier one that were not measured again, each with its run."""
    again = {row["group"] for run in document["runs"] for row in run["rows"]}
    kept = [
        {**run, "rows": [row for row in run["rows"] if row["group"] not in again]} for run in before["runs"]
    ]
    return {**document, "runs": [run for run in (*kept, *document["runs"]) if run["rows"]]}


def write(document: Mapping[str, Any], out: Path | None) -> None:
    """The document, indented so that two of them can be compared line by line."""
    text = json.dumps(document, indent=1) + "\n"
    if out is None:
        sys.stdout.write(text)
    else:
        write_bytes(text.encode(), out)


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small cases: that it works, no more")
    parser.add_argument("--only", action="append", choices=GROUPS, metavar="NAME", help=", ".join(GROUPS))
    parser.add_argument(
        "--out", type=Path, metavar="FILE",
        help="where the document goes (default: stdout); groups of one there that --only leaves out stay",
    )  # fmt: skip
    parser.add_argument(
        "--markdown", type=Path, metavar="DOCUMENT",
        help="measure nothing: print a document's table, or put it into the page --out between its marks",
    )  # fmt: skip
    given = parser.parse_args(words)
    if given.markdown is not None:
        document = read_document(given.markdown, "not-a-bench")
        if given.out is None:
            print("\n".join(page.lines(document)))
        else:
            write_bytes(page.insert(given.out.read_text(), document).encode(), given.out)
        return 0
    before: Mapping[str, Any] = {"runs": []}
    if given.out is not None and given.out.exists():
        before = read_document(given.out, "not-a-bench")
        if (before.get("kind"), before.get("version")) != (KIND, VERSION):
            parser.error(f"{given.out} is no document of benchmarks, version {VERSION}: name another file")
    document = merged(before, measure(given.only or list(GROUPS), Size(given.quick)))
    print("\n".join(["", *page.lines(document)]), file=sys.stderr)
    write(document, given.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
