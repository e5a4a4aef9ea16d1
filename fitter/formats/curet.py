"""CUReT: ``abrdf.dat`` (a line of 205 values for each sample) and ``table.txt`` (the 205 geometries).

K. J. Dana, B. van Ginneken, S. K. Nayar, J. J. Koenderink 1999, "Reflectance and texture of real-world
surfaces". ``rbrdf.dat``, ``gbrdf.dat`` and ``bbrdf.dat`` have the same layout, one for each colour channel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter.formats import geometry as geo
from fitter.formats.assemble import Reading, assemble, stated_quantity
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format
from fitter.formats.source import HEAD, Source
from fitter.formats.text import Rows
from fitter.metadata import Channel
from fitter.table import Table

FloatArray = NDArray[np.float64]

NAME = "curet"
CONVENTIONS = ("phi_specular_180", "phi_specular_0")
GEOMETRIES = 205
_GEOMETRY_NAMES = ("index", "theta_v", "phi_v", "theta_i", "phi_i")
_COLOURS = {"rbrdf": "R", "gbrdf": "G", "bbrdf": "B"}


def sniff(head: bytes, size: int) -> float:
    """Sure of a first line with 206 numbers, and of exactly 205 lines numbered 1 ... 205 with 5 numbers."""
    lines = head.strip().splitlines()
    if not lines:
        return 0.0
    first = lines[0].split()
    if (
        len(first) == GEOMETRIES + 1
        and _number(first[0]).is_integer()
        and not np.isnan(_numbers(first)).any()
    ):
        return 0.95
    # Whole, it is a sixth of the head; a longer file is another one.
    if size > HEAD or len(lines) != GEOMETRIES or len(first) != len(_GEOMETRY_NAMES):
        return 0.0
    return 0.95 if all(line.split()[:1] == [b"%d" % k] for k, line in enumerate(lines, start=1)) else 0.0


def read(source: Source, options: ReadOptions) -> list[Table]:
    """The tables of a file of values, with the geometry in ``table.txt`` beside it."""
    beside = source.beside("table.txt")
    return together([source] if beside is None else [source, beside], options)


def together(sources: Sequence[Source], options: ReadOptions) -> list[Table]:
    """One table for each sample (``item`` is its number); red, green and blue files give its channels."""
    geometry_files = [s for s in sources if _is_geometry(s)]
    value_files = [s for s in sources if not _is_geometry(s)]
    if not value_files:
        raise sources[0].error(
            "this file holds the geometries of CUReT's tables, not their values", "table-geometry-only",
            remedy="load the folder or zip archive that holds abrdf.dat and table.txt",
        )  # fmt: skip
    if not geometry_files:
        raise value_files[0].error(
            "this file holds CUReT's values, not their directions", "table-geometry-missing",
            remedy="put table.txt beside it, or load the folder or zip archive that holds both",
        )  # fmt: skip
    geometry = _geometry(geometry_files[0], options)
    coloured = {_COLOURS[s.stem.lower()]: s for s in value_files if s.stem.lower() in _COLOURS}
    if len(coloured) == 3:
        files = [_Values(coloured[c], *_values(coloured[c])) for c in "RGB"]
        left_out = [s.name for s in value_files if s not in coloured.values()]
        note = [f"Not read, as the colour channels are there: {', '.join(map(str, left_out))}."] * bool(
            left_out
        )
        return [table for item in _common(files) for table in [_table(files, item, geometry, options, note)]]
    tables: list[Table] = []
    for source in value_files:
        file = _Values(source, *_values(source))
        tables += [_table([file], item, geometry, options, []) for item in file.items]
    return tables


FORMAT = Format(
    NAME, "CUReT abrdf.dat with table.txt, a table for each sample", CONVENTIONS, sniff, read, together
)


@dataclass(frozen=True)
class _Values:
    source: Source
    items: list[int]
    values: FloatArray


def _is_geometry(source: Source) -> bool:
    return len(source.head.strip().split(b"\n", 1)[0].split()) == len(_GEOMETRY_NAMES)


def _values(source: Source) -> tuple[list[int], FloatArray]:
    numbered = [(n, line) for n, line in enumerate(source.lines, start=1) if line.strip()]
    rows = np.asarray([n for n, _ in numbered], np.intp)
    names = ["sample", *(f"value {k}" for k in range(1, GEOMETRIES + 1))]
    numbers = Rows(source, [line for _, line in numbered], rows, None, names).floats(range(len(names)))
    seen: set[float] = set()
    for row, number in zip(rows, numbers[:, 0].tolist(), strict=True):
        if not number.is_integer() or not 0 < number < 10_000 or number in seen:
            raise source.error(
                f"the sample number is {number:g}", "table-item", row=int(row), column="sample",
                cause="a sample that is there twice" if number in seen else "a damaged row",
                remedy="begin every row with a sample number of its own",
            )  # fmt: skip
        seen.add(number)
    return [int(number) for number in numbers[:, 0]], numbers[:, 1:]


def _geometry(source: Source, options: ReadOptions) -> geo.Geometry:
    numbered = [(n, line) for n, line in enumerate(source.lines, start=1) if line.strip()]
    numbers = np.asarray([n for n, _ in numbered], np.intp)
    rows = Rows(source, [line for _, line in numbered], numbers, None, _GEOMETRY_NAMES)
    columns = rows.floats(range(len(_GEOMETRY_NAMES))).T
    if not np.array_equal(columns[0], np.arange(1, GEOMETRIES + 1)):
        raise source.error(
            f"the geometries are not numbered 1 to {GEOMETRIES}", "table-truncated", row=int(numbers[-1]),
            column="index", cause="a row is missing or out of order", remedy="fetch the file again",
        )  # fmt: skip
    roles: list[str] = ["theta_o", "phi_o", "theta_i", "phi_i"]
    given = dict(zip(roles, columns[1:], strict=True))
    names = dict(zip(roles, _GEOMETRY_NAMES[1:], strict=True))
    angles = geo.to_radians(source, given, dict.fromkeys(given, "rad"), names, numbers)
    return geo.from_angles(source, angles, options.convention)


def _table(
    files: Sequence[_Values], item: int, geometry: geo.Geometry, options: ReadOptions, notes: Sequence[str]
) -> Table:
    quantity, against = stated_quantity(options, "brdf", "BRDF")
    values = np.stack([file.values[file.items.index(item)] for file in files], axis=1)
    channels = [Channel(c) for c in "RGB"] if len(files) == 3 else [Channel("value")]
    reading = Reading(
        NAME, quantity, values, channels, item=str(item), provenance={"sample": item},
        notes=("Values have three decimals.", *notes, *against), angle_unit="rad",
    )  # fmt: skip
    return assemble(files[0].source, options, reading, geometry)


def _common(files: Sequence[_Values]) -> list[int]:
    for file in files[1:]:
        if file.items != files[0].items:
            raise file.source.error(
                f"its samples are not those of {files[0].source.name}", "table-item", column="sample",
                cause="files of different versions", remedy="fetch the files again",
            )  # fmt: skip
    return files[0].items


def _numbers(words: Sequence[bytes]) -> FloatArray:
    return np.array([_number(word) for word in words])


def _number(word: bytes) -> float:
    try:
        return float(word)
    except ValueError:
        return np.nan
