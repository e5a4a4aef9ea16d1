"""Arrays over named dimensions, as NetCDF files and xarray hold them.

Variables are the columns of delimited text, global attributes its header lines. A coordinate variable stands
for its whole dimension, so a product grid is stored as axes and arrays.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.formats.columns import parse_column
from fitter.formats.read_options import ReadOptions
from fitter.formats.source import Source
from fitter.formats.tabular import read_columns
from fitter.formats.tabular_header import Head, note_list, state
from fitter.formats.tabular_writer import sheet
from fitter.grid import GRID_AXES
from fitter.table import Table

FloatArray = NDArray[np.float64]

#: Bytes the columns may take: a coordinate of few numbers stands for all rows.
LARGEST = 1 << 30
#: The conventions that the attributes follow.
CONVENTIONS_ATTRIBUTE = "CF-1.11"
#: Kinds of arrays that are numbers.
_NUMBERS = "biuf"
_UNITS = {
    "degree": "deg", "degrees": "deg", "deg": "deg", "radian": "rad", "radians": "rad", "rad": "rad",
    "nm": "nm", "nanometer": "nm", "nanometers": "nm", "um": "um", "micrometer": "um", "micrometers": "um",
    "micron": "um", "microns": "um",
}  # fmt: skip
#: Global attributes of the conventions themselves, not of the measurement.
_FOREIGN_KEYS = frozenset({"Conventions", "_NCProperties"})


@dataclass(frozen=True)
class Variable:
    """One array: its dimensions, its numbers as stored, its attributes (text decoded)."""

    name: str
    dimensions: tuple[str, ...]
    data: NDArray[Any]
    attributes: Mapping[str, Any]


@dataclass(frozen=True)
class _Columns:
    """Variables spread over ``shape``, the dimensions of the largest, as the tabular reader wants them."""

    source: Source
    variables: Sequence[Variable]
    names: Sequence[str]
    shape: Mapping[str, int]
    numbers: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.numbers)

    def floats(self, use: Sequence[int]) -> FloatArray:
        """The variables ``use`` as (n, len(use)); fill values are NaN, packed numbers unpacked."""
        if len(self) * len(use) * 8 > LARGEST:
            raise self.source.error(
                f"{len(use)} columns of {len(self):,} rows are more than {LARGEST / 1e9:.1f} GB",
                "table-too-large", remedy="write the variables of one table only, or divide it",
            )  # fmt: skip
        return np.stack([self._spread(k, self._numbers(k)) for k in use], axis=1)

    def texts(self, column: int) -> list[str]:
        """One variable as text: characters along its last dimension, or numbers as they are."""
        one = self.variables[column]
        if one.data.dtype.kind in "UO":
            return [word.strip() for word in self._spread(column, one.data.astype(str)).tolist()]
        if one.data.dtype.kind != "S":
            return [f"{value:.10g}" for value in self._spread(column, self._numbers(column)).tolist()]
        rows = one.data.reshape(*one.data.shape[:-1], -1)
        words = [
            b"".join(row).decode("utf-8", "replace").strip("\0 ") for row in rows.reshape(-1, rows.shape[-1])
        ]
        labels = np.asarray(words).reshape(rows.shape[:-1])
        return self._spread(column, labels, one.dimensions[:-1]).tolist()

    def _numbers(self, k: int) -> FloatArray:
        one = self.variables[k]
        if one.data.dtype.kind not in _NUMBERS:
            raise self.source.error(
                "the variable holds characters, not numbers", "table-not-a-number", column=self.names[k],
                remedy="store it as float or double, or declare it as 'ignore'",
            )  # fmt: skip
        values = one.data.astype(np.float64)
        for key in ("_FillValue", "missing_value"):
            if key in one.attributes:
                values[np.isin(one.data, np.asarray(one.attributes[key]).astype(one.data.dtype))] = np.nan
        scale, offset = _number(one, "scale_factor", 1.0), _number(one, "add_offset", 0.0)
        if (scale, offset) == (1.0, 0.0):
            return values  # adding 0 would turn -0.0 into 0.0
        with np.errstate(over="ignore", invalid="ignore"):
            return values * scale + offset

    def _spread(
        self, k: int, values: NDArray[Any], dimensions: tuple[str, ...] | None = None
    ) -> NDArray[Any]:
        """``values`` (over the variable's dimensions) at every row."""
        names = self.variables[k].dimensions if dimensions is None else dimensions
        if not set(names) <= set(self.shape) or len(set(names)) < len(names):
            raise self.source.error(
                f"the variable is over ({', '.join(names)}) and the values over ({', '.join(self.shape)})",
                "table-columns", column=self.names[k],
                remedy="give it dimensions that the values have, or declare it as 'ignore'",
            )  # fmt: skip
        order = sorted(range(len(names)), key=lambda i: list(self.shape).index(names[i]))
        size = [n if name in names else 1 for name, n in self.shape.items()]
        whole = np.broadcast_to(values.transpose(order).reshape(size), tuple(self.shape.values()))
        return whole.reshape(-1)


def read_labelled(
    source: Source,
    options: ReadOptions,
    variables: Sequence[Variable],
    said: Mapping[str, str],
    *,
    format: str,
) -> list[Table]:
    """Tables of labelled arrays: one, or one for each wavelength or item where a variable tells them apart.

    said : the global attributes, as text. format : name of the format they stand in. Raises TableError.
    """
    numeric = [one for one in variables if one.data.dtype.kind in _NUMBERS]
    largest = max(numeric, key=lambda one: (len(one.dimensions), one.data.size), default=None)
    if largest is None or largest.data.size == 0:
        raise source.error("no variable holds values", "table-empty", remedy="check that it is whole")
    names = [_column_name(source, one) for one in variables]
    shape = dict(zip(largest.dimensions, largest.data.shape, strict=True))
    if len(shape) < len(largest.dimensions) or not shape:
        raise source.error(
            f"the largest variable, {largest.name[:40]}, can't be a column", "table-columns",
            column=largest.name[:40], remedy="store numbers over named dimensions, each once",
        )  # fmt: skip
    head = Head()
    for key, words in said.items():
        if key == "notes":
            head.notes += note_list(source, words)
        elif key not in _FOREIGN_KEYS:
            state(source, head, key, words)
    rows = np.arange(1, largest.data.size + 1)
    columns = _Columns(source, variables, names, shape, rows)
    return read_columns(source, options, head, columns, format=format, text=False)


@dataclass(frozen=True)
class Labelled:
    """A table as labelled arrays. dimensions : name -> size; coordinates : those that are variables, too.

    variables : name -> (dimensions, array, units). attributes : global ones, text.
    """

    dimensions: Mapping[str, int]
    variables: Mapping[str, tuple[tuple[str, ...], NDArray[Any], str]]
    attributes: Mapping[str, str]


def labelled(table: Table) -> Labelled:
    """``table`` as float64 variables and attributes, from which :func:`read_labelled` makes it again."""
    content = sheet(table)
    axes: dict[str, FloatArray] = {}
    if table.grid is not None:
        axes = {f"{name}_rad": table.grid.axes[name] for name in GRID_AXES[table.grid.system]}
    dimensions = {name: len(axis) for name, axis in axes.items()} or {"sample": len(table)}
    columns: dict[str, NDArray[Any]] = dict(content.columns)
    if content.usable is not None:
        columns["usable"] = content.usable.astype(np.int8)
    variables: dict[str, tuple[tuple[str, ...], NDArray[Any], str]] = {}
    for name, column in columns.items():
        unit = "radian" if name in axes else "sr-1" if name.startswith(("brdf", "sigma")) else "1"
        if name in axes:
            variables[name] = ((name,), axes[name], unit)
        else:
            variables[name] = (tuple(dimensions), column.reshape(tuple(dimensions.values())), unit)
    attributes = {
        "Conventions": CONVENTIONS_ATTRIBUTE, **content.statements, "notes": json.dumps(content.notes)
    }  # fmt: skip
    return Labelled(dimensions, variables, attributes)


def _number(one: Variable, key: str, default: float) -> float:
    value = np.asarray(one.attributes.get(key, default))
    return float(value.reshape(-1)[0]) if value.dtype.kind in "iuf" and value.size else default


def _column_name(source: Source, one: Variable) -> str:
    """The variable's name, with the unit its attribute states where the name has none."""
    stated = str(one.attributes.get("units", "")).strip().lower()
    unit = _UNITS.get(stated)
    bare = "wavelength" if one.name.lower() in ("wavelength", "lambda") else one.name
    column = parse_column(bare)
    if bare == "wavelength" and unit in ("nm", "um"):
        return f"wavelength_{unit}"
    if column is None or column.kind not in ("angle", "wavelength") or unit is None:
        return one.name
    if column.unit is None:
        return f"{one.name}_{unit}"
    if column.unit != unit:
        raise source.error(
            f"the variable is named in {column.unit} and its units are {stated[:20]}", "table-unit",
            column=one.name[:40], remedy="correct its name or its attribute 'units'",
        )  # fmt: skip
    return one.name
