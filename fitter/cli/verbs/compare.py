"""``brdf-fitter compare``: what two batches, or two fits, differ in beyond their uncertainties."""

from __future__ import annotations

import argparse

from fitter.cli.screen import Screen, number
from fitter.cli.verb import Outcome, Verb


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("a", metavar="A", help="a folder that `batch` wrote, or a file of fits")
    parser.add_argument("b", metavar="B", help="another of the same kind")
    parser.add_argument(
        "--coverage", type=float, default=2.0, metavar="K",
        help="list differences of more than K standard uncertainties (default: 2)",
    )  # fmt: skip


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.batch import compare

    found = compare(given.a, given.b, coverage=given.coverage)

    def show(screen: Screen) -> None:
        rows = [
            [
                one["table"], one["model"], one["what"], number(one["a"]), number(one["b"]),
                number(one.get("score"), 3),
            ]
            for one in found.changed
        ]  # fmt: skip
        if rows:
            screen.table(("table", "model", "what", "A", "B", "standard uncertainties"), rows)
        for name, only in (("A", found.only_a), ("B", found.only_b)):
            for table, model in only:
                screen.line(f"only in {name}: {' '.join(word for word in (table, model) if word)}")
        screen.line(
            f"{found.compared} fits compared, {found.parameters} parameters: {len(rows)} differences beyond "
            f"{given.coverage:g} standard uncertainties, or 1 % of a metric"
        )

    return Outcome(found.to_dict(), show)


VERB = Verb("compare two batches, or two fits", configure, run)
