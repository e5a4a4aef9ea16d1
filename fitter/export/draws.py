"""Draws of a posterior as a set of materials: rendered one after another they show what is uncertain."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fitter.documents import write_document
from fitter.errors import SpecError
from fitter.export.registry import target
from fitter.export.subject import only, subject
from fitter.export.writing import Exported, check, doubts
from fitter.formats.registry import Loss

if TYPE_CHECKING:
    from fitter.posterior import Posterior

KIND = "brdf-fitter/exported-draws"
#: So many materials are written at most.
MOST = 1000


def write_draws(
    posterior: Posterior, to: str, folder: str | os.PathLike[str], count: int, *, name: str | None = None,
    channels: Sequence[str] | None = None, unconverged: bool = False,
) -> Exported:  # fmt: skip
    """Write ``count`` draws, evenly spaced through the posterior's, each as a file of ``folder``.

    ``folder/draws.json`` lists the files with the values of their parameters and notes. The folder must be
    new or empty. ``to``, ``channels`` and ``unconverged`` are those of :func:`fitter.export.write`.

    Raises SpecError as that does, and for a count that is not between 1 and the number of draws (or 1000).
    """
    entry, where = target(to), Path(folder)
    most = min(MOST, len(posterior.draws))
    if not 1 <= count <= most:
        raise SpecError(
            f"{count} draws were asked for, and there are {len(posterior.draws)}", code="bad-count",
            parameter="draws", remedy=f"give a number from 1 to {most}",
        )  # fmt: skip
    notes = doubts("posterior", posterior.status, posterior.message, unconverged)
    measured = str(posterior.table.get("name", "")) or "table"
    title = name or f"{measured} as {posterior.template.spec.name}"
    materials = [
        subject(model, name=f"{title}, draw {k}") for k, model in enumerate(posterior.models(count), 1)
    ]
    if channels is not None:
        materials = [only(one, channels) for one in materials]
    check(materials[0], entry)
    if where.exists() and (not where.is_dir() or any(where.iterdir())):
        raise SpecError(
            "there is something there already", code="out-not-writable", file=str(where), parameter="out",
            remedy="name a new or empty folder",
        )  # fmt: skip
    where.mkdir(parents=True, exist_ok=True)
    listed: list[dict[str, Any]] = []
    found: dict[str, Loss] = {}
    for k, one in enumerate(materials, 1):
        file = f"draw_{k:04d}{entry.suffix}"
        remark = f"Draw {k} of {count} of the posterior of {measured}."
        written = entry.write(replace(one, remark=remark), where / file)
        assert one.model is not None
        values = {key: np.asarray(value).tolist() for key, value in one.model.values.items()}
        said = [{"code": note.code, "message": note.message} for note in written.notes]
        listed.append({"file": file, "values": values, "notes": said, "residuals": written.residuals})
        for note in written.notes:
            found.setdefault(note.code, Loss(note.code, f"Of the first draw: {note.message}"))
    document = {"kind": KIND, "version": 1, "to": to, "table": posterior.table, "draws": listed}
    write_document(document, where / "draws.json")
    return Exported(to, where, title, entry.convention, (*notes, *found.values()), {})
