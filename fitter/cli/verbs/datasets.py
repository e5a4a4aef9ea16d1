"""``brdf-fitter datasets``: the sample tables that ship with the product."""

from __future__ import annotations

import argparse

from fitter.cli.screen import Screen
from fitter.cli.values import output_file
from fitter.cli.verb import Outcome, Verb
from fitter.errors import SpecError


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "action", nargs="?", choices=("list", "copy"), default="list",
        help="list them (the default), or copy some to where you work",
    )  # fmt: skip
    parser.add_argument("name", nargs="*", metavar="NAME", help="copy: which ones")
    parser.add_argument(
        "--out", default=".", metavar="DIR", help="copy: into this folder (default: the current one)"
    )


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter import datasets

    if given.action == "list" and given.name:
        raise SpecError(
            f"list takes no names ({', '.join(given.name)})", code="bad-call", parameter="name",
            remedy="use `datasets copy NAME`",
        )  # fmt: skip
    if given.action == "copy":
        return _copy(given.name, given.out)
    found = [
        {"name": name, "description": description, "path": str(datasets.sample(name))}
        for name, description in datasets.samples().items()
    ]

    def show(screen: Screen) -> None:
        screen.fields({one["name"]: one["description"] for one in found})

    return Outcome({"kind": "brdf-fitter/datasets", "datasets": found}, show)


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


VERB = Verb("list the sample tables that ship with the product, or copy them", configure, run)
