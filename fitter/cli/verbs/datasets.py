"""``brdf-fitter datasets``: the sample tables that ship with the product, and the public databases."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from fitter.cli.screen import Screen, file_size
from fitter.cli.values import output_file, output_folder
from fitter.cli.verb import Outcome, Verb
from fitter.errors import SpecError

if TYPE_CHECKING:
    from fitter.databases import Database

_UNKNOWN = "not verified"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "action", nargs="?", choices=("list", "copy", "get"), default="list",
        help="list what there is (the default), copy sample tables to where you work, or get files of a "
        "public database from its server",
    )  # fmt: skip
    parser.add_argument(
        "name", nargs="*", metavar="NAME",
        help="list: a database; copy: which tables; get: a database, then which of its items",
    )  # fmt: skip
    parser.add_argument("--all", action="store_true", help="get: all items of the database")
    parser.add_argument(
        "--from", dest="source", metavar="ADDRESS",
        help="get: another place to fetch from: an address with {item}, or that of the folder of the files",
    )  # fmt: skip
    parser.add_argument(
        "--out", default=".", metavar="DIR", help="copy, get: into this folder (default: the current one)"
    )


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    if given.action == "copy":
        return _copy(given.name, given.out)
    if given.action == "get":
        return _get(given, screen)
    if len(given.name) > 1:
        raise SpecError(
            f"list takes one database at most ({', '.join(given.name)})", code="bad-call", parameter="name",
            remedy="use `datasets list DATABASE`, or `datasets copy NAME`",
        )  # fmt: skip
    return _describe(given.name[0]) if given.name else _list()


def _list() -> Outcome:
    from fitter import datasets

    found = [
        {"name": name, "description": description, "path": str(datasets.sample(name))}
        for name, description in datasets.samples().items()
    ]
    public = [_summary(one) for one in datasets.databases().values()]

    def show(screen: Screen) -> None:
        screen.line("sample tables (datasets copy NAME)")
        screen.fields({f"  {one['name']}": str(one["description"]) for one in found})
        screen.line()
        screen.line("public databases (datasets list NAME, datasets get NAME ITEM)")
        screen.fields({f"  {one['name']}": one["holds"] for one in public})

    return Outcome({"kind": "brdf-fitter/datasets", "datasets": found, "databases": public}, show)


def _summary(one: Database) -> dict[str, Any]:
    kept = ("name", "title", "holds", "format", "licence", "licence_note", "citation", "homepage")
    return {key: getattr(one, key) for key in kept} | {"items": len(one.items), "direct": one.url is not None}


def _describe(name: str) -> Outcome:
    from fitter.databases import database

    one = database(name)

    def show(screen: Screen) -> None:
        licence = one.licence or _UNKNOWN
        screen.fields({
            "title": one.title, "holds": one.holds, "format": one.format,
            "licence": f"{licence} ({one.licence_note})" if one.licence_note else licence,
            "citation": one.citation, "homepage": one.homepage,
            "address": one.url or "none known: by hand from the homepage",
            "bytes a file": _UNKNOWN if one.size_bytes is None else f"{one.size_bytes:,}",
            "sha256": f"known of {len(one.sha256)} files" if one.sha256 else "not known",
            "not verified": one.not_verified,
        })  # fmt: skip
        if one.items:
            screen.line()
            screen.line(" ".join(one.items))

    return Outcome({"kind": "brdf-fitter/database", **one.to_dict()}, show)


def _copy(names: list[str], folder: str) -> Outcome:
    from fitter import datasets
    from fitter.documents import write_bytes

    if not names:
        raise SpecError(
            "no table is named", code="bad-call", parameter="name",
            remedy=f"name some of {', '.join(datasets.samples())}",
        )  # fmt: skip
    sources = [datasets.sample(name) for name in names]
    targets = [output_file(f"{folder}/{source.name}") for source in sources]
    for source, target in zip(sources, targets, strict=True):
        write_bytes(source.read_bytes(), target)
    document = {"kind": "brdf-fitter/datasets-copied", "paths": [str(target) for target in targets]}
    return Outcome(document, lambda screen: screen.line("\n".join(str(target) for target in targets)))


def _get(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.databases import database, databases, get

    if not given.name:
        raise SpecError(
            "no database is named", code="bad-call", parameter="name",
            remedy=f"name one of {', '.join(databases())}, and which of its items",
        )  # fmt: skip
    name, *items = given.name
    one = database(name)
    if given.all:
        items = list(one.items)
    if not items:
        raise SpecError(
            f"no item of {name} is named", code="bad-call", parameter="name",
            remedy=f"`datasets list {name}` shows them; --all gets all that are known",
        )  # fmt: skip
    folder = output_folder(given.out)
    with screen.progress(f"{name}") as progress:
        found = get(name, items, folder, source=given.source, progress=progress)
    terms = one.licence or one.licence_note or "not verified, look at the homepage"
    document = {
        "kind": "brdf-fitter/datasets-fetched", "database": name, "licence": one.licence,
        "licence_note": one.licence_note, "citation": one.citation, "homepage": one.homepage,
        "files": [{**vars(file), "path": str(file.path)} for file in found],
    }  # fmt: skip

    def show(screen: Screen) -> None:
        for file in found:
            how = f"checked by {file.checked}" if file.checked else "nothing is known to check it by"
            there = "" if file.downloaded else ", was there already"
            screen.line(f"{file.path}  {file_size(file.size)}, {how}{there}")
        screen.line(f"licence: {terms}")
        screen.line(f"cite: {one.citation}")

    return Outcome(document, show)


VERB = Verb("list sample tables and public databases, copy the ones, get the others", configure, run)
