"""``brdf-fitter info``: what a file holds, as it was understood."""

from __future__ import annotations

import argparse
from typing import Any

from fitter.cli import reading
from fitter.cli.screen import Screen, number
from fitter.cli.verb import Outcome, Verb


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("table", metavar="TABLE", help="a file, a folder or a zip archive of measured tables")
    reading.add_reading_options(parser)


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.formats import describe, load_all

    tables = load_all(given.table, **reading.reading_options(given).to_dict())
    described: list[dict[str, Any]] = [dict(describe(table)) for table in tables]

    def show(screen: Screen) -> None:
        for k, one in enumerate(described):
            if k:
                screen.line()
            _show(one, screen)

    if len(described) == 1:
        return Outcome({"kind": "brdf-fitter/table", **described[0]}, show)
    return Outcome({"kind": "brdf-fitter/tables", "tables": described}, show)


def _show(described: dict[str, Any], screen: Screen) -> None:
    drawn = ("channels", "peaks", "notes")
    screen.fields(_flat({name: value for name, value in described.items() if name not in drawn}))
    columns = ("channel", "wavelength nm", "least 1/sr", "median 1/sr", "largest 1/sr")
    keys = ("name", "wavelength_nm", "min_per_sr", "median_per_sr", "max_per_sr")
    screen.line()
    screen.table(columns, [[number(channel[key]) for key in keys] for channel in described["channels"]])
    if described["peaks"]:
        screen.line()
        columns = ("lit from deg", "largest on the specular side", "largest on the retro side")
        sides = ("specular_side", "retro_side")
        screen.table(
            columns,
            [[number(p["theta_i_deg"]), *(_peak(p[side]) for side in sides)] for p in described["peaks"]],
        )
    if described["notes"]:
        screen.line()
        for note in described["notes"]:
            screen.line(f"- {note}")


def _peak(peak: dict[str, float] | None) -> str:
    if peak is None:
        return "not measured"
    return f"{number(peak['value_per_sr'])} at {number(peak['theta_o_deg'])} deg"


def _flat(document: dict[str, Any], prefix: str = "") -> dict[str, str]:
    """Nested mappings as dotted names; what is empty or unknown is left out."""
    fields: dict[str, str] = {}
    for name, value in document.items():
        if isinstance(value, dict):
            fields |= _flat(value, f"{prefix}{name}.")
        elif value not in (None, "", [], ()):
            fields[prefix + name.replace("_", " ")] = _text(value)
    return fields


def _text(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(_text(part) for part in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    return number(value, 6)


VERB = Verb("say what a file holds, as it was understood", configure, run)
