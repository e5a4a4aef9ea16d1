"""Tradeoff and Point: what was measured, as JSON, and read back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from fitter.documents import read_document, write_bytes, write_document
from fitter.errors import SpecError
from fitter.spec import TradeoffSpec, tradeoff_spec
from fitter.tradeoffs.errors import KINDS
from fitter.tradeoffs.front import front

KIND = "brdf-fitter/tradeoff"
VERSION = 1


@dataclass(frozen=True)
class Point:
    """One configuration: what it is, what it costs, what it gets wrong.

    axis, label, model, metric : what it is; ``settings`` are those in which it differs from others.
    seconds : "min" and "median" of the warm repeats, each, and how many ("repeats"); "compile" is what the
        first run spent on compiling and "first" all of it.
    memory_bytes : by how much the process grew at the peak, the largest of the warm runs.
    errors : by kind, see :mod:`fitter.tradeoffs.errors`; None where there is none. Medians where repeats
        differ.
    reference : the exhaustive fit that the others' errors are taken from.
    front : "KIND/seconds" and "KIND/memory" for the fronts that it is on.
    """

    axis: str
    label: str
    model: str
    metric: str | None
    settings: Mapping[str, Any]
    seconds: Mapping[str, float]
    memory_bytes: int | None
    errors: Mapping[str, float | None]
    status: str
    evidence: Mapping[str, Any] = field(default_factory=dict[str, Any])
    front: tuple[str, ...] = ()


@dataclass(frozen=True)
class Tradeoff:
    """Everything that a tradeoff measured.

    points : fits, and evaluations (axis "precision"). compression : one row a tolerance, bytes against
        errors.
    posterior : short runs against a long one, or None. skipped : labels that the time limit left out.
    table, machine : what it was measured on. noise : how far repeats spread, in words and numbers.
    """

    spec: TradeoffSpec
    points: tuple[Point, ...]
    compression: tuple[Mapping[str, Any], ...]
    posterior: Mapping[str, Any] | None
    references: tuple[Mapping[str, Any], ...]
    skipped: tuple[str, ...]
    table: Mapping[str, Any]
    machine: Mapping[str, Any]
    noise: Mapping[str, Any]
    seconds: float
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "kind": KIND, "version": VERSION, "spec": self.spec.model_dump(mode="json"),
            "points": [{**asdict(point), "front": list(point.front)} for point in self.points],
            "compression": [dict(row) for row in self.compression],
            "posterior": None if self.posterior is None else dict(self.posterior),
            "references": [dict(one) for one in self.references],
            "skipped": list(self.skipped), "table": dict(self.table), "machine": dict(self.machine),
            "noise": dict(self.noise), "seconds": self.seconds, "notes": list(self.notes),
        }  # fmt: skip

    @staticmethod
    def from_dict(document: Mapping[str, Any]) -> Tradeoff:
        """What :meth:`to_dict` wrote. Raises SpecError on anything else."""
        try:
            if document["kind"] != KIND or document["version"] != VERSION:
                raise KeyError(f"kind is {document['kind']!r}")
            return Tradeoff(
                spec=tradeoff_spec(document["spec"]),
                points=tuple(_point(one) for one in document["points"]),
                compression=tuple(document["compression"]), posterior=document["posterior"],
                references=tuple(document["references"]), skipped=tuple(document["skipped"]),
                table=document["table"], machine=document["machine"], noise=document["noise"],
                seconds=float(document["seconds"]), notes=tuple(document["notes"]),
            )  # fmt: skip
        except (KeyError, TypeError, ValueError) as error:
            raise SpecError(
                f"this is not a tradeoff ({error})", code="not-a-tradeoff",
                remedy="give the file that `brdf-fitter tradeoff --out` wrote",
            ) from error  # fmt: skip

    def save(self, folder: Path | str) -> None:
        """Write tradeoff.json, tradeoff.png and tradeoff.html into ``folder``, each aside and renamed."""
        folder = Path(folder)
        # Both drawn before the first file: no half of it after an error.
        drawn, page = self.picture("png"), self.html().encode()
        write_document(self.to_dict(), folder / "tradeoff.json")
        write_bytes(drawn, folder / "tradeoff.png")
        write_bytes(page, folder / "tradeoff.html")

    def picture(self, kind: str = "png") -> bytes:
        """Error against seconds, log-log, points labelled, the front drawn; "png" or "svg"."""
        from fitter.tradeoffs.picture import draw

        return draw(self, kind)

    def html(self) -> str:
        """One self-contained page: the picture and the numbers."""
        from fitter.tradeoffs.page import render

        return render(self)


def _point(document: Mapping[str, Any]) -> Point:
    return replace(Point(**document), front=tuple(document["front"]))


def with_fronts(points: Sequence[Point]) -> tuple[Point, ...]:
    """The points, each knowing the fronts that it is on. References measure the others, not themselves."""
    on: list[list[str]] = [[] for _ in points]
    for kind in KINDS:
        errors = [p.errors.get(kind) if p.axis != "precision" else None for p in points]
        if kind != "held_out":
            errors = [None if p.axis == "reference" else e for p, e in zip(points, errors, strict=True)]
        costs = {"seconds": [p.seconds["min"] for p in points], "memory": [p.memory_bytes for p in points]}
        for cost, values in costs.items():
            for k in front(values, errors):
                on[k].append(f"{kind}/{cost}")
    return tuple(replace(point, front=tuple(names)) for point, names in zip(points, on, strict=True))


def load_tradeoff(path: Path | str) -> Tradeoff:
    """Read the tradeoff.json that :meth:`Tradeoff.save` wrote."""
    return Tradeoff.from_dict(read_document(Path(path), "not-a-tradeoff"))
