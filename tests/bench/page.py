"""The table of a benchmark document, for a terminal and for a documentation page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

BEGIN, END = "<!-- begin: python -m tests.bench --markdown -->", "<!-- end -->"


def lines(document: Mapping[str, Any]) -> list[str]:
    """Of each run where, when and with what, then its table in Markdown."""
    found: list[str] = []
    for run in document["runs"]:
        found += ["", *_of_run(run)]
    return found[1:]


def _of_run(run: Mapping[str, Any]) -> list[str]:
    machine, versions, load = run["machine"], run["versions"], run["load_average"]
    loads = "unknown" if load[0] is None else f"{load[0]:.1f} at the start, {load[1]:.1f} at the end"
    commit = str(run["commit"] or "unknown")[:12]
    changed = ", with uncommitted changes" if run["uncommitted_changes"] else ""
    listed = ", ".join(f"{name} {version}" for name, version in versions.items())
    return [
        f"Measured {run['created'][:10]} on {machine['cpu']}, {machine['cores']} cores, "
        f"{machine['memory_gb']} GB, {machine['system']}; load average {loads}; "
        f"{run['seconds']:.0f} s in all{', quick sizes' if run['quick'] else ''}.",
        "",
        f"Commit {commit}{changed}. {listed}.",
        "",
        *table(run["rows"]),
    ]


def table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """One line for each alternative: its figure, ours, and how many times better or worse ours is."""
    found = [
        "| what | ours (lowest to highest) | instead | its figure | ours is | in processor time |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        if not row["others"]:
            found.append(f"| {row['case']} | {_figure(row['ours'])} | | | | |")
        for k, other in enumerate(row["others"]):
            cpu = other.get("cpu_advantage")
            cells = [
                "" if k else row["case"], "" if k else _figure(row["ours"]), other["name"], _figure(other),
                _compared(other["advantage"]), "" if cpu is None else _compared(cpu),
            ]  # fmt: skip
            found.append(f"| {' | '.join(cells)} |")
    return found


def insert(page: str, document: Mapping[str, Any]) -> str:
    """The page with what stands between its two marks replaced by the document's table."""
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"the page needs the marks {BEGIN} and {END}")
    return "\n".join([before + begin, "", *lines(document), "", end + after])


def number(value: float) -> str:
    """Three significant digits, or whole from 100."""
    if value >= 99.95:
        return f"{value:,.0f}"
    return f"{value:.3g}"


def _compared(advantage: float) -> str:
    return f"{number(advantage)} x better" if advantage >= 1.0 else f"{number(1.0 / advantage)} x worse"


def _figure(figure: Mapping[str, Any]) -> str:
    shown, lowest, highest = (
        _with_unit(figure[name], figure["unit"]) for name in ("median", "lowest", "highest")
    )
    return shown if figure["repeats"] == 1 else f"{shown} ({lowest} to {highest})"


def _with_unit(value: float, unit: str) -> str:
    if unit == "s":
        return f"{number(value)} s" if value >= 1.0 else f"{number(1e3 * value)} ms"
    if unit == "1/s":
        return f"{number(value * 1e-6)} M/s" if value >= 1e6 else f"{number(value)} /s"
    return number(value)
