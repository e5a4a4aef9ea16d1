"""``brdf-fitter export``: write a fitted model or a table as a file that another program opens."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from fitter.cli import reading
from fitter.cli.screen import Screen, number
from fitter.cli.values import names, output_file
from fitter.cli.verb import Outcome, Verb

if TYPE_CHECKING:
    from fitter.export import Subject


def configure(parser: argparse.ArgumentParser) -> None:
    from fitter.export.registry import targets

    parser.add_argument(
        "source", metavar="RESULT.json|TABLE",
        help="what `fit --out` wrote, a model's document, or a measured table of any format",
    )  # fmt: skip
    parser.add_argument(
        "--to", required=True, choices=[entry.name for entry in targets()], metavar="TARGET",
        help="; ".join(f"{entry.name}: {entry.description}" for entry in targets()),
    )  # fmt: skip
    parser.add_argument("--out", required=True, metavar="PATH", help="the file, or new folder, to write")
    parser.add_argument("--model", metavar="NAME", help="which fit, of a file that holds several")
    parser.add_argument("--name", help="the material's name in the file (default: the table's)")
    parser.add_argument("--channels", type=names, metavar="NAME,...", help="only these channels")
    parser.add_argument(
        "--unconverged", action="store_true", help="also export a fit that did not converge, and say so"
    )
    reading.add_reading_options(parser)


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.export import target, write

    chosen = target(given.to)
    out = output_file(given.out) if chosen.suffix else Path(given.out)
    source = _source(given, screen)
    told = write(source, given.to, out, channels=given.channels, unconverged=given.unconverged)

    def show(screen: Screen) -> None:
        screen.line(f"{told.path}: {told.name}, as {told.target} ({told.convention})")
        for note in told.notes:
            screen.line(f"- {note.message}")
        if told.residuals:
            refit, ours = told.residuals["refit"], told.residuals["ours"]
            screen.line(
                f"  refit as {told.residuals['model']}: relative rms {number(refit)} from the source"
                + ("" if ours is None else f"; our fit is {number(ours)} from the table")
            )

    return Outcome(told.to_dict(), show)


def _source(given: argparse.Namespace, screen: Screen) -> Subject:
    from fitter.cli.numerics import start_numerics
    from fitter.export import subject

    start_numerics(screen)
    if not _is_json(given.source):
        opened = reading.open_table(given.source, reading.reading_options(given))
        return subject(opened.table, name=given.name)
    from fitter import models
    from fitter.cli.results import load_result
    from fitter.documents import read_document

    document = read_document(Path(given.source), "not-a-fit")
    if "kind" not in document and "spec" in document:
        return subject(models.from_dict(document), name=given.name)
    return subject(load_result(given.source, given.model), name=given.name)


def _is_json(path: str) -> bool:
    """Whether a file is a JSON object, by its first character: no table's format begins so."""
    try:
        with Path(path).open("rb") as file:
            return file.read(64).lstrip()[:1] == b"{"
    except OSError:
        return False  # whoever reads it as a table says what is wrong with it


VERB = Verb("write a model or a table as a file of a renderer or another program", configure, run)
