"""The summary: a row for each fit of each table, as CSV and Parquet, and the index that a person reads."""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import pyarrow as pa
from pyarrow import parquet

from fitter._version import __version__
from fitter.batch import page
from fitter.batch.planning import Plan
from fitter.batch.records import read_record
from fitter.documents import aside, write_bytes

Row = dict[str, Any]

#: Columns that every row has, in this order; behind them come the parameters.
_FIRST = (
    "table", "model", "best", "status", "error", "objective", "rmse", "relative_rmse", "r2", "samples",
    "usable", "metric", "read_seconds", "seconds", "posterior", "posterior_seconds", "format", "path",
    "member", "folder", "sha256", "hash", "seed", "version",
)  # fmt: skip
_TEXT = (
    "table", "model", "status", "error", "metric", "posterior", "format", "path", "member", "folder",
    "sha256", "hash", "version",
)  # fmt: skip
#: Rows that are written together: a row group of the Parquet file.
_GROUP = 10_000


def write(plan: Plan, keys: Mapping[str, str], folder: Path) -> None:
    """``summary.csv``, ``summary.parquet`` and ``index.html`` of what is there, each aside and renamed.

    keys : by a unit's name, that of its record, where it was done as asked now.

    The records are read from the disk one after another, twice: how many there are does not matter to the
    memory.
    """
    found: dict[str, None] = {}
    index = page.Index(plan.spec.report)
    for record in _records(plan, keys, folder):
        for row in _rows(record, plan):
            found.update(dict.fromkeys(row))
        index.add(record)
    columns = [*_FIRST, *sorted(set(found) - set(_FIRST))]
    schema = _schema(columns)
    with (
        aside(folder / "summary.csv") as text,
        aside(folder / "summary.parquet") as packed,
        _csv(text, columns) as csv_rows,
        parquet.ParquetWriter(packed, schema) as parquet_rows,
    ):
        for rows in _grouped(row for record in _records(plan, keys, folder) for row in _rows(record, plan)):
            csv_rows.writerows(rows)
            parquet_rows.write_table(pa.Table.from_pylist(rows, schema))
    write_bytes(index.render().encode(), folder / "index.html")


def _records(plan: Plan, keys: Mapping[str, str], folder: Path) -> Iterator[Mapping[str, Any]]:
    """Of the units that were done as asked now and of those that couldn't be planned, by name."""
    refused = {one["table"]: one for one in plan.refused}
    for name in sorted([*(unit.name for unit in plan.units), *refused]):
        if name in refused:
            one = refused[name]
            unit = {"name": name, "paths": [one["path"]], "member": None}
            yield {"unit": unit, "tables": [], "error": one["error"]}
            continue
        record = read_record(folder, name)
        if record is not None and record.get("key") == keys[name]:
            yield record


def _rows(record: Mapping[str, Any], plan: Plan) -> list[Row]:
    rows = [row for table in record["tables"] for row in rows_of(table, plan.spec.seed)]
    return [*rows, _failed(record["unit"], record["error"])] if record["error"] else rows


def _grouped(rows: Iterable[Row]) -> Iterator[list[Row]]:
    waiting = iter(rows)
    while group := list(itertools.islice(waiting, _GROUP)):
        yield group


def rows_of(table: Mapping[str, Any], seed: int) -> list[Row]:
    """The rows of one table; parameters by label: ``alpha``, ``u(alpha)``, ``kd[R]``, ``u(kd[R])``."""
    about = {
        name: table[name] for name in
        ("table", "samples", "usable", "read_seconds", "format", "path", "member", "folder", "sha256", "hash")
    }  # fmt: skip
    posterior = table.get("posterior") or {}
    found: list[Row] = []
    for fit in table["fits"]:
        row: Row = dict.fromkeys(_FIRST) | about
        row |= {"model": fit["model"], "best": fit["model"] == table.get("best")}
        row |= {"seed": seed, "version": __version__}
        if "error" in fit:
            row |= {"status": "failed", "error": page.sentence(fit["error"])}
        else:
            row |= {"status": fit["status"], "metric": fit["metric"], "seconds": fit["seconds"]}
            row |= {name: fit["metrics"].get(name) for name in ("objective", "rmse", "relative_rmse", "r2")}
            row |= _parameters(fit)
            if posterior.get("model") == fit["model"]:
                row |= {"posterior": posterior["status"], "posterior_seconds": posterior["seconds"]}
                for label, interval in posterior["intervals"].items():
                    row |= {f"{end}95({label})": interval[end] for end in ("lower", "upper")}
        found.append(row)
    return found


def _parameters(fit: Mapping[str, Any]) -> Row:
    row: Row = {}
    for name, estimate in fit["parameters"].items():
        value, u = estimate["value"], estimate["standard_uncertainty"]
        if isinstance(value, list):
            for k, channel in enumerate(fit["model_channels"]):
                row |= {f"{name}[{channel}]": value[k], f"u({name}[{channel}])": u[k]}
        else:
            row |= {name: value, f"u({name})": u}
    return row


def _failed(unit: Mapping[str, Any], error: Mapping[str, Any]) -> Row:
    row: Row = dict.fromkeys(_FIRST)
    return row | {
        "table": unit["name"], "path": unit["paths"][0], "member": unit["member"], "status": "failed",
        "error": page.sentence(error), "best": False, "version": __version__,
    }  # fmt: skip


@contextmanager
def _csv(stream: IO[bytes], columns: Sequence[str]) -> Generator[csv.DictWriter[str]]:
    text = io.TextIOWrapper(stream, encoding="utf-8", newline="")
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    yield writer
    text.detach()  # which writes what is left; the stream is its owner's to close


def _schema(columns: Sequence[str]) -> Any:
    kinds = {"best": pa.bool_(), "samples": pa.int64(), "usable": pa.int64(), "seed": pa.int64()}
    kinds |= dict.fromkeys(_TEXT, pa.string())
    return pa.schema([(name, kinds.get(name, pa.float64())) for name in columns])
