"""``brdf-fitter convert``: write a table in another format, and say what that format does not hold."""

from __future__ import annotations

import argparse
from pathlib import Path

from fitter.cli import reading
from fitter.cli.screen import Screen
from fitter.cli.values import output_file
from fitter.cli.verb import Outcome, Verb


def configure(parser: argparse.ArgumentParser) -> None:
    from fitter.formats import formats

    writable = [entry.name for entry in formats() if entry.write is not None]
    parser.add_argument("table", metavar="TABLE", help="a measured table, of any format")
    parser.add_argument("--format", required=True, choices=writable, help="the format to write")
    parser.add_argument(
        "--out", required=True, metavar="PATH", help="the file to write (pab-opto: a new folder)"
    )
    reading.add_reading_options(parser)


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.formats import write

    out = Path(given.out) if given.format == "pab-opto" else output_file(given.out)
    table = reading.open_table(given.table, reading.reading_options(given)).table
    losses = write(table, out, given.format)
    document = {
        "kind": "brdf-fitter/converted", "path": str(out), "format": given.format, "samples": len(table),
        "hash": table.hash, "lost": [{"code": loss.code, "message": loss.message} for loss in losses],
    }  # fmt: skip

    def show(screen: Screen) -> None:
        screen.line(f"{out}: {len(table):,} samples as {given.format}")
        for loss in losses:
            screen.line(f"- {loss.message}")

    return Outcome(document, show)


VERB = Verb("write a table in another format", configure, run)
