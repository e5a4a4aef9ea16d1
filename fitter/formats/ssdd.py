"""SSDD (surface scattering distribution data) of libbsdf, K. Ryo, file format specification 0.2 and 0.3.

A text header of keys and lists in degrees, then one colour for each cell, the first parameter running
fastest; as text or as little-endian floats. A file may hold up to four blocks: only the BRDF is read.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.formats import geometry as geo
from fitter.formats import specular
from fitter.formats.assemble import ABOUT_SPECULAR, TRISTIMULUS, Reading, assemble, stated_quantity
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format
from fitter.formats.sniffing import found
from fitter.formats.source import Source
from fitter.formats.text import number
from fitter.metadata import Channel
from fitter.table import Table

FloatArray = NDArray[np.float64]

NAME = "ssdd"
CONVENTIONS = ("phi_specular_180", "phi_specular_0")
_TYPES = ("brdf", "btdf", "specular_reflectance", "specular_transmittance")
_COLOURS = {"monochrome": 1, "rgb": 3, "xyz": 3, "spectrum": 0}
_SYSTEMS = ("spherical_coordinate_system", "specular_coordinate_system", "half_difference_coordinate_system")
_LINE = re.compile(rb"([^\r\n]*)(\r\n|\n|\r|$)")


def sniff(head: bytes, size: int) -> float:
    """Sure of a text with VERSION and DATA_TYPE lines."""
    version = found(rb"(?:^|[\r\n])VERSION[ \t]+\d", head[:4096], b"VERSION")
    kind = found(rb"(?:^|[\r\n])DATA_TYPE[ \t]+[a-z]", head, b"DATA_TYPE")
    return 0.97 if version and kind else 0.6 if kind else 0.0


@dataclass
class _Block:
    """One data block: its keys and their rows, its channels and its parameter lists (radians)."""

    keys: dict[str, str] = field(default_factory=dict[str, str])
    rows: dict[str, int] = field(default_factory=dict[str, int])
    channels: list[Channel] = field(default_factory=list[Channel])
    lists: dict[str, FloatArray] = field(default_factory=dict[str, FloatArray])

    @property
    def colours(self) -> int:
        """How many colours the block holds."""
        return math.prod(len(axis) for axis in self.lists.values())


@dataclass
class _Cursor:
    """Where reading stands: byte offset and row."""

    at: int = 0
    row: int = 0


def read(source: Source, options: ReadOptions) -> list[Table]:
    """The BRDF of an SSDD file; transmission and specular reflectance are reported and skipped."""
    data, cursor = source.data, _Cursor(at=3 if source.head.startswith(b"\xef\xbb\xbf") else 0)
    head: dict[str, str] = {}
    block = _Block()
    found: tuple[_Block, FloatArray] | None = None
    skipped: list[str] = []
    while (line := _line(source, data, cursor)) is not None:
        key, _, text = line.partition(" ")
        text = text.strip()
        if not re.fullmatch(r"[A-Z][A-Z0-9_]*", key):
            raise source.error(
                f"{key[:40]!r} is no line of a header", "table-header", row=cursor.row,
                cause="more values than the lists of the header say",
                remedy="correct the lists of the header",
            )  # fmt: skip
        if key == "DATA":
            values = _data(source, data, cursor, _checked(source, block, cursor.row), text)
            kind = block.keys["DATA_TYPE"]
            if kind == "brdf" and found is None:
                found = (block, values)
            else:
                skipped.append(kind)
            block = _Block()
        elif key == "DATA_TYPE" or block.keys:
            block.keys[key], block.rows[key] = text, cursor.row
        else:
            head[key] = text
    if block.keys or (found is None and not skipped):
        raise source.error(
            "the file ends before the values of its last block", "table-truncated", row=cursor.row,
            cause="the file is cut off", remedy="fetch the file again",
        )  # fmt: skip
    if found is None:
        raise source.no_table(
            f"the file holds {', '.join(skipped)} and no brdf", "table-transmission", ", ".join(skipped),
            column="DATA_TYPE", remedy="use the file of the same sample's reflection",
        )  # fmt: skip
    return [_table(source, options, head, *found, skipped)]


FORMAT = Format(NAME, "SSDD of libbsdf, text or binary", CONVENTIONS, sniff, read)


def _line(source: Source, data: bytes, cursor: _Cursor) -> str | None:
    """The next line that says something, without its comment; None at the end."""
    while cursor.at < len(data):
        match = _LINE.match(data, cursor.at)
        assert match is not None
        cursor.at, cursor.row = match.end(), cursor.row + 1
        try:
            text = match[1].decode()
        except UnicodeDecodeError as error:
            raise source.error(
                "the line is no UTF-8 text", "text-encoding", row=cursor.row,
                cause="binary values that are longer than the header says, or a damaged file",
                remedy="fetch the file again",
            ) from error  # fmt: skip
        bare = re.sub(r"(?:^|\s)#(?:\s.*)?$", "", text).strip()
        if bare:
            return bare
    return None


def _checked(source: Source, block: _Block, row: int) -> _Block:
    """``block`` with its lists as radians and its channels. Raises TableError where a key makes no sense."""

    def bad(key: str, remedy: str) -> Exception:
        return source.error(
            f"{key} is {block.keys.get(key, '(not given)')[:60]!r}", "table-header",
            row=block.rows.get(key, row), column=key, cause="a damaged header", remedy=remedy,
        )  # fmt: skip

    kind, colour = block.keys.get("DATA_TYPE", ""), block.keys.get("COLOR_MODEL", "")
    if kind not in _TYPES:
        raise bad("DATA_TYPE", f"use one of {', '.join(_TYPES)}")
    if colour not in _COLOURS:
        raise bad("COLOR_MODEL", f"use one of {', '.join(_COLOURS)}")
    needed = ["PARAM0_LIST", "PARAM2_LIST", "PARAM3_LIST"] if kind in ("brdf", "btdf") else ["PARAM0_LIST"]
    if kind in ("brdf", "btdf") and block.keys.get("PARAM_TYPE") not in _SYSTEMS:
        raise bad("PARAM_TYPE", f"use one of {', '.join(_SYSTEMS)}")
    if colour == "spectrum":
        needed.append("WAVELENGTH_LIST")
    given: dict[str, FloatArray] = {}
    for key in {*needed, "PARAM1_LIST", "PARAM4_LIST"}:
        if key in block.keys or key in needed:
            try:
                given[key] = np.array(block.keys.get(key, "").split(), np.float64)
            except ValueError:
                raise bad(key, "write increasing numbers") from None
            values = given[key]
            ordered = key == "PARAM4_LIST" or (np.diff(values) > 0).all()
            if not len(values) or not ordered or not (np.abs(values) < 1e5).all():
                raise bad(key, "write increasing numbers")
            if key.startswith("PARAM") and np.abs(values).max() > 360:
                raise bad(key, "write angles in degrees")
    if "PARAM4_LIST" in given and len(given["PARAM4_LIST"]) != len(given["PARAM0_LIST"]):
        raise bad("PARAM4_LIST", "write one offset for each angle of PARAM0_LIST")
    block.lists = {f"PARAM{k}_LIST": np.deg2rad(given.get(f"PARAM{k}_LIST", np.zeros(1))) for k in range(4)}
    if kind not in ("brdf", "btdf"):
        block.lists |= {"PARAM2_LIST": np.zeros(1), "PARAM3_LIST": np.zeros(1)}
    block.channels = (
        [Channel(f"{nm:g}nm", float(nm)) for nm in given["WAVELENGTH_LIST"]] if colour == "spectrum"
        else [Channel(c) for c in colour.upper()] if _COLOURS[colour] == 3 else [Channel("value")]
    )  # fmt: skip
    offsets = given.get("PARAM4_LIST")
    if offsets is not None:
        block.keys["offsets"] = " ".join(repr(float(x)) for x in offsets)
    return block


def _data(source: Source, data: bytes, cursor: _Cursor, block: _Block, mode: str) -> FloatArray:
    """Values (colours, channels) that begin at the cursor, which is moved behind them."""
    count, width = block.colours, len(block.channels)
    cut = {"cause": "the file is cut off", "remedy": "fetch the file again"}
    if mode == "ascii":
        # A value takes two bytes at least: what can't fit is not begun.
        rows: list[list[float]] = []
        while len(rows) < count:
            line = _line(source, data, cursor) if count <= len(data) else None
            if line is None:
                raise source.error(
                    f"{len(rows)} colours where there should be {count}",
                    "table-truncated",
                    row=cursor.row,
                    **cut,
                )
            words = line.split()
            if len(words) != width:
                raise source.error(
                    f"{len(words)} values where there should be {width}", "table-row-width", row=cursor.row,
                    cause="the counts of the header don't fit", remedy="correct COLOR_MODEL or the lists",
                )  # fmt: skip
            rows.append([_value(source, word, cursor.row) for word in words])
        return np.array(rows)
    if mode != "binary":
        raise source.error(
            f"DATA is {mode[:40]!r}",
            "table-header",
            row=cursor.row,
            column="DATA",
            remedy="use ascii or binary",
        )
    for dtype in ("<f4", "<f8"):
        end = cursor.at + count * width * int(dtype[-1])
        # The specification does not say how long a float is: what follows does.
        if end <= len(data) and re.match(rb"\s*(?:$|DATA_TYPE|#)", data[end : end + 64]):
            values = np.frombuffer(data, dtype, count * width, cursor.at).astype(np.float64)
            cursor.at = end
            return values.reshape(count, width)
    raise source.error(
        f"the values of the block don't fit {count} x {width} binary numbers", "table-truncated",
        row=cursor.row, offset=cursor.at, **cut,
    )  # fmt: skip


def _value(source: Source, word: str, row: int) -> float:
    found = number(word)
    if found is not None:
        return found
    raise source.error(
        f"{word[:40]!r} is not a number", "table-not-a-number", row=row,
        cause="the lists of the header are longer than the data", remedy="mend the number or the lists",
    )  # fmt: skip


def _table(
    source: Source, options: ReadOptions, head: Mapping[str, str], block: _Block, values: FloatArray,
    skipped: list[str],
) -> Table:  # fmt: skip
    # Parameter 0 runs fastest: the reverse of meshgrid's order.
    mesh = np.meshgrid(*reversed(block.lists.values()), indexing="ij")
    first, second, third, fourth = (axis.reshape(-1) for axis in reversed(mesh))
    isotropic = len(block.lists["PARAM1_LIST"]) == 1
    notes: list[str] = []
    match block.keys["PARAM_TYPE"]:
        case "spherical_coordinate_system":
            angles = {"theta_i": first, "phi_i": second, "theta_o": third, "phi_o": fourth}
            geometry = geo.from_angles(source, angles, options.convention)
        case "half_difference_coordinate_system":
            geo.refuse_convention(source, options.convention)
            half = {"theta_h": first, "theta_d": third, "phi_d": fourth}
            geometry = geo.from_half_difference(half if isotropic else {**half, "phi_h": second})
        case _:
            geo.refuse_convention(source, options.convention)
            offsets = np.deg2rad(np.array(block.keys.get("offsets", "0").split(), np.float64))
            offset = offsets[np.arange(len(first)) % len(offsets)]
            wi = directions.vector_from_spherical(first, second)
            wo = specular.outgoing(first + offset, second, third, fourth)
            geometry = geo.from_directions(wi, wo, "about the specular direction", symmetric=isotropic)
            notes.append(ABOUT_SPECULAR)
    quantity, against = stated_quantity(options, "brdf", "brdf")
    if skipped:
        notes.append(f"Blocks not read: {', '.join(skipped)}.")
    if "REDUCTION_TYPE" in block.keys:
        notes.append(
            f"The file states {block.keys['REDUCTION_TYPE']}; only the part it holds is in the table."
        )
    if block.keys["COLOR_MODEL"] == "xyz":
        notes.append(TRISTIMULUS)
    reading = Reading(
        NAME, quantity, values, block.channels, symmetry="isotropic" if isotropic else "anisotropic",
        name=block.keys.get("NAME", ""), notes=(*notes, *against), angle_unit="deg",
        provenance={**head, **{k: t for k, t in block.keys.items() if not k.endswith("LIST")}},
    )  # fmt: skip
    return assemble(source, options, reading, geometry, geo.find_grid(geometry))
