"""FRED scatter tables: "type bsdf_data", then blocks of one incidence each, in absolute polar angles."""

from __future__ import annotations

import re

import numpy as np

from fitter.formats import geometry as geo
from fitter.formats.assemble import Reading, assemble, stated_quantity
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format
from fitter.formats.source import Source
from fitter.formats.text import Rows
from fitter.metadata import Channel
from fitter.table import Table

NAME = "fred"
CONVENTIONS = ("phi_specular_0", "phi_specular_180")


def sniff(head: bytes, size: int) -> float:
    """Sure of a text whose first line is "type bsdf_data"."""
    return 0.95 if re.match(rb"(?:\xef\xbb\xbf)?\s*type[ \t]+bsdf_data\b", head, re.IGNORECASE) else 0.0


def read(source: Source, options: ReadOptions) -> list[Table]:
    """The table of a FRED file. Outgoing azimuths count from the specular side (phi_specular_0)."""
    unit, scale, start = _head(source)
    incidences: list[str] = []
    owners: list[int] = []
    lines: list[str] = []
    rows: list[int] = []
    opened: list[int] = []
    for number, line in enumerate(source.lines[start:], start=start + 1):
        words = len(line.split())
        if words == 0 or line.lstrip().startswith("#"):
            continue
        if words == 2:
            incidences.append(line)
            opened.append(number)
            continue
        if not incidences:
            raise source.error(
                "a row of values comes before the first incidence", "table-header", row=number,
                cause="a damaged file", remedy='open each block with a line "theta_i phi_i"',
            )  # fmt: skip
        owners.append(len(incidences) - 1)
        lines.append(line)
        rows.append(number)
    if not lines:
        raise source.error(
            "the file has a header but no values", "table-empty", row=len(source.lines),
            cause="the file is cut off", remedy="fetch the file again",
        )  # fmt: skip
    lit = Rows(source, incidences, np.asarray(opened, np.intp), None, ["theta_i", "phi_i"]).floats([0, 1])
    table = Rows(source, lines, np.asarray(rows, np.intp), None, ["theta_s", "phi_s", "value"])
    numbers = table.floats([0, 1, 2])
    # A bad incidence is named at its own row, not at the rows below it.
    geo.to_radians(
        source, dict(zip(("theta_i", "phi_i"), lit.T, strict=True)), {"theta_i": unit, "phi_i": unit},
        {"theta_i": "theta_i", "phi_i": "phi_i"}, np.asarray(opened, np.intp),
    )  # fmt: skip
    given = dict(zip(("theta_i", "phi_i"), lit[owners].T, strict=True))
    given |= {"theta_o": numbers[:, 0], "phi_o": numbers[:, 1]}
    names = {"theta_i": "theta_i", "phi_i": "phi_i", "theta_o": "theta_s", "phi_o": "phi_s"}
    angles = geo.to_radians(source, given, dict.fromkeys(given, unit), names, table.numbers)
    geometry = geo.from_angles(source, angles, options.convention or "phi_specular_0")
    quantity, notes = stated_quantity(options, "brdf", "bsdf")
    behind = int(np.count_nonzero(np.abs(angles["theta_o"]) > np.pi / 2 + geo.HORIZON))
    if behind:
        notes.append(f"{behind} rows have theta_s beyond 90 deg: transmission, masked.")
    reading = Reading(
        NAME, quantity, scale * numbers[:, 2:], [Channel("value")], provenance={"scale": scale},
        notes=tuple(notes), angle_unit=unit,
    )  # fmt: skip
    return [assemble(source, options, reading, geometry, geo.find_grid(geometry))]


FORMAT = Format(NAME, "FRED scatter table text (type bsdf_data)", CONVENTIONS, sniff, read)


def _head(source: Source) -> tuple[str, float, int]:
    """Unit of the angles, factor of the values, number of header lines."""
    lines = [(k, line.split()) for k, line in enumerate(source.lines, start=1) if line.strip()]
    row, words = lines[1] if len(lines) > 1 else (len(source.lines), [])
    settings = dict(word.lower().split("=", 1) for word in words if "=" in word)
    try:
        scale = float(settings.get("scale", "1"))
    except ValueError:
        scale = np.nan
    known = {"angles", "bsdf", "scale"}
    if not (
        words and words[0].lower() == "format" and set(settings) <= known and np.isfinite(scale)
        and settings.get("angles") in ("deg", "rad") and settings.get("bsdf") == "value"
    ):  # fmt: skip
        raise source.error(
            f"the second line is {' '.join(words)[:60]!r}", "table-header", row=row, column="format",
            cause="another kind of FRED table, or a damaged header",
            remedy='export it as "format angles=deg bsdf=value scale=1"',
        )  # fmt: skip
    return settings["angles"], scale, row
