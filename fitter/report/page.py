"""The page of a report: a Jinja2 template over its record."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from fitter.report import figures, figures_posterior
from fitter.report.rounding import NOT_STATED, percent, significant

#: Longest list that a table of facts writes out.
LONGEST_LIST = 12


def render(record: Mapping[str, Any]) -> str:
    """One HTML document; every text in it is escaped."""
    posterior = record["posterior"]
    return (
        _environment()
        .get_template("report.html.j2")
        .render(
            r=record,
            residual_pictures=figures.residual_pictures(record),
            map_pictures=figures.map_pictures(record),
            slice_pictures=figures.slice_pictures(record),
            reflectance_picture=figures.reflectance_picture(record),
            correlation_picture=figures.correlation_picture(record),
            joint_picture=figures_posterior.joint_picture(record),
            corner_picture=None if posterior is None else figures_posterior.corner_picture(record),
            convergence_pictures=[] if posterior is None else figures_posterior.convergence_pictures(record),
        )
    )


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("fitter.report", "templates"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    for function in (number, whole, share, words, facts, pretty, source):
        environment.filters[function.__name__] = function
    return environment


def number(x: float | None, digits: int = 3) -> str:
    """A number of the record for print, "—" for None."""
    if x is None:
        return NOT_STATED
    return f"{x:,}" if isinstance(x, int) else significant(x, digits)  # counts; years have four digits


def whole(x: float | None) -> str:
    """A count that was estimated, rounded down."""
    return NOT_STATED if x is None else f"{int(x):,}"


def share(x: float | None) -> str:
    """A relative quantity of the record for print."""
    return NOT_STATED if x is None else percent(x)


def words(text: str) -> str:
    """An identifier as words."""
    return text.replace("_", " ")


def source(name: str) -> str:
    """A source of uncertainty as a heading."""
    return {"theta_i": "offset of θ_i", "theta_o": "offset of θ_o", "phi": "offset of φ"}.get(name, name)


def pretty(item: Any) -> str:
    """Indented JSON."""
    return json.dumps(item, indent=2, ensure_ascii=False)


def facts(item: Any, name: str = "") -> Iterator[tuple[str, str]]:
    """(name, text) of everything in a nested mapping: "phases: search", "2.1"."""
    if isinstance(item, Mapping):
        for key, part in item.items():
            label = str(key).replace("_", " ")
            yield from facts(part, f"{name}: {label}" if name else label)
    elif isinstance(item, list) and any(isinstance(part, Mapping) for part in item):
        for k, part in enumerate(item[:LONGEST_LIST], start=1):
            yield from facts(part, f"{name} {k}" if len(item) > 1 else name)
        if len(item) > LONGEST_LIST:
            yield name, f"and {len(item) - LONGEST_LIST} more"
    else:
        yield name, _text(item)


def _text(item: Any) -> str:
    if item is None:
        return NOT_STATED
    if isinstance(item, bool):
        return "yes" if item else "no"
    if isinstance(item, int | float):
        return number(item, 4)
    if isinstance(item, list):
        if not item:
            return "none"
        shown = ", ".join(_text(part) for part in item[:LONGEST_LIST])
        return shown if len(item) <= LONGEST_LIST else f"{shown}, and {len(item) - LONGEST_LIST} more"
    return str(item)
