"""The index of a batch: one line a table, the worst first, for a reader to sort and filter."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote

from jinja2 import Environment, PackageLoader

from fitter.batch.pictures import PICTURE

#: Lines that the page has at most: a browser sorts so many at once. The summary has all.
MOST = 2_000


class Index:
    """The page, as the records of the units come one after another; it keeps no more than it shows.

    reports : whether there is a report about each table.
    """

    def __init__(self, reports: bool, most: int = MOST) -> None:
        self._reports = reports
        self._most = most
        self._lines: list[dict[str, Any]] = []
        self._counts: dict[str, int] = {}

    def add(self, record: Mapping[str, Any]) -> None:
        """The tables of a unit, or why it has none."""
        lines = [_line(table) for table in record["tables"]]
        if record["error"]:
            lines.append(
                {"table": record["unit"]["name"], "status": "failed", "error": sentence(record["error"])}
            )
        for line in lines:
            self._counts[line["status"]] = self._counts.get(line["status"], 0) + 1
        self._lines += lines
        if len(self._lines) > 2 * self._most:
            self._worst()

    def render(self) -> str:
        """HTML. Its links are relative: the folder can be moved."""
        self._worst()
        environment = Environment(loader=PackageLoader("fitter.batch", "."), autoescape=True)
        total = sum(self._counts.values())
        return environment.get_template("index.html.j2").render(
            lines=self._lines, counts=dict(sorted(self._counts.items())), total=total, reports=self._reports
        )

    def _worst(self) -> None:
        self._lines = sorted(self._lines, key=_badness, reverse=True)[: self._most]


def sentence(error: Mapping[str, Any]) -> str:
    """An error's document in a line: where, and what."""
    place = ", ".join(f"{key} {error[key]}" for key in ("file", "row", "column", "parameter") if key in error)
    return f"{place}: {error['message']}" if place else str(error["message"])


def _badness(line: Mapping[str, Any]) -> tuple[int, float]:
    """What failed, what did not converge or is not identified, then by the relative residual."""
    rank = {"failed": 2, "converged": 0}.get(line["status"], 1)
    relative = line.get("relative")
    return rank, math.inf if relative is None else relative


def _line(table: Mapping[str, Any]) -> dict[str, Any]:
    fits = [fit for fit in table["fits"] if "error" not in fit]
    chosen = next((fit for fit in fits if fit["model"] == table.get("best")), None)
    folder = quote(table["folder"])
    line: dict[str, Any] = {"table": table["table"]}
    if chosen is None:
        errors = "; ".join(f"{fit['model']}: {sentence(fit['error'])}" for fit in table["fits"])
        return line | {"status": "failed", "error": errors}
    notes = [*chosen["warnings"], *(note.get("note") or note["error"]["message"] for note in table["notes"])]
    return line | {
        "status": chosen["status"].replace("_", " "), "model": chosen["model"],
        "fits": ", ".join(_tried(fit) for fit in table["fits"]),
        "rmse": chosen["metrics"]["rmse"], "relative": chosen["metrics"]["relative_rmse"],
        "samples": table["usable"], "seconds": table["seconds"], "notes": notes,
        "folder": folder, "fit": f"{folder}/{quote(chosen['file'])}", "picture": f"{folder}/{PICTURE}",
    }  # fmt: skip


def _tried(fit: Mapping[str, Any]) -> str:
    if "error" in fit:
        return f"{fit['model']} (failed)"
    relative = fit["metrics"]["relative_rmse"]
    return fit["model"] if relative is None else f"{fit['model']} {100 * relative:.3g} %"
