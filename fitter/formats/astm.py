"""ASTM E1392 text (.astm): a Cornell-style header, then comma rows of angles in radians and values."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np

from fitter.formats import geometry as geo
from fitter.formats.assemble import QUANTITY_REMEDY, TRISTIMULUS, Reading, assemble
from fitter.formats.columns import band_nm, parse_column
from fitter.formats.output import measured, one_line, write_aside
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format, Loss
from fitter.formats.sniffing import found
from fitter.formats.source import Source
from fitter.formats.text import Rows
from fitter.metadata import Channel, Quantity
from fitter.table import Table

NAME = "astm"
CONVENTIONS = ("phi_specular_180", "phi_specular_0", "forward", "back")
_KEY = re.compile(r"([A-Za-z]\w*)(?:\s+(.*))?")


def sniff(head: bytes, size: int) -> float:
    """Sure of a file with both NUM_POINTS and VARS lines; one of them is enough to be asked."""
    lines = [found(rb"(?:^|[\r\n])" + key + rb"[ \t]", head, key) for key in (b"NUM_POINTS", b"VARS")]
    return (0.0, 0.6, 0.95)[sum(lines)]


@dataclass
class _Head:
    keys: dict[str, str] = field(default_factory=dict[str, str])
    rows_of: dict[str, int] = field(default_factory=dict[str, int])
    names: list[str] = field(default_factory=list[str])
    end: int = 0


def read(source: Source, options: ReadOptions) -> list[Table]:
    """The table of an ASTM file. Names that are not angles are channels; negatives are kept."""
    head = _head(source)
    angles, values = _variables(source, head)
    quantity, notes = _quantity(source, head, options)
    rows = _rows(source, head)
    numbers = rows.floats(range(len(head.names))).T
    names = {role: head.names[k] for role, k in angles.items()}
    turned = geo.to_radians(
        source,
        {role: numbers[k] for role, k in angles.items()},
        dict.fromkeys(angles, "rad"),
        names,
        rows.numbers,
    )
    geometry = geo.from_angles(source, turned, options.convention)
    channels = [Channel(head.names[k], band_nm(head.names[k])) for k in values]
    if {c.name for c in channels} == {"X", "Y", "Z"}:
        notes.append(TRISTIMULUS)
    reading = Reading(
        NAME, quantity, np.stack([numbers[k] for k in values], axis=1), channels,
        name=head.keys.get("SAMPLE_NAME", ""), provenance=dict(head.keys), notes=tuple(notes),
        angle_unit="rad",
    )  # fmt: skip
    return [assemble(source, options, reading, geometry, geo.find_grid(geometry))]


def write(table: Table, path: Path) -> list[Loss]:
    """Write an E1392 file with full digits: angles in radians, values f_r in 1/sr."""
    samples, losses = measured(table)
    names = [_column(channel) for channel in table.channels]
    if len(set(names)) < len(names) or not all(_plain(name) for name in names):
        names = [f"c{k}" for k in range(len(names))]
    head = [
        f"SAMPLE_NAME {one_line(table.metadata.name)}", "MEAS_NAME BRDF", f"NUM_POINTS {len(samples.value)}",
        f"VARS theta_i,phi_i,theta_s,phi_s,{','.join(names)}", "",
    ]  # fmt: skip
    columns = [samples.theta_i, samples.phi_i, samples.theta_o, samples.phi_o, *samples.value.T]
    rows = zip(*(column.tolist() for column in columns), strict=True)
    body = (f"{','.join(map(repr, row))}\n".encode() for row in rows)
    write_aside(path, chain(["\n".join([*head, ""]).encode()], body))
    return losses


FORMAT = Format(
    NAME,
    "ASTM E1392 text, as Cornell's gonioreflectometer wrote it (radians)",
    CONVENTIONS,
    sniff,
    read,
    write=write,
)


def _column(channel: Channel) -> str:
    """The channel's name, or its wavelength as 550nm, which a reader understands."""
    nm = channel.wavelength_nm
    if nm is None:
        return channel.name
    return f"{nm:g}nm" if float(f"{nm:g}") == nm else f"{nm!r}nm"


def _plain(name: str) -> bool:
    column = parse_column(name)
    return bool(re.fullmatch(r"[A-Za-z0-9_.]+", name)) and (column is None or column.kind != "angle")


def _head(source: Source) -> _Head:
    head = _Head()
    for number, line in enumerate(source.lines, start=1):
        bare = line.strip()
        match = _KEY.fullmatch(bare)
        if not match:
            if not bare:
                continue
            raise source.error(
                "the rows begin before a line VARS that names their columns", "table-header", row=number,
                cause="a damaged header", remedy="fetch the file again",
            )  # fmt: skip
        key, text = match[1].upper(), (match[2] or "").strip()
        head.keys[key], head.rows_of[key] = text, number
        if key == "VARS":
            head.names, head.end = [name.strip() for name in text.split(",")], number
            return head
    raise source.error(
        "the header has no line VARS", "table-header", row=len(source.lines), cause="the file is cut off",
        remedy="fetch the file again",
    )  # fmt: skip


def _variables(source: Source, head: _Head) -> tuple[dict[str, int], list[int]]:
    angles: dict[str, int] = {}
    values: list[int] = []
    for k, name in enumerate(head.names):
        column = parse_column(name)
        if (
            column is not None
            and column.kind == "angle"
            and column.role[-1] in "io"
            and column.role != "dphi"
        ):
            if column.role in angles or column.unit == "deg":
                raise source.error(
                    f"VARS names {name} {'twice' if column.role in angles else 'in degrees'}", "table-header",
                    row=head.end, column=name, remedy="ASTM files name each angle once, in radians",
                )  # fmt: skip
            angles[column.role] = k
        else:
            values.append(k)
    labels = [head.names[k] for k in values]
    missing = [name for name in ("theta_i", "theta_o") if name not in angles]
    if missing or not values or len(set(labels)) < len(labels) or not all(labels):
        raise source.error(
            f"VARS ({', '.join(head.names)[:80]}) does not name theta_i, theta_s and distinct channels",
            "table-header", row=head.end, column="VARS", cause="a damaged header or another kind of file",
            remedy="write, for example, VARS theta_i,phi_i,theta_s,phi_s,R,G,B",
        )  # fmt: skip
    return angles, values


def _quantity(source: Source, head: _Head, options: ReadOptions) -> tuple[Quantity, list[str]]:
    stated = head.keys.get("MEAS_NAME", "").upper()
    known: dict[str, Quantity] = {
        "BRDF": "brdf",
        "CCBRDF": "ccbrdf",
        "REFLECTANCE_FACTOR": "reflectance_factor",
    }
    if options.quantity is not None:
        against = [] if known.get(stated) in (None, options.quantity) else [
            f"The file calls its values {stated}; they were read as {options.quantity}."
        ]  # fmt: skip
        return options.quantity, against
    if stated in known:
        return known[stated], []
    if stated:
        raise source.error(
            f"MEAS_NAME is {stated[:40]!r}, which is no known quantity", "table-quantity",
            row=head.rows_of["MEAS_NAME"], parameter="quantity", remedy=QUANTITY_REMEDY,
        )  # fmt: skip
    return "brdf", ["The header has no MEAS_NAME: E1392 files hold the BRDF in 1/sr by definition."]


def _rows(source: Source, head: _Head) -> Rows:
    numbered = [
        (number, line)
        for number, line in enumerate(source.lines[head.end :], start=head.end + 1)
        if line.strip()
    ]
    stated = head.keys.get("NUM_POINTS", "")
    if not stated.isdecimal():
        raise source.error(
            f"NUM_POINTS is {stated[:40]!r}, not a count", "table-header",
            row=head.rows_of.get("NUM_POINTS", head.end), column="NUM_POINTS",
            cause="a damaged header", remedy="write NUM_POINTS and the number of rows before VARS",
        )  # fmt: skip
    rows = Rows(
        source, [line for _, line in numbered], np.asarray([n for n, _ in numbered], np.intp), ",", head.names
    )
    if not numbered or len(numbered) != int(stated):
        if numbered:
            rows.floats(range(len(head.names)))  # a row cut in two is the better message
        raise source.error(
            f"the header states {stated[:20]} points and the file has {len(numbered)} rows",
            "table-truncated", row=numbered[-1][0] if numbered else head.end,
            cause="the file is cut off" if len(numbered) < int(stated) else "rows were added by hand",
            remedy="fetch the file again, or correct NUM_POINTS",
        )  # fmt: skip
    return rows
