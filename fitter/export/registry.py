"""The registry of export targets: found by looking into ``to``, read by the command, the service, the
documentation and the contract tests."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitter.errors import SpecError
from fitter.formats.registry import Loss
from fitter.registered import declared

if TYPE_CHECKING:
    from fitter.export.subject import Subject


@dataclass(frozen=True)
class Written:
    """What writing a target has to tell.

    notes : what the file holds otherwise than its source, each a stable slug and a sentence with numbers.
    residuals : for a refit into the target's own model, its parameters and errors beside ours; else empty.
    """

    notes: tuple[Loss, ...] = ()
    residuals: Mapping[str, Any] = field(default_factory=dict[str, Any])


@dataclass(frozen=True)
class Target:
    """One thing to export to. A module of ``fitter.export.to`` that has one as ``TARGET`` is registered.

    name : short stable name, as the command and the address of the service take it.
    description : one sentence for help texts and the documentation.
    models, tables : whether it takes a reflectance model, a measured table.
    suffix : the end of the file's name; "" where a folder is written.
    write : (subject, path) -> what there is to tell. Raises SpecError or TableError for a subject that the
        target can't hold.
    media_type : what the service calls the file (a folder is sent as a zip archive).
    convention : units and cosine of what is in the file, in a sentence.
    channels : how many the file can hold, () for any number; ``tristimulus`` : also three named X, Y, Z.
    needs : the package of the extra ``renderers`` without which it can't be written, if any.
    """

    name: str
    description: str
    models: bool
    tables: bool
    suffix: str
    convention: str
    write: Callable[[Subject, Path], Written]
    media_type: str = "application/octet-stream"
    channels: tuple[int, ...] = ()
    tristimulus: bool = False
    needs: str | None = None

    def holds(self, names: Sequence[str]) -> bool:
        """Whether the file can hold channels of these names."""
        xyz = self.tristimulus and list(names) == ["X", "Y", "Z"]
        return xyz or not self.channels or len(names) in self.channels


@cache
def targets() -> tuple[Target, ...]:
    """All registered targets, by name."""
    import fitter.export.to as here

    return tuple(sorted(declared(here, "TARGET", Target), key=lambda entry: entry.name))


def target(name: str) -> Target:
    """The target of that name. Raises SpecError."""
    for entry in targets():
        if entry.name == name:
            return entry
    raise SpecError(
        f"there is nothing called {name[:64]!r} to export to", code="unknown-export", parameter="to",
        remedy=f"use one of {', '.join(entry.name for entry in targets())}",
    )  # fmt: skip
