"""What a file of declared columns says beside its numbers: statements, the meaning of columns, channels."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

from fitter.formats.columns import VOCABULARY, Column, band_nm, parse_column
from fitter.formats.read_options import CONVENTIONS, ReadOptions
from fitter.formats.source import Source
from fitter.grid import GRID_AXES
from fitter.metadata import QUANTITIES, Channel

_CHOICES: Mapping[str, Sequence[str]] = {
    "quantity": QUANTITIES,
    "convention": [key for key in CONVENTIONS if key not in ("center", "corner")],
    "symmetry": ("isotropic", "anisotropic"),
    "grid": tuple(GRID_AXES),
}
_NUMBERS = re.compile(r"scale_uncertainty|(?:aperture|angle_uncertainty)_(?:deg|rad)|rows")


@dataclass
class Head:
    """What stands above the samples. ``stated`` maps statement -> text, ``rows_of`` -> its row (text)."""

    stated: dict[str, str] = field(default_factory=dict[str, str])
    rows_of: dict[str, int | None] = field(default_factory=dict[str, "int | None"])
    numbers: dict[str, float] = field(default_factory=dict[str, float])
    notes: list[str] = field(default_factory=list[str])
    comments: list[str] = field(default_factory=list[str])

    def statements(self) -> dict[str, float]:
        """Uncertainties and aperture, angles in radians."""
        found: dict[str, float] = {}
        for key, number in self.numbers.items():
            if key.endswith("_deg"):
                found[key[:-4]] = float(np.deg2rad(number))
            elif key != "rows":
                found[key.removesuffix("_rad")] = number
        return found


def state(source: Source, head: Head, key: str, text: str, row: int | None = None) -> None:
    """Enter the statement ``key: text`` into ``head``. Raises TableError where it can't be understood."""
    key = key.strip().lower().replace(" ", "_")
    if key == "note":
        head.notes.append(text)
        return
    head.stated[key], head.rows_of[key] = text, row
    if key in _CHOICES:
        head.stated[key] = text.lower()
        if text.lower() not in _CHOICES[key]:
            raise source.error(
                f"the header states {key} {text!r}, which is not known", "table-header", row=row,
                parameter=key, remedy=f"use one of {', '.join(_CHOICES[key])}, or delete the line",
            )  # fmt: skip
    elif _NUMBERS.fullmatch(key):
        try:
            number = float(text)
        except ValueError:
            number = np.nan
        if not (np.isfinite(number) and number >= 0):
            raise source.error(
                f"the header states {key} {text!r}, which is no number >= 0", "table-header", row=row,
                parameter=key, remedy="mend or delete the line",
            )  # fmt: skip
        head.numbers[key] = number


def note_list(source: Source, text: str) -> list[str]:
    """Notes from a JSON list, as the formats with metadata hold them. Raises TableError for anything else."""
    try:
        notes: object = json.loads(text)
    except (ValueError, RecursionError):
        notes = None
    if not isinstance(notes, list):
        raise source.error(
            "the metadata's notes are no list", "table-header", parameter="notes",
            remedy="write them as a JSON list of sentences, or leave them out",
        )  # fmt: skip
    return [str(note) for note in cast("list[object]", notes)]


def head_of(source: Source, said: Mapping[str, str], foreign: frozenset[str]) -> Head:
    """The head of metadata ``said`` (statement -> text, notes a JSON list), without ``foreign`` keys."""
    head = Head()
    for key, text in said.items():
        if key == "notes":
            head.notes += note_list(source, text)
        elif key not in foreign:
            state(source, head, key, text)
    return head


def declared_columns(source: Source, names: Sequence[str], options: ReadOptions) -> dict[int, Column]:
    """Position -> what it holds, for every column that is declared by its name or by ``columns=``.

    Raises TableError for a column that isn't there, a meaning not in the vocabulary, a role given twice
    and an angle without a unit.
    """
    found: dict[int, Column] = {}
    for key, meaning in options.columns:
        where = _position(source, names, key)
        column = parse_column(meaning)
        if column is None:
            raise source.error(
                f"columns= declares {key!r} as {meaning!r}, which is not known", "table-columns",
                parameter="columns", remedy=f"use {VOCABULARY}",
            )  # fmt: skip
        found[where] = column
    given = {c.role for c in found.values()}
    for k, name in enumerate(names):
        if k in found:
            continue
        column = parse_column(name)
        if column is None or (column.kind == "angle" and column.role in given):
            continue
        found[k] = column
    seen: dict[tuple[str, str], int] = {}
    for k, column in sorted(found.items()):
        if column.kind == "ignore":
            continue
        if column.kind == "angle" and column.unit is None:
            raise source.error(
                f"the unit of {names[k]} is not declared", "table-unit", column=names[k],
                remedy=f"call the column {column.role}_deg or {column.role}_rad, or give "
                f"columns={{{names[k]!r}: '{column.role}_deg'}}",
            )  # fmt: skip
        key = (column.role, column.channel)
        if key in seen:
            raise source.error(
                f"{names[seen[key]]} and {names[k]} both hold {' '.join(key).strip()}",
                "table-columns", column=names[k],
                remedy="declare one as 'ignore', or give them different channels (brdf_R, brdf_550nm)",
            )  # fmt: skip
        seen[key] = k
    return {k: column for k, column in found.items() if column.kind != "ignore"}


def _position(source: Source, names: Sequence[str], key: str) -> int:
    named = [k for k, name in enumerate(names) if name == key]
    if len(named) == 1:
        return named[0]
    if key.isdecimal() and int(key) < len(names):
        return int(key)
    raise source.error(
        f"columns= names {key!r}, which the file does not have", "table-columns", parameter="columns",
        remedy=f"the columns are {', '.join(names)}, or a position from 0 to {len(names) - 1}",
    )  # fmt: skip


def channels_of(source: Source, head: Head, names: Sequence[str]) -> tuple[Channel, ...]:
    """Channels of the value columns: as the line '# channels:' (JSON) states, else by their names."""
    plain = tuple(Channel(name or "value", band_nm(name)) for name in names)
    stated = head.stated.get("channels")
    if stated is None:
        return plain
    try:
        listed = cast("list[dict[str, Any]]", json.loads(stated))
        channels = tuple(replace(Channel(str(one["name"])), wavelength_nm=_wavelength(one)) for one in listed)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        channels = ()
    if len(channels) != len(plain) or len({c.name for c in channels}) != len(plain):
        raise source.error(
            f"the header's channels don't fit the {len(plain)} value columns", "table-header",
            row=head.rows_of["channels"], parameter="channels",
            remedy='write [{"name": "R", "wavelength_nm": null}, ...], one per column, or delete the line',
        )  # fmt: skip
    return channels


def _wavelength(one: Mapping[str, Any]) -> float | None:
    given = one.get("wavelength_nm")
    return None if given is None else float(given)
