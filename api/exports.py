"""Exports: one file of a model or a table, or a folder of them as a zip archive."""

from __future__ import annotations

import json
import tempfile
import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from anyio import to_thread
from fastapi import Query, Response

from fitter.export import Subject, target, targets, write, write_draws

if TYPE_CHECKING:
    from api.access import Mine
    from fitter.posterior import Posterior

ZIP = "application/zip"


async def in_turn(here: Mine, to: str, made: Callable[[], Response]) -> Response:
    """``made()`` in a thread. Exports that sample or fit take turns: some take a minute and 100 MB.

    Raises SpecError for an unknown target, and what ``made`` raises.
    """
    return await to_thread.run_sync(made, limiter=here.service.exports if target(to).tables else None)


def respond_export(subject: Subject, to: str, *, channels: str | None, unconverged: bool = False) -> Response:
    """The file as an attachment; what there is to tell of it as JSON in the header Export-Notes."""
    chosen = target(to)
    with tempfile.TemporaryDirectory(prefix="brdf-fitter-") as folder:
        path = Path(folder) / f"{_file_name(subject.name)}{chosen.suffix}"
        names = None if channels is None else [name.strip() for name in channels.split(",")]
        told = write(subject, to, path, channels=names, unconverged=unconverged)
        content = path.read_bytes() if path.is_file() else _zipped(path)
    name = path.name if chosen.suffix else f"{path.name}.zip"
    notes = {"notes": told.to_dict()["notes"], "residuals": told.to_dict()["residuals"]}
    return Response(
        content, media_type=media_type(to),
        headers={
            "Content-Disposition": f'attachment; filename="{name}"',
            # Headers hold ASCII only: JSON's escapes do.
            "Export-Notes": json.dumps(notes),
        },
    )  # fmt: skip


ChosenChannels = Annotated[
    str | None, Query(max_length=10_000, description="only these channels, names with commas between")
]


def media_type(to: str) -> str:
    """What the answer is called."""
    chosen = target(to)
    return chosen.media_type if chosen.suffix else ZIP


def respond_draws(
    posterior: Posterior, to: str, count: int, *, channels: str | None, unconverged: bool
) -> Response:
    """Draws of a posterior, each a file of a zip archive."""
    chosen = target(to)
    names = None if channels is None else [name.strip() for name in channels.split(",")]
    with tempfile.TemporaryDirectory(prefix="brdf-fitter-") as folder:
        told = write_draws(
            posterior, chosen.name, Path(folder), count, channels=names, unconverged=unconverged
        )
        content = _zipped(Path(folder))
    headers = {
        "Content-Disposition": 'attachment; filename="draws.zip"',
        "Export-Notes": json.dumps({"notes": told.to_dict()["notes"], "residuals": {}}),
    }
    return Response(content, media_type=ZIP, headers=headers)


_HEADER = {"description": "JSON: notes, and the residuals of a refit", "schema": {"type": "string"}}


def draws_responses() -> dict[int | str, dict[str, Any]]:
    """The 200 answer of a route that exports draws."""
    header = {"Export-Notes": _HEADER}
    return {200: {"description": "A zip archive", "content": {ZIP: {}}, "headers": header}}


def export_responses(*, tables: bool) -> dict[int | str, dict[str, Any]]:
    """The 200 answers of a route that exports tables, or models."""
    some = [entry for entry in targets() if (entry.tables if tables else entry.models)]
    content = {media_type(entry.name).partition(";")[0]: {} for entry in some}
    return {
        200: {
            "description": "The file; a folder comes as a zip archive", "content": content,
            "headers": {"Export-Notes": _HEADER},
        }
    }  # fmt: skip


def _zipped(folder: Path) -> bytes:
    sink = BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.write(path, path.relative_to(folder))
    return sink.getvalue()


def _file_name(name: str) -> str:
    """A material's name as a file's: letters, digits and a few marks."""
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "-_.") else "-" for c in name).strip("-.")
    return kept[:80] or "material"
