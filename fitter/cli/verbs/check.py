"""``brdf-fitter check``: the quality of measured tables, before anything is fitted to them."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from fitter.cli import reading
from fitter.cli.screen import Screen
from fitter.cli.verb import Outcome, Verb

if TYPE_CHECKING:
    from fitter.quality import Check


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("table", metavar="TABLE", help="a file, a folder or a zip archive of measured tables")
    parser.add_argument(
        "--seed", type=int, default=0, metavar="S",
        help="of the subset that a large grid is judged by (default: %(default)s)",
    )  # fmt: skip
    reading.add_out_of_core(parser)
    reading.add_reading_options(parser)


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.errors import SpecError
    from fitter.formats import load_all
    from fitter.quality import check

    if not 0 <= given.seed < 2**63:
        raise SpecError(
            f"--seed is {given.seed}", code="bad-call", parameter="seed", remedy="give 0 to 2^63 - 1"
        )
    found: list[Check] = []
    if given.out_of_core:
        large = reading.open_large(given, given.seed, screen)
        with screen.progress("check") as report:
            report(0.0, large.metadata.name)
            found.append(check(large, seed=given.seed))
        return Outcome(found[0].to_dict(), lambda screen: show_check(found[0], screen))
    with screen.progress("check") as report:
        tables = load_all(given.table, **reading.reading_options(given).to_dict())
        for k, table in enumerate(tables):
            report(k / len(tables), table.metadata.name)
            found.append(check(table, seed=given.seed))

    def show(screen: Screen) -> None:
        for k, one in enumerate(found):
            if k:
                screen.line()
            show_check(one, screen)

    if len(found) == 1:
        return Outcome(found[0].to_dict(), show)
    return Outcome({"kind": "brdf-fitter/checks", "checks": [one.to_dict() for one in found]}, show)


def show_check(found: Check, screen: Screen) -> None:
    """The findings, the most serious first."""
    samples = f"{found.samples:,} measured samples"
    if found.looked_at < found.samples:
        samples += f", {found.looked_at:,} of them looked at (seed {found.seed})"
    screen.line(f"{found.name or 'table'}: {samples}")
    screen.line()
    # A person reads from the top: what is serious first, what could not be judged last.
    order = {"warning": 0, "notice": 1, "ok": 2, "not judged": 3}
    rows = [
        (f.verdict if f.judged else "not judged", f.name.replace("_", " "), f.sentence)
        for f in found.findings
    ]
    screen.table(("verdict", "check", "finding"), sorted(rows, key=lambda row: order[row[0]]))


VERB = Verb("judge the quality of a measured table before it is fitted", configure, run)
