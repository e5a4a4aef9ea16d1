"""Writing: one call for every target, and what has to be said of any export."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitter.errors import SpecError
from fitter.export.registry import Target, target
from fitter.export.subject import Subject, only, subject
from fitter.formats.registry import Loss

if TYPE_CHECKING:
    from fitter.compression import CompressedTable
    from fitter.fitting import FitResult
    from fitter.models import ReflectanceModel
    from fitter.table import Table

KIND = "brdf-fitter/export"


@dataclass(frozen=True)
class Exported:
    """A written file or folder, and what there is to tell of it.

    notes : what is otherwise in the file than in its source, and doubts about the source itself.
    residuals : of a refit into the target's own model, beside ours; else empty.
    """

    target: str
    path: Path
    name: str
    convention: str
    notes: tuple[Loss, ...]
    residuals: Mapping[str, Any]

    def to_dict(self) -> dict[str, Any]:
        return {
            "kind": KIND, "to": self.target, "path": str(self.path), "name": self.name,
            "convention": self.convention,
            "notes": [{"code": note.code, "message": note.message} for note in self.notes],
            "residuals": dict(self.residuals),
        }  # fmt: skip


def write(
    source: FitResult | ReflectanceModel | Table | CompressedTable | Subject, to: str,
    path: str | os.PathLike[str], *, name: str | None = None, channels: Sequence[str] | None = None,
    unconverged: bool = False,
) -> Exported:  # fmt: skip
    """Write ``source`` to ``path`` for the target ``to``, a name of :func:`fitter.export.targets`.

    channels : names of those to write, default all.
    unconverged : True also takes a fit that did not converge; the notes say so then.

    Raises
    ------
    SpecError : no such target, or one that can't hold this; a fit that did not converge.
    TableError : a table that does not cover what the target needs.
    """
    entry = target(to)
    what = subject(source, name=name)
    if channels is not None:
        what = only(what, channels)
    notes = check(what, entry, unconverged=unconverged)
    written = entry.write(what, Path(path))
    return Exported(
        entry.name, Path(path), what.name, entry.convention, (*notes, *written.notes), written.residuals
    )


def check(what: Subject, entry: Target, *, unconverged: bool = False) -> list[Loss]:
    """Doubts about the source that no target is to hide. Raises SpecError as :func:`write`."""
    if not (entry.tables if what.table is not None else entry.models):
        kind, other = ("table", "model") if what.table is not None else ("model", "table")
        raise SpecError(
            f"{entry.name} holds a {other}, and this is a {kind}", code="export-wrong-kind", parameter="to",
            remedy="fit a model to the table first" if other == "model" else "export the table itself",
        )  # fmt: skip
    names = [channel.name for channel in what.channels]
    if not entry.holds(names):
        most = " or ".join(map(str, entry.channels)) + (", or X, Y, Z" if entry.tristimulus else "")
        raise SpecError(
            f"{entry.name} holds {most} channels and this has {len(names)} ({', '.join(names)[:80]})",
            code="export-channels", parameter="channels", remedy="choose with --channels (?channels=)",
        )  # fmt: skip
    fit = what.fit
    if fit is None:
        return []
    if fit.status == "not_converged":
        if not unconverged:
            raise SpecError(
                f"the fit did not converge: {fit.message}", code="fit-not-converged", parameter="result",
                remedy="fit again with more starts; or say that you want it all the same (--unconverged)",
            )  # fmt: skip
        return [Loss("not-converged", f"The fit did not converge: {fit.message}")]
    if fit.status != "converged":
        return [Loss(fit.status.replace("_", "-"), f"Of the fit: {fit.message}")]
    return []
