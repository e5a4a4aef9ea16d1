"""Tables of a service for a batch: their bytes, into files of this machine."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from api.client import Client
from fitter.batch import SERVER, BatchSpec, Fetched
from fitter.cli.screen import Screen
from fitter.cli.values import output_folder
from fitter.documents import file_stem
from fitter.errors import FitError, SpecError
from fitter.formats import read_options
from fitter.formats.output import write_aside

#: How a table is named on a service.
ID = re.compile("[0-9a-f]{32}")


def fetched(client: Client, spec: BatchSpec, folder: Path, screen: Screen) -> dict[str, Fetched]:
    """Every table ``server:ID`` of a batch, by that word; its file in ``folder`` is named by its id. What is
    there already is not fetched again.

    Raises SpecError: no such table, a folder that can't be written. FitError: other bytes came than those
    uploaded.
    """
    ids = {word: _id(word) for word in spec.tables if word.startswith(SERVER)}
    # All are known before the first one is fetched.
    found = {word: client.table(id) for word, id in ids.items()}
    stems = {word: Path(one.name).stem for word, one in found.items()}
    often = Counter(file_stem(stem).casefold() for stem in stems.values())
    if found:
        output_folder(str(folder))
    tables: dict[str, Fetched] = {}
    with screen.progress("fetching tables") as progress:
        for k, (word, one) in enumerate(found.items()):
            progress(k / len(found), one.name)
            # The id that was asked for: what a service says of itself names no file here.
            path = folder / ids[word]
            if not path.exists() or _digest(path) != one.sha256:
                write_aside(path, _checked(client, ids[word], one.sha256))
            alone = often[file_stem(stems[word]).casefold()] == 1
            name = stems[word] if alone else f"{stems[word]}-{ids[word][:8]}"
            reading = {key: item for key, item in one.options.items() if key != "name"}
            tables[word] = Fetched(path, name, read_options(reading).to_dict())
    return tables


def _id(word: str) -> str:
    found = word.removeprefix(SERVER)
    if not ID.fullmatch(found):
        raise SpecError(
            f"{found!r} is no id of a service's table", code="bad-call", parameter="tables",
            remedy=f"an id is 32 hexadecimal digits; {SERVER}ID names a table, and a path a file",
        )  # fmt: skip
    return found


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _checked(client: Client, id: str, sha256: str) -> Iterator[bytes]:
    """The content; what writes it aside gives up where it is not what was uploaded."""
    digest = hashlib.sha256()
    for piece in client.content(id):
        digest.update(piece)
        yield piece
    if digest.hexdigest() != sha256:
        raise FitError(
            f"other bytes came than those uploaded as {id}", code="fetch-damaged",
            cause="a storage or a proxy that changes them", remedy="ask whoever runs the service",
        )  # fmt: skip
