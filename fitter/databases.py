"""Public databases of measured BRDFs: what each holds, on which terms, and where its files are.

The catalogue is ``data/constants/databases.json``. It states what could be verified and nothing else; what
could not is None. Nothing is ever downloaded but by :func:`get`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast
from urllib.parse import quote

from fitter.datasets import data_folder
from fitter.errors import SpecError
from fitter.progress import Progress, ignore


@dataclass(frozen=True)
class Database:
    """One database.

    items : names of its materials or files, empty where they are not known here. file, url : patterns with
    ``{item}``; url None where no direct address is known. size_bytes : of every file, ``sizes_bytes`` and
    ``sha256`` of single items. licence, licence_note : None where not verified; not_verified : what else
    is not.
    """

    name: str
    title: str
    holds: str
    format: str
    items: tuple[str, ...]
    file: str
    url: str | None
    size_bytes: int | None
    sizes_bytes: Mapping[str, int]
    sha256: Mapping[str, str]
    licence: str | None
    licence_note: str | None
    citation: str
    homepage: str
    not_verified: str

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready, all of it."""
        return {**vars(self), "items": list(self.items)}

    def size(self, item: str) -> int | None:
        """Expected bytes of an item's file, None where not known."""
        return self.sizes_bytes.get(item, self.size_bytes)


@dataclass(frozen=True)
class Fetched:
    """A file that is there now. checked : by which facts: "sha256", "size" or "" (nothing is known of it)."""

    item: str
    path: Path
    size: int
    sha256: str
    checked: str
    downloaded: bool


def databases() -> dict[str, Database]:
    """Every database of the catalogue, by name. Raises SpecError where the data was not installed."""
    path = data_folder("constants", "catalogue of databases") / "databases.json"
    listed = cast("list[dict[str, Any]]", json.loads(path.read_bytes())["databases"])
    found: dict[str, Database] = {}
    for one in listed:
        one["items"] = tuple(one["items"])
        found[one["name"]] = Database(**one)
    return found


def database(name: str) -> Database:
    """The database of that name. Raises SpecError that lists the known ones."""
    known = databases()
    if name not in known:
        raise SpecError(
            f"there is no database {name!r}", code="unknown-database", parameter="name",
            remedy=f"use one of {', '.join(known)}",
        )  # fmt: skip
    return known[name]


def get(
    name: str, items: Sequence[str], folder: str | Path, *, source: str | None = None,
    progress: Progress = ignore,
) -> list[Fetched]:  # fmt: skip
    """Download the files of ``items`` of the database ``name`` into ``folder``, those that are not there yet.

    source : another place to fetch them from: an address with ``{item}``, or of the folder they are in.
    Each is resumed where an earlier download was cut off, and checked against what the catalogue knows.

    Raises
    ------
    SpecError : an unknown database or item, or no address is known.
    FitError : the download failed; what has come so far is kept for the next try.
    """
    from fitter.download import download, existing

    one = database(name)
    one = one if source is None else replace(one, url=_pattern(one, source))
    pattern = one.url
    unknown = [item for item in items if one.items and item not in one.items]
    if unknown:
        raise SpecError(
            f"{name} has no item {unknown[0]!r}", code="unknown-item", parameter="name",
            remedy=f"`brdf-fitter datasets list {name}` lists them",
        )  # fmt: skip
    if pattern is None:
        raise SpecError(
            f"no direct address of the files of {name} is known", code="no-address", parameter="name",
            cause="they are got from the database's page, by hand or on request",
            remedy=f"get them from {one.homepage}, or name a place that has them with --from",
        )  # fmt: skip
    for item in items:
        if "/" in item or item.startswith(".") or not item:
            raise SpecError(
                f"{item!r} is no name of a file", code="unknown-item", parameter="name",
                remedy="give the name alone",
            )  # fmt: skip
    found: list[Fetched] = []
    for k, item in enumerate(items):
        path = Path(folder) / one.file.replace("{item}", item)
        digest, size = one.sha256.get(item), one.size(item)

        def report(done: float, now: str, k: int = k) -> None:
            progress((k + done) / len(items), now)

        there = existing(path, sha256=digest, size=size)
        came = there or download(
            pattern.replace("{item}", quote(item)), path, sha256=digest, size=size, progress=report
        )  # fmt: skip
        checked = "sha256" if digest is not None else "size" if size is not None else ""
        found.append(Fetched(item, path, *came, checked, there is None))
    return found


def _pattern(one: Database, source: str) -> str:
    return source if "{item}" in source else f"{source.rstrip('/')}/{one.file}"
