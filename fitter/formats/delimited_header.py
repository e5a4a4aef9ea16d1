"""The head of a delimited text table: comment lines that state things, delimiter, header row, columns."""

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
from fitter.formats.text import Rows, is_number, split
from fitter.grid import GRID_AXES
from fitter.table import QUANTITIES, Channel

_STATEMENT = re.compile(r"#+\s*([A-Za-z][\w ]*?)\s*:\s*(.*)")
_CHOICES: Mapping[str, Sequence[str]] = {
    "quantity": QUANTITIES,
    "convention": [key for key in CONVENTIONS if key not in ("center", "corner")],
    "symmetry": ("isotropic", "anisotropic"),
    "grid": tuple(GRID_AXES),
}
_NUMBERS = re.compile(r"scale_uncertainty|(?:aperture|angle_uncertainty)_(?:deg|rad)|rows")


@dataclass
class Head:
    """What stands above the samples. ``stated`` maps statement -> text, ``rows_of`` -> its row."""

    stated: dict[str, str] = field(default_factory=dict[str, str])
    rows_of: dict[str, int] = field(default_factory=dict[str, int])
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


def read_head(source: Source) -> tuple[Head, Rows]:
    """Statements and data rows of a text; column names are the header row's, or "column 0", ...

    Raises TableError where nothing but comments is there, or a statement can't be understood.
    """
    head = Head()
    texts: list[str] = []
    numbers: list[int] = []
    for number, line in enumerate(source.lines, start=1):
        bare = line.strip()
        if not bare:
            continue
        if bare.startswith("#"):
            if not texts:
                _statement(source, head, bare, number)
            continue
        # Only white space that no delimiter gives meaning to may go.
        texts.append(line.strip(" "))
        numbers.append(number)
    if not texts:
        raise source.error(
            "the file holds comments but no rows", "table-empty", remedy="check that it is whole"
        )
    delimiter = next((d for d in (";", "\t", ",") if d in texts[0]), None)
    first = split(texts[0], delimiter)
    if not all(is_number(cell) for cell in first):
        names = first[:-1] if len(first) > 1 and not first[-1] else first
        texts = texts[1:]
        if not texts:
            raise source.error(
                "the file has a header row but no rows of values", "table-empty", row=numbers[0],
                cause="the file is cut off", remedy="check that it is whole",
            )  # fmt: skip
        numbers = numbers[1:]
    else:
        names = _names_from_comment(head, len(first)) or [f"column {k}" for k in range(len(first))]
    rows = Rows(source, texts, np.asarray(numbers, np.intp), delimiter, names)
    promised = head.numbers.get("rows")
    if promised is not None and promised != len(rows):
        raise source.error(
            f"the file has {len(rows)} rows and states {promised:g}", "table-truncated",
            row=numbers[-1], cause="the file is cut off, or rows were added by hand",
            remedy="fetch the file again, or correct the line '# rows:'",
        )  # fmt: skip
    return head, rows


def _statement(source: Source, head: Head, line: str, row: int) -> None:
    match = _STATEMENT.fullmatch(line)
    head.comments.append(line.lstrip("#").strip())
    if not match:
        return
    key, text = match[1].strip().lower().replace(" ", "_"), match[2].strip()
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


def _names_from_comment(head: Head, width: int) -> list[str] | None:
    """Column names from the last comment above the values (as numpy.savetxt writes them), if it has them."""
    if not head.comments:
        return None
    line = head.comments[-1]
    delimiter = next((d for d in (";", "\t", ",") if d in line), None)
    names = split(line, delimiter)
    return names if len(names) == width and any(parse_column(name) for name in names) else None


def declared_columns(source: Source, rows: Rows, options: ReadOptions) -> dict[int, Column]:
    """Position -> what it holds, for every column that is declared by its name or by ``columns=``.

    Raises TableError for a column that isn't there, a meaning not in the vocabulary, a role given twice
    and an angle without a unit.
    """
    found: dict[int, Column] = {}
    for key, meaning in options.columns:
        where = _position(source, rows, key)
        column = parse_column(meaning)
        if column is None:
            raise source.error(
                f"columns= declares {key!r} as {meaning!r}, which is not known", "table-columns",
                parameter="columns", remedy=f"use {VOCABULARY}",
            )  # fmt: skip
        found[where] = column
    given = {c.role for c in found.values()}
    for k, name in enumerate(rows.names):
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
                f"the unit of {rows.names[k]} is not declared", "table-unit", column=rows.names[k],
                remedy=f"call the column {column.role}_deg or {column.role}_rad, or give "
                f"columns={{{rows.names[k]!r}: '{column.role}_deg'}}",
            )  # fmt: skip
        key = (column.role, column.channel)
        if key in seen:
            raise source.error(
                f"{rows.names[seen[key]]} and {rows.names[k]} both hold {' '.join(key).strip()}",
                "table-columns", column=rows.names[k],
                remedy="declare one as 'ignore', or give them different channels (brdf_R, brdf_550nm)",
            )  # fmt: skip
        seen[key] = k
    return {k: column for k, column in found.items() if column.kind != "ignore"}


def _position(source: Source, rows: Rows, key: str) -> int:
    named = [k for k, name in enumerate(rows.names) if name == key]
    if len(named) == 1:
        return named[0]
    if key.isdecimal() and int(key) < len(rows.names):
        return int(key)
    raise source.error(
        f"columns= names {key!r}, which the file does not have", "table-columns", parameter="columns",
        remedy=f"the columns are {', '.join(rows.names)}, or a position from 0 to {len(rows.names) - 1}",
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
