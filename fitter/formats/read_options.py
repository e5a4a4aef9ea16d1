"""Reading options: what a file can't say about itself and its reader must be told."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, cast, get_args

from fitter.errors import SpecError
from fitter.formats.fills import Fills
from fitter.masking import Treatment
from fitter.metadata import QUANTITIES, Quantity

#: How azimuths, in-plane sides and cells may be meant. Which of them a format takes, its reader says.
CONVENTIONS: Mapping[str, str] = {
    "phi_specular_180": "ideal mirror reflection is at phi_o - phi_i = 180 deg (azimuths of both "
    "directions measured alike; the default)",
    "phi_specular_0": "ideal mirror reflection is at phi_o - phi_i = 0: the outgoing azimuth counts "
    "from the forward side",
    "forward": "in-plane table without azimuths: theta_o of the same sign as theta_i is the specular side",
    "back": "in-plane table without azimuths: theta_o of the same sign as theta_i is the side of the light",
    "center": "MERL: a value belongs to the centre of its cell in index space (the default)",
    "corner": "MERL: a value belongs to the lower corner of its cell",
}


_COLUMNS_REMEDY = 'give a mapping, as {"thetai": "theta_i_deg", "5": "brdf_R"}'


@dataclass(frozen=True)
class ReadOptions:
    """The keyword options of :func:`fitter.load`, in one hashable, JSON-ready value.

    quantity : what the values are, where the file can't say or says it wrongly.
    convention : one of ``CONVENTIONS``.
    item : which table of a file that holds several: its name, or its position from 0.
    columns : (column, meaning) pairs; a column is a header name or a 0-based position.
    negatives, duplicates : "mask" or "keep", as in :class:`fitter.Table`.
    fills : fill values (:mod:`fitter.formats.fills`): "mask", "keep", or "floors", which masks repeated zeros
        and constant lowest values, too.
    name : what to call the table; for bytes without a file name also what errors call them.

    Raises
    ------
    SpecError : a value outside its vocabulary.
    """

    quantity: Quantity | None = None
    convention: str | None = None
    item: str | int | None = None
    columns: tuple[tuple[str, str], ...] = ()
    negatives: Treatment = "mask"
    duplicates: Treatment = "mask"
    fills: Fills = "mask"
    name: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", _pairs(self.columns))
        _check("quantity", self.quantity, QUANTITIES, optional=True)
        _check("convention", self.convention, tuple(CONVENTIONS), optional=True)
        _check("negatives", self.negatives, get_args(Treatment))
        _check("duplicates", self.duplicates, get_args(Treatment))
        _check("fills", self.fills, get_args(Fills))
        # bool is an int to Python, not to someone who writes JSON.
        item = cast("object", self.item)  # callers pass on what JSON holds
        if isinstance(item, bool) or not isinstance(item, str | int | None):
            raise _bad("item", self.item, "give the item's name or its position from 0")
        name = cast("object", self.name)
        if not isinstance(name, str | None):
            raise _bad("name", self.name, "give a text")

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready keyword arguments of :func:`fitter.load`; options left at their default are left out."""
        document = {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != f.default}
        if "columns" in document:
            document["columns"] = dict(self.columns)
        return document


def read_options(mapping: Mapping[str, Any]) -> ReadOptions:
    """ReadOptions from a JSON-like mapping (an upload's form, a command line). Raises SpecError."""
    known = [f.name for f in fields(ReadOptions)]
    for key in mapping:
        if key not in known:
            raise SpecError(
                f"there is no reading option {key!r}", code="unknown-option", parameter=str(key),
                remedy=f"use {', '.join(known)}",
            )  # fmt: skip
    return ReadOptions(**{key: item for key, item in mapping.items() if item is not None})


def _pairs(columns: object) -> tuple[tuple[str, str], ...]:
    if columns is None:
        return ()
    if isinstance(columns, Mapping):
        columns = tuple(cast("Mapping[object, object]", columns).items())
    if not isinstance(columns, tuple):
        raise _bad("columns", columns, _COLUMNS_REMEDY)
    return tuple(_pair(entry) for entry in cast("tuple[object, ...]", columns))


def _pair(entry: object) -> tuple[str, str]:
    if isinstance(entry, tuple) and len(cast("tuple[object, ...]", entry)) == 2:
        column, meaning = cast("tuple[object, object]", entry)
        if isinstance(column, str | int) and not isinstance(column, bool) and isinstance(meaning, str):
            return str(column), meaning
    raise _bad("columns", entry, _COLUMNS_REMEDY)


def _check(name: str, given: object, allowed: tuple[str, ...], *, optional: bool = False) -> None:
    if (given is None and optional) or given in allowed:
        return
    raise _bad(name, given, f"use one of {', '.join(allowed)}")


def _bad(name: str, given: object, remedy: str) -> SpecError:
    return SpecError(f"{name} can't be {given!r}", code="bad-option", parameter=name, remedy=remedy)
