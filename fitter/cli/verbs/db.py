"""``brdf-fitter db``: the service's database, brought to the rows of this version."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from fitter.cli.screen import Screen
from fitter.cli.values import output_folder
from fitter.cli.verb import Outcome, Verb

#: Holds the database's address where it should not stand in a list of processes.
DATABASE = "BRDF_FITTER_DATABASE"


def place(parser: argparse.ArgumentParser) -> None:
    """Options that say where a service keeps its data."""
    parser.add_argument(
        "--folder", default="brdf-fitter-data", metavar="DIR",
        help="where tables, results and the database are kept (default: brdf-fitter-data)",
    )  # fmt: skip
    parser.add_argument(
        "--database", metavar="URL",
        help=f"postgresql://user:password@host/name, for several servers (default: ${DATABASE}, else SQLite "
        "in the folder)",
    )  # fmt: skip

    parser.add_argument(
        "--storage", metavar="URL",
        help="where uploads and results are kept instead of the folder: any that fsspec knows, as s3://bucket/x",
    )  # fmt: skip


def database(given: argparse.Namespace) -> str | None:
    """The database that was named, None for the one in the folder."""
    return given.database or os.environ.get(DATABASE) or None


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "action", choices=("upgrade", "show"),
        help="upgrade the database to this version's rows, or show which revision it is at",
    )  # fmt: skip
    place(parser)


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    del screen
    url, folder = database(given), given.folder
    if url is None:
        folder = output_folder(folder, "folder")
    # The service lives above the library; only verbs about it may import it.
    from api import migrations
    from api.database import open_engine
    from api.settings import Settings

    engine = open_engine(Settings(folder=Path(folder), database_url=url).url)
    try:
        before = migrations.current(engine)
        if given.action == "upgrade":
            migrations.upgrade(engine)
        after = migrations.current(engine)
    finally:
        engine.dispose()
    document = {
        "kind": "brdf-fitter/database-revision", "before": before, "revision": after,
        "needed": migrations.head(),
    }  # fmt: skip

    def show(screen: Screen) -> None:
        screen.fields({"was at": before or "empty", "is at": after or "empty", "needed": migrations.head()})

    return Outcome(document, show)


VERB = Verb("upgrade the service's database to this version", configure, run)
