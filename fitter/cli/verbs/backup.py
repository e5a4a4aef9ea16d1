"""``brdf-fitter backup``: a consistent copy of a service's folder, while it runs."""

from __future__ import annotations

import argparse
from pathlib import Path

from fitter.cli.screen import Screen
from fitter.cli.verb import Outcome, Verb
from fitter.cli.verbs.db import database, place


def configure(parser: argparse.ArgumentParser) -> None:
    place(parser)
    parser.add_argument("--out", required=True, metavar="DIR", help="a new folder for the copy")


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    del screen
    # The service lives above the library; only verbs about it may import it.
    from api.settings import Settings
    from api.upkeep import backup

    settings = Settings(folder=Path(given.folder), database_url=database(given), storage=given.storage)
    copied = backup(settings.place, Path(given.out))
    said = f"{given.out}: the database, {copied['blobs']} blobs, {copied['results']} results"
    document = {"kind": "brdf-fitter/backup", "folder": given.out, "copied": copied}
    return Outcome(document, lambda screen: screen.line(said))


VERB = Verb("copy a service's database, uploads and results, while it runs", configure, run)
