"""``brdf-fitter compress``: make a table smaller within a stated error bound."""

from __future__ import annotations

import argparse

from fitter.cli import reading
from fitter.cli.screen import Screen, file_size, number
from fitter.cli.values import output_file
from fitter.cli.verb import Outcome, Verb


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("table", metavar="TABLE", help="a measured table")
    parser.add_argument(
        "--tolerance", type=float, required=True, metavar="T",
        help="guaranteed: |error| <= T (|f| + 1 %% of the channel's median |f|); 0 keeps every bit",
    )  # fmt: skip
    parser.add_argument("--out", required=True, metavar="FILE", help="the compressed table to write")
    reading.add_reading_options(parser)


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.compression import compress

    out = output_file(given.out)
    opened = reading.open_table(given.table, reading.reading_options(given))
    small = compress(opened.table, given.tolerance)
    small.save(out)
    document = {
        "kind": "brdf-fitter/compressed",
        "path": str(out),
        "bytes": small.nbytes,
        "ratio": small.ratio,
        "tolerance": small.tolerance,
        "floor": small.floor.tolist(),
        "worst_error": small.worst_error,
        "samples": len(opened.table),
        "hash": small.source_hash,
    }

    def show(screen: Screen) -> None:
        screen.fields(
            {
                "written": str(out),
                "size": f"{file_size(small.nbytes)}, values as float64 {number(small.ratio, 3)} times that",
                "bound": f"|error| <= {number(small.tolerance)} (|f| + floor), floor 1 % of the median |f|",
                "worst error": f"{number(small.worst_error, 3)} of the bound",
            }
        )

    return Outcome(document, show)


VERB = Verb("make a table smaller within a guaranteed error bound", configure, run)
