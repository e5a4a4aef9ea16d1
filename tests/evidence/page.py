"""The figures of a run in Markdown, for a terminal and for docs/evidence.md."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any


def head() -> list[str]:
    """What the page is."""
    return [
        "# Evidence",
        "",
        "The long studies of the models and the formats, as `make evidence` runs them. The same figures with",
        "every setting are in [evidence.json](evidence.json); the studies are in `tests/evidence`.",
    ]


def lines(document: Mapping[str, Any]) -> list[str]:
    """For each study where, when and with what it was run, a table, and what broke its bound."""
    found: list[str] = []
    for study in document["studies"]:
        found += ["", f"## {study['title']}", "", f"{study['claim']}.", "", *table(study), *_skipped(study)]
        for row in study["rows"]:
            found += [f"- {row['model']}: {_sentence(one)}" for one in row["violations"]]
        found += [*_run(study["run"]), ""]
    return found


def _run(run: Mapping[str, Any]) -> list[str]:
    machine = run["machine"]
    commit = str(run["commit"] or "unknown")[:12]
    changed = ", with uncommitted changes" if run["uncommitted_changes"] else ""
    listed = ", ".join(f"{name} {version}" for name, version in run["versions"].items())
    return [
        f"Run {run['created'][:10]} on {machine['cpu']}, {machine['cores']} cores, "
        f"{machine['memory_gb']} GB, {machine['system']}; seed {run['seed']}, share {run['share']:g}, "
        f"{run['seconds']:.0f} s with the studies run together. Commit {commit}{changed}; {listed}.",
    ]


def table(study: Mapping[str, Any]) -> list[str]:
    """One line for each model."""
    columns: Sequence[str] = study["columns"]
    found = [
        f"| {study.get('subject', 'model')} | {' | '.join(columns)} | violations | s |",
        f"|---|{'---|' * len(columns)}---|---|",
    ]
    for row in study["rows"]:
        cells = [_figure(row["figures"].get(column)) for column in columns]
        shown = " | ".join([*cells, str(len(row["violations"]) or ""), f"{row['seconds']:.0f}"])
        found.append(f"| {row['model']} | {shown} |")
    return found


def _skipped(study: Mapping[str, Any]) -> list[str]:
    if not study["skipped"]:
        return [""]
    return [
        "",
        "Not asked: " + "; ".join(f"{name} ({why})" for name, why in study["skipped"].items()) + ".",
        "",
    ]


def _figure(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.3g}" if math.isfinite(value) else "not finite"
    return f"{value:,}" if isinstance(value, int) else str(value)


def _sentence(one: Mapping[str, Any]) -> str:
    rest = ", ".join(f"{name} {value}" for name, value in one.items() if name != "what")
    return f"{one['what']}{': ' if rest else ''}{rest}"
