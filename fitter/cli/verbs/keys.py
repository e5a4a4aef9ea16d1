"""``brdf-fitter keys``: who may use a service."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from fitter.cli.screen import Screen
from fitter.cli.values import output_folder
from fitter.cli.verb import Outcome, Verb
from fitter.cli.verbs.db import database, place
from fitter.errors import SpecError


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("action", choices=("create", "revoke", "list"), help="what to do")
    parser.add_argument("id", nargs="?", metavar="ID", help="which key to revoke")
    parser.add_argument("--owner", metavar="NAME", help="of a new key: whose tables and results it sees")
    parser.add_argument(
        "--scope", choices=("read", "write", "admin"), default="write",
        help="of a new key: look and evaluate, also make and delete, also see every owner's (default: write)",
    )  # fmt: skip
    parser.add_argument("--name", default="", metavar="TEXT", help="of a new key: what to call it")
    place(parser)


def guards(parser: argparse.ArgumentParser) -> None:
    """Options of a server: whom it serves, and how much."""
    parser.add_argument(
        "--keys", choices=("auto", "on", "off"), default="auto",
        help="ask for API keys: where there are any, and other addresses than this machine's need some "
        "(auto, default); always; never",
    )  # fmt: skip
    parser.add_argument(
        "--requests-per-second", type=float, default=0.0, metavar="X",
        help="of one key, or address where there are no keys (default: 0, no limit)",
    )  # fmt: skip
    parser.add_argument(
        "--burst", type=int, default=200, metavar="N", help="requests that may come at once (default: 200)"
    )


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    del screen
    if (given.action == "revoke") != (given.id is not None):
        raise SpecError(
            "an ID belongs to `keys revoke`, and `keys revoke` needs one", code="bad-call", parameter="id"
        )
    if (given.action == "create") != (given.owner is not None):
        raise SpecError(
            "--owner belongs to `keys create`, and `keys create` needs one", code="bad-call",
            parameter="owner",
        )  # fmt: skip
    url, folder = database(given), given.folder
    if url is None:
        folder = output_folder(folder, "folder")
    # The service lives above the library; only verbs about it may import it.
    from api import keys
    from api.sessions import Sessions
    from api.settings import Settings

    store = Sessions(Settings(folder=Path(folder), database_url=url).url)
    secret: str | None = None
    try:
        if given.action == "create":
            row, secret = keys.create(store, given.owner, given.scope, given.name)
            found = [keys.document(row)]
        elif given.action == "revoke":
            found = [keys.document(keys.revoke(store, given.id))]
        else:
            found = [keys.document(row) for row in keys.listed(store)]
    finally:
        store.close()
    document: dict[str, Any] = {"kind": "brdf-fitter/keys", "keys": found}
    if secret is not None:
        document["secret"] = secret

    def show(screen: Screen) -> None:
        columns = ("id", "owner", "name", "scope", "created", "revoked")
        screen.table(columns, [[one[column] or "-" for column in columns] for one in found])
        if secret is not None:
            screen.line()
            screen.line(f"secret, shown this once: {secret}")

    return Outcome(document, show)


VERB = Verb("create, revoke or list the API keys of a service", configure, run)
