"""``brdf-fitter compress``: make a table smaller within a stated error bound."""

from __future__ import annotations

import argparse
from typing import Literal

from fitter.cli import reading
from fitter.cli.screen import Screen, file_size, number
from fitter.cli.values import named_number, output_file
from fitter.cli.verb import Outcome, Verb


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("table", metavar="TABLE", help="a measured table")
    parser.add_argument(
        "--tolerance", type=_tolerance, required=True, metavar="T",
        help="guaranteed: |error| <= T (|f| + floor); 0 keeps every bit; noise: the bound is one standard "
        "deviation of the table's own noise",
    )  # fmt: skip
    parser.add_argument(
        "--floor", action="append", type=named_number, metavar="CHANNEL=F",
        help="the floor of a channel in 1/sr (repeatable; default: 1 %% of the channel's median |f|, with "
        "--tolerance noise what the noise says)",
    )  # fmt: skip
    parser.add_argument("--out", required=True, metavar="FILE", help="the compressed table to write")
    reading.add_reading_options(parser)


def _tolerance(text: str) -> float | Literal["noise"]:
    return "noise" if text == "noise" else float(text)


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.compression import compress

    out = output_file(given.out)
    opened = reading.open_table(given.table, reading.reading_options(given))
    small = compress(opened.table, given.tolerance, floor=dict(given.floor) if given.floor else None)
    small.save(out)
    document = {
        "kind": "brdf-fitter/compressed", "path": str(out), "samples": len(opened.table), **small.describe()
    }  # fmt: skip

    def show(screen: Screen) -> None:
        floors = ", ".join(
            f"{channel.name} {number(floor, 3)}"
            for channel, floor in zip(opened.table.channels, small.floor, strict=True)
        )
        exact = small.tolerance == 0
        bound = f"|error| <= {number(small.tolerance)} (|f| + floor), floor in 1/sr: {floors}"
        worst, rms = number(small.worst_error, 3), number(float(small.rms_error.max()), 3)
        mean = number(float(abs(small.mean_error).max()), 2)
        made = f"worst {worst}, rms {rms}, mean at most {mean} of the bound"
        size, values = file_size(small.nbytes), file_size(small.value_bytes)
        screen.fields(
            {
                "written": str(out),
                "size": f"{size}, {values} of them values; as float64 those are {number(small.ratio, 3)} "
                "times the file",
                "bound": "every bit is kept" if exact else bound,
                **({} if exact else {"errors": made}),
            }
        )

    return Outcome(document, show)


VERB = Verb("make a table smaller within a guaranteed error bound", configure, run)
