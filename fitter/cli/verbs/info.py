"""``brdf-fitter info``: what a file holds, as it was understood, and its picture."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitter.cli import reading
from fitter.cli.screen import Screen, number
from fitter.cli.values import output_folder
from fitter.cli.verb import Outcome, Verb

if TYPE_CHECKING:
    from fitter.errors import NoTable
    from fitter.table import Table


#: What the file's values are, for people.
_QUANTITIES = {
    "brdf": "f_r in 1/sr, without the cosine",
    "ccbrdf": "the file held f_r cos theta_o; values are divided by the cosine",
    "reflectance_factor": "the file held pi f_r; values are divided by pi",
}


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("table", metavar="TABLE", help="a file, a folder or a zip archive of measured tables")
    parser.add_argument(
        "--plot", metavar="DIR",
        help="draw every table as DIR/NAME.png: polar slices, angles covered, scattered hemispheres",
    )  # fmt: skip
    reading.add_reading_options(parser)


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.errors import NoTable
    from fitter.formats import describe, load_all
    from fitter.quality import overview

    folder = None if given.plot is None else output_folder(given.plot, "plot")
    try:
        tables = load_all(given.table, **reading.reading_options(given).to_dict())
    except NoTable as error:
        return _of_no_table(error)
    described: list[dict[str, Any]] = [{**describe(table), **overview(table)} for table in tables]
    if len(described) == 1 and reading.is_container(given.table):
        described[0]["container"] = reading.open_container(given.table).describe()
    if folder is not None:
        for one, path in zip(described, _draw(tables, folder, screen), strict=True):
            one["picture"] = str(path)

    def show(screen: Screen) -> None:
        for k, one in enumerate(described):
            if k:
                screen.line()
            show_table(one, screen)

    if len(described) == 1:
        return Outcome({"kind": "brdf-fitter/table", **described[0]}, show)
    return Outcome({"kind": "brdf-fitter/tables", "tables": described}, show)


def _of_no_table(error: NoTable) -> Outcome:
    """What a file holds that is no BRDF: its fields, and what each channel has at each incidence."""
    document = {
        "kind": "brdf-fitter/no-table", "file": error.file, **error.contents, "message": error.message
    }  # fmt: skip

    def show(screen: Screen) -> None:
        contents = dict(error.contents)
        channels: list[dict[str, Any]] = contents.pop("channels", [])
        incidences: list[float] = contents.pop("theta_i_deg", [])
        screen.fields(_flat({"file": error.file, **contents}))
        if channels:
            lists = [next(one for one in channel.values() if isinstance(one, list)) for channel in channels]
            rows = [
                [number(theta, 6), *(number(one) for one in line)]
                for theta, *line in zip(incidences, *lists, strict=True)
            ]
            screen.line()
            screen.table(("theta_i deg", *(channel["name"] for channel in channels)), rows)
        screen.line()
        screen.line(f"- {error.message}; it can't be fitted. Instead: {error.remedy}.")

    return Outcome(document, show)


def show_table(described: Mapping[str, Any], screen: Screen) -> None:
    """What a table was read as, its noise and its blind spots."""
    drawn = ("channels", "peaks", "notes", "noise", "blind_spots")
    fields = {name: value for name, value in described.items() if name not in drawn}
    fields["quantity"] = f"{described['quantity']} ({_QUANTITIES[described['quantity']]})"
    fields["grid"] = described["grid"] or "none: scattered samples"
    screen.fields(_flat(fields))
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
    screen.line()
    for sentence in (described["noise"]["sentence"], *described["blind_spots"]["sentences"]):
        screen.line(f"- {sentence}")
    if described["notes"]:
        screen.line()
        for note in described["notes"]:
            screen.line(f"- {note}")


def _draw(tables: Sequence[Table], folder: Path, screen: Screen) -> list[Path]:
    """Write the picture of each table; the files, each with a name of its own."""
    from fitter.documents import file_stem, write_bytes
    from fitter.report.portrait import portrait
    from fitter.report.portrait_figure import draw, png

    paths: list[Path] = []
    taken: set[str] = set()
    with screen.progress("drawing") as progress:
        for k, table in enumerate(tables):
            progress(k / len(tables), table.metadata.name)
            name = stem = file_stem(table.metadata.name)
            while name.lower() in taken:  # some file systems take A and a for one
                name = f"{stem}-{len(taken) + 1}"
            taken.add(name.lower())
            paths.append(folder / f"{name}.png")
            write_bytes(png(draw(portrait(table))), paths[-1])
    return paths


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
