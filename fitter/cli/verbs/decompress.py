"""``brdf-fitter decompress``: write a compressed table as text again."""

from __future__ import annotations

import argparse

from fitter.cli import reading
from fitter.cli.screen import Screen
from fitter.cli.values import output_file
from fitter.cli.verb import Outcome, Verb


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", help="a compressed table")
    parser.add_argument("--out", required=True, metavar="TABLE.csv", help="the delimited text table to write")
    parser.add_argument(
        "--salvage", action="store_true",
        help="write what is readable of a damaged file: samples of damaged blocks are masked",
    )  # fmt: skip


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.formats import write_delimited

    out = output_file(given.out)
    small = reading.open_container(given.file, damage="keep" if given.salvage else "refuse")
    table = small.decompress()
    write_delimited(table, out)
    document = {
        "kind": "brdf-fitter/decompressed", "path": str(out), "samples": len(table),
        "usable": table.usable, "damaged": dict(small.damaged),
        "tolerance": small.tolerance, "hash": table.hash, "source_hash": small.source_hash,
    }  # fmt: skip

    def show(screen: Screen) -> None:
        screen.line(f"{out}: {len(table):,} samples, {table.usable:,} usable")
        for text in small.damaged.values():
            screen.line(f"note: {text}")

    return Outcome(document, show)


VERB = Verb("write a compressed table as text again", configure, run)
