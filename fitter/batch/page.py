"""The index of a batch: one line a table, for a reader to sort and filter, with small pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any
from urllib.parse import quote

from jinja2 import Environment, PackageLoader

from fitter.batch.pictures import PICTURE


def render(tables: Sequence[Mapping[str, Any]], failed: Sequence[Mapping[str, Any]]) -> str:
    """The page. Its links are relative: the folder can be moved."""
    lines = sorted((_line(table) for table in tables), key=lambda line: line["table"])
    lines += [
        {"table": row["table"], "status": "failed", "error": row["error"], "fits": ""} for row in failed
    ]
    environment = Environment(loader=PackageLoader("fitter.batch", "."), autoescape=True)
    counts: dict[str, int] = {}
    for line in lines:
        counts[line["status"]] = counts.get(line["status"], 0) + 1
    return environment.get_template("index.html.j2").render(lines=lines, counts=counts)


def _line(table: Mapping[str, Any]) -> dict[str, Any]:
    fits = [fit for fit in table["fits"] if "error" not in fit]
    chosen = next((fit for fit in fits if fit["model"] == table.get("best")), None)
    folder = quote(table["folder"])
    line: dict[str, Any] = {
        "table": table["table"], "samples": table["usable"], "channels": len(table["channels"]),
        "fits": ", ".join(_tried(fit) for fit in table["fits"]),
    }  # fmt: skip
    if chosen is None:
        errors = "; ".join(f"{fit['model']}: {fit['error']['message']}" for fit in table["fits"])
        return line | {"status": "failed", "error": errors}
    notes = [*chosen["warnings"], *(note.get("note") or note["error"]["message"] for note in table["notes"])]
    return line | {
        "status": chosen["status"].replace("_", " "), "model": chosen["model"],
        "rmse": chosen["metrics"]["rmse"], "relative": chosen["metrics"]["relative_rmse"],
        "seconds": table["seconds"], "notes": notes, "report": f"{folder}/report.html",
        "fit": f"{folder}/{quote(chosen['file'])}",
        "picture": f"{folder}/{PICTURE}",
    }  # fmt: skip


def _tried(fit: Mapping[str, Any]) -> str:
    if "error" in fit:
        return f"{fit['model']} (failed)"
    return f"{fit['model']} {100 * fit['metrics']['relative_rmse']:.3g} %"
