"""``brdf-fitter gc``: delete what a service does not need any more."""

from __future__ import annotations

import argparse
from pathlib import Path

from fitter.cli.screen import Screen
from fitter.cli.values import output_folder
from fitter.cli.verb import Outcome, Verb
from fitter.cli.verbs.db import database, place
from fitter.errors import SpecError


def configure(parser: argparse.ArgumentParser) -> None:
    place(parser)
    parser.add_argument(
        "--keep-jobs", type=float, metavar="DAYS",
        help="forget jobs, and their events, that ended longer ago (default: forget none)",
    )  # fmt: skip
    parser.add_argument(
        "--grace", type=float, default=24.0, metavar="HOURS",
        help="files that no row names are kept this long, since work may be about to name them (default: 24)",
    )  # fmt: skip


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    del screen
    for name in ("keep_jobs", "grace"):
        value = getattr(given, name)
        if value is not None and not value >= 0:
            raise SpecError(
                f"--{name.replace('_', '-')} is {value}", code="bad-call", parameter=name,
                remedy="give 0 or more",
            )  # fmt: skip
    folder = output_folder(given.folder, "folder")
    # The service lives above the library; only verbs about it may import it.
    from api.settings import Settings
    from api.upkeep import collect

    settings = Settings(folder=Path(folder), database_url=database(given), storage=given.storage)
    gone = collect(settings.place, keep_jobs_days=given.keep_jobs, grace_seconds=3600 * given.grace)
    return Outcome(
        {"kind": "brdf-fitter/gc", "deleted": gone},
        lambda screen: screen.fields({f"{name} deleted": str(count) for name, count in gone.items()}),
    )


VERB = Verb("delete files of a service that nothing names, and old jobs", configure, run)
