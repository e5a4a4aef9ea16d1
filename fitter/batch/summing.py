"""The summary: a row for each fit of each table, as CSV and Parquet, and the index that a person reads."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fitter._version import __version__
from fitter.batch import page
from fitter.batch.planning import Plan
from fitter.documents import write_bytes

Row = dict[str, Any]

#: Columns that every row has, in this order; behind them come the parameters.
_FIRST = (
    "table", "model", "best", "status", "error", "objective", "rmse", "relative_rmse", "r2", "samples",
    "usable", "metric", "read_seconds", "seconds", "posterior", "posterior_seconds", "format", "path",
    "member", "folder", "sha256", "hash", "seed", "version",
)  # fmt: skip


def write(records: Sequence[Mapping[str, Any]], plan: Plan, folder: Path) -> None:
    """``summary.csv``, ``summary.parquet`` and ``index.html`` of what is there, each aside and renamed."""
    tables = [dict(table) for record in records for table in record["tables"]]
    failed = [_failed(one["unit"]["name"], one["unit"], one["error"]) for one in records if one["error"]]
    failed += [_failed(one["table"], {"paths": [one["path"]]}, one["error"]) for one in plan.refused]
    rows = [row for table in tables for row in rows_of(table, plan.spec.seed)] + failed
    rows.sort(key=lambda row: (row["table"], row["model"] or ""))
    columns = [*_FIRST, *sorted({name for row in rows for name in row} - set(_FIRST))]
    write_bytes(_csv(rows, columns), folder / "summary.csv")
    write_bytes(_parquet(rows, columns), folder / "summary.parquet")
    write_bytes(page.render(tables, failed).encode(), folder / "index.html")


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
            row |= {"status": "failed", "error": _sentence(fit["error"])}
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


def _failed(name: str, unit: Mapping[str, Any], error: Mapping[str, Any]) -> Row:
    row: Row = dict.fromkeys(_FIRST)
    return row | {
        "table": name, "path": unit["paths"][0], "member": unit.get("member"), "status": "failed",
        "error": _sentence(error), "best": False, "version": __version__,
    }  # fmt: skip


def _sentence(error: Mapping[str, Any]) -> str:
    place = ", ".join(f"{key} {error[key]}" for key in ("file", "row", "column", "parameter") if key in error)
    return f"{place}: {error['message']}" if place else str(error["message"])


def _csv(rows: Sequence[Row], columns: Sequence[str]) -> bytes:
    stream = io.StringIO(newline="")
    writer = csv.DictWriter(stream, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue().encode()


def _parquet(rows: Sequence[Row], columns: Sequence[str]) -> bytes:
    import pyarrow as pa
    from pyarrow import parquet

    text = {
        "table", "model", "status", "error", "metric", "posterior", "format", "path", "member", "folder",
        "sha256", "hash", "version",
    }  # fmt: skip
    kinds = {"best": pa.bool_(), "samples": pa.int64(), "usable": pa.int64(), "seed": pa.int64()}
    kinds |= dict.fromkeys(text, pa.string())
    schema = pa.schema([(name, kinds.get(name, pa.float64())) for name in columns])
    stream = io.BytesIO()
    parquet.write_table(pa.Table.from_pylist([dict(row) for row in rows], schema), stream)
    return stream.getvalue()
