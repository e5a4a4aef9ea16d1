"""ALTA, text or binary: "#KEY value" lines that declare the parametrisation, then rows of inputs and outputs.

The binary form has ``#FORMAT binary``, ``#SAMPLE_COUNT``, ``#ENDIAN`` and, between ``#BEGIN_STREAM`` and
``#END_STREAM``, rows of float64. With ``#VS`` 1 or 2 a row goes on with the half width or the two ends of an
interval, of the first output or of every one (ALTA's data_storage.cpp). No file says at which level: they are
no sigma.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fitter.formats import geometry as geo
from fitter.formats.assemble import QUANTITY_REMEDY, Reading, assemble
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format
from fitter.formats.sniffing import found
from fitter.formats.source import Source
from fitter.formats.text import Rows
from fitter.metadata import Channel, Quantity
from fitter.table import Table

FloatArray = NDArray[np.float64]

NAME = "alta"
CONVENTIONS = ("phi_specular_180", "phi_specular_0")
_KEY = re.compile(r"#\s*([A-Z][A-Z_0-9]*)(?:\s+(.*))?")
_STREAM = re.compile(rb"(?:^|[\r\n])#[ \t]*BEGIN_STREAM[ \t]*\r?\n")
_END = re.compile(rb"\s*#[ \t]*END_STREAM")
#: What the binary form's keys may say.
_FIXED = {"VERSION": ("0",), "PRECISION": ("ieee754-double",), "ENDIAN": ("little", "big")}
_QUANTITIES: dict[str, Quantity] = {"INV_STERADIAN": "brdf", "INV_STERADIAN_COSINE_FACTOR": "ccbrdf"}


def sniff(head: bytes, size: int) -> float:
    """Sure of a text with a #PARAM_IN line; #DIM alone is enough to be asked."""
    if found(rb"(?:^|[\r\n])#[ \t]*PARAM_IN[ \t]", head, b"PARAM_IN"):
        return 0.95
    return 0.6 if found(rb"(?:^|[\r\n])#[ \t]*DIM[ \t]+\d", head, b"DIM") else 0.0


def read(source: Source, options: ReadOptions) -> list[Table]:
    """The table of an ALTA file. ``quantity`` overrides what #PARAM_OUT says."""
    keys, rows_of, start = _keys(source)
    inputs, outputs = _dimensions(source, keys, rows_of)
    how = keys.get("PARAM_IN", "")
    if how not in _PARAMETRISATIONS:
        raise source.error(
            f"the parametrisation {how[:60] or '(none given)'} is not read", "table-parametrisation",
            row=rows_of.get("PARAM_IN"), column="PARAM_IN",
            remedy=f"convert the file in ALTA to one of {', '.join(_PARAMETRISATIONS)}",
        )  # fmt: skip
    names, geometry_of = _PARAMETRISATIONS[how]
    if len(names) != inputs:
        raise source.error(
            f"#DIM gives {inputs} inputs, {how} has {len(names)}", "table-header", row=rows_of["DIM"],
            column="DIM", cause="a damaged header", remedy="correct #DIM or #PARAM_IN",
        )  # fmt: skip
    quantity, notes = _quantity(source, keys, rows_of, options)
    if how == "RUSIN_TH_TD_PD" and quantity == "ccbrdf":
        raise source.error(
            "RUSIN_TH_TD_PD does not say which direction the cosine belongs to", "table-parametrisation",
            row=rows_of["PARAM_IN"], column="PARAM_IN", remedy="convert the values to INV_STERADIAN",
        )  # fmt: skip
    channels = _channels(keys, outputs)
    labels = [*names, *(c.name for c in channels)]
    intervals = _intervals(source, keys, rows_of, outputs)
    if start is None:
        rows, numbers = _text(source, labels, intervals)
    else:
        rows, numbers = _binary(source, keys, rows_of, labels, intervals, start)
    if max(intervals):
        notes.append(
            f"The rows hold confidence intervals (#VS {keys['VS']}): not read, their level is not stated."
        )
    geometry = geometry_of(source, options, rows, numbers[:, :inputs])
    reading = Reading(
        NAME, quantity, np.ascontiguousarray(numbers[:, inputs:]), channels,
        name=keys.get("SAMPLE", "").strip('"'), provenance=dict(keys), notes=tuple(notes), text=start is None,
        angle_unit="" if how == "CARTESIAN" else "rad",
    )  # fmt: skip
    return [assemble(source, options, reading, geometry, geo.find_grid(geometry))]


FORMAT = Format(NAME, "ALTA text or binary with a declared parametrisation", CONVENTIONS, sniff, read)


def _keys(source: Source) -> tuple[dict[str, str], dict[str, int], int | None]:
    """The header's keys, their rows, and where the binary values begin (None in a text)."""
    keys: dict[str, str] = {}
    rows_of: dict[str, int] = {}
    stream = _STREAM.search(source.head)
    header = source if stream is None else Source(source.head[: stream.start()], source.name)
    for number, line in enumerate(header.lines, start=1):
        match = _KEY.fullmatch(line.strip())
        if match:
            keys[match[1]], rows_of[match[1]] = (match[2] or "").strip(), number
    binary = keys.get("FORMAT", "").startswith("binary")
    if binary != (stream is not None):
        raise source.error(
            "#FORMAT says binary and there is no #BEGIN_STREAM" if binary
            else "#BEGIN_STREAM is there and no #FORMAT binary", "table-header", row=rows_of.get("FORMAT"),
            column="FORMAT", cause="a damaged header, or a file that is cut off",
            remedy="fetch the file again",
        )  # fmt: skip
    return keys, rows_of, None if stream is None else stream.end()


def _dimensions(source: Source, keys: dict[str, str], rows_of: dict[str, int]) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,3})\s+(\d{1,3})", keys.get("DIM", ""))
    if not match or int(match[1]) == 0 or int(match[2]) == 0:
        raise source.error(
            f"#DIM is {keys.get('DIM', '')[:40]!r}, not two counts", "table-header", row=rows_of.get("DIM"),
            column="DIM", cause="a damaged header", remedy="write #DIM and the numbers of inputs and outputs",
        )  # fmt: skip
    return int(match[1]), int(match[2])


def _intervals(
    source: Source, keys: dict[str, str], rows_of: dict[str, int], outputs: int
) -> tuple[int, ...]:
    """How many numbers of intervals a row may have, the usual count first."""
    words = keys.get("VS", "0").split() or ["0"]
    if any(word not in ("0", "1", "2") for word in words) or len(words) not in (1, outputs):
        raise source.error(
            f"#VS is {keys['VS'][:40]!r}", "table-header", row=rows_of["VS"], column="VS",
            cause="a damaged header", remedy="write 0, 1 or 2: how many numbers follow an output",
        )  # fmt: skip
    each = sum(map(int, words))
    return (each, each * outputs) if len(words) == 1 else (each,)


def _text(source: Source, labels: list[str], intervals: tuple[int, ...]) -> tuple[Rows, FloatArray]:
    """The rows of a text, and their inputs and outputs."""
    numbered = np.flatnonzero([line.lstrip()[:1] not in ("", "#") for line in source.lines]) + 1
    if not len(numbered):
        raise source.error(
            "the file has a header but no rows", "table-empty", row=len(source.lines),
            cause="the file is cut off", remedy="fetch the file again",
        )  # fmt: skip
    lines = [source.lines[n - 1] for n in numbered]
    more = len(lines[0].split()) - len(labels)
    count = more if more in intervals else intervals[0]
    rows = Rows(
        source, lines, numbered, None, [*labels, *(f"interval {k + 1}" for k in range(count))],
    )  # fmt: skip
    return rows, rows.floats(range(len(labels)))


def _binary(
    source: Source, keys: dict[str, str], rows_of: dict[str, int], labels: list[str],
    intervals: tuple[int, ...], start: int,
) -> tuple[Rows, FloatArray]:  # fmt: skip
    """The rows between #BEGIN_STREAM and #END_STREAM, and their inputs and outputs."""
    for key, allowed in _FIXED.items():
        if keys.get(key, allowed[0]).lower() not in allowed:
            raise source.error(
                f"#{key} is {keys[key][:40]!r}", "table-header", row=rows_of[key], column=key,
                cause="another version of the format, or a damaged header",
                remedy="save the file as text from ALTA",
            )  # fmt: skip
    words = keys.get("SAMPLE_COUNT", "")
    count = int(words[:18]) if words.isascii() and words.isdecimal() else 0
    # ALTA writes the intervals of every output here.
    widths = [len(labels) + more for more in reversed(intervals)]
    for width in widths:
        end = start + count * width * 8
        if count and end <= source.size and _END.match(bytes(source.buffer[end : end + 32])):
            order = ">" if keys.get("ENDIAN", "little").lower() == "big" else "<"
            stored = np.frombuffer(source.buffer, f"{order}f8", count * width, start).reshape(count, width)
            numbers = stored[:, : len(labels)].astype(np.float64)
            return Rows(source, [], np.arange(1, count + 1), None, labels), numbers
    raise source.error(
        f"#SAMPLE_COUNT is {words[:40] or 'missing'}: {count:,} rows of {widths[0]} numbers do not end where "
        f"#END_STREAM is", "table-truncated", row=rows_of.get("SAMPLE_COUNT"), column="SAMPLE_COUNT",
        offset=start, cause="the file is cut off or its header damaged", remedy="fetch the file again",
    )  # fmt: skip


def _quantity(
    source: Source, keys: dict[str, str], rows_of: dict[str, int], options: ReadOptions
) -> tuple[Quantity, list[str]]:
    stated = keys.get("PARAM_OUT", "")
    known = _QUANTITIES.get(stated)
    if options.quantity is not None:
        conflict = known is not None and known != options.quantity
        return options.quantity, [
            f"The file says {stated}; its values were read as {options.quantity}."
        ] * conflict
    if known is not None:
        return known, []
    raise source.error(
        f"#PARAM_OUT is {stated[:40]}, which does not say whether the cosine is in the values" if stated
        else "the file has no #PARAM_OUT, so it does not say what its values are",
        "table-quantity", row=rows_of.get("PARAM_OUT"), parameter="quantity", remedy=QUANTITY_REMEDY,
    )  # fmt: skip


def _channels(keys: dict[str, str], outputs: int) -> list[Channel]:
    if outputs == 1:
        return [Channel("value")]
    names = "RGB" if keys.get("PARAM_OUT") == "RGB_COLOR" or outputs == 3 else ""
    return [Channel(names[k] if outputs == 3 else f"c{k}") for k in range(outputs)]


def _angles(roles: tuple[str, ...]) -> Callable[[Source, ReadOptions, Rows, FloatArray], geo.Geometry]:
    def place(source: Source, options: ReadOptions, rows: Rows, inputs: FloatArray) -> geo.Geometry:
        angles = dict(zip(roles, inputs.T, strict=True))
        names = dict(zip(roles, rows.names, strict=False))
        turned = geo.to_radians(source, angles, dict.fromkeys(roles, "rad"), names, rows.numbers)
        if roles[0] == "theta_h":
            geo.refuse_convention(source, options.convention)
            return geo.from_half_difference(turned)
        return geo.from_angles(source, turned, options.convention)

    return place


def _projected(source: Source, options: ReadOptions, rows: Rows, inputs: FloatArray) -> geo.Geometry:
    """theta_l, theta_v cos(dphi), theta_v sin(dphi): dphi = 0 is the side of the light."""
    with np.errstate(over="ignore", invalid="ignore"):
        theta_o, dphi = np.hypot(inputs[:, 1], inputs[:, 2]), np.arctan2(inputs[:, 2], inputs[:, 1])
    angles = {"theta_i": inputs[:, 0], "theta_o": theta_o, "dphi": dphi}
    names = {"theta_i": rows.names[0], "theta_o": f"{rows.names[1]}, {rows.names[2]}", "dphi": rows.names[2]}
    turned = geo.to_radians(source, angles, dict.fromkeys(angles, "rad"), names, rows.numbers)
    return geo.from_angles(source, turned, options.convention)


def _cartesian(source: Source, options: ReadOptions, rows: Rows, inputs: FloatArray) -> geo.Geometry:
    """View vector first, then light vector."""
    geo.refuse_convention(source, options.convention)
    return geo.from_vectors(
        source, inputs[:, 3:], inputs[:, :3], rows.numbers, (rows.names[3], rows.names[0])
    )


_PARAMETRISATIONS: dict[
    str, tuple[tuple[str, ...], Callable[[Source, ReadOptions, Rows, FloatArray], geo.Geometry]]
] = {
    "ISOTROPIC_TL_TV_PROJ_DPHI": (("theta_l", "theta_v cos(dphi)", "theta_v sin(dphi)"), _projected),
    "ISOTROPIC_TL_TV_DPHI": (("theta_l", "theta_v", "dphi"), _angles(("theta_i", "theta_o", "dphi"))),
    "ISOTROPIC_TV_TL_DPHI": (("theta_v", "theta_l", "dphi"), _angles(("theta_o", "theta_i", "dphi"))),
    "RUSIN_TH_TD_PD": (("theta_h", "theta_d", "phi_d"), _angles(("theta_h", "theta_d", "phi_d"))),
    "CARTESIAN": (("view x", "view y", "view z", "light x", "light y", "light z"), _cartesian),
}  # fmt: skip
