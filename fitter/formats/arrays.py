"""Arrays over named dimensions (NetCDF, HDF5) as columns of a table, with CF's attributes obeyed.

A variable over fewer dimensions than the largest is spread over the others, so a product grid is stored as
axes and arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.formats.columns import parse_column
from fitter.formats.read_options import ReadOptions
from fitter.formats.source import Source
from fitter.formats.tabular import read_columns
from fitter.formats.tabular_header import head_of
from fitter.table import Table

FloatArray = NDArray[np.float64]

#: Bytes the columns may take: a coordinate of few numbers stands for all rows.
LARGEST = 1 << 30
_UNITS = {
    "degree": "deg", "degrees": "deg", "deg": "deg", "radian": "rad", "radians": "rad", "rad": "rad",
    "nm": "nm", "nanometer": "nm", "nanometers": "nm", "um": "um", "micrometer": "um", "micrometers": "um",
    "micron": "um", "microns": "um",
}  # fmt: skip
#: Global attributes of the conventions themselves, not of the measurement.
_FOREIGN_KEYS = frozenset({"Conventions", "_NCProperties"})


@dataclass(frozen=True)
class Variable:
    """One array: its name, its dimensions (a name and a size for each axis), its attributes (text decoded).

    read : its numbers as stored; text as an object array of str. text : whether it holds text.
    """

    name: str
    dimensions: tuple[str, ...]
    shape: tuple[int, ...]
    attributes: Mapping[str, Any]
    read: Callable[[], NDArray[Any]]
    text: bool = False

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return prod(self.shape)


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
        values = np.empty((len(self), len(use)))
        for j, k in enumerate(use):
            self._check(k)
            values[:, j] = self._spread(k, self._numbers(k))
        return values

    def texts(self, column: int) -> list[str]:
        """One variable as text, numbers as they are."""
        self._check(column)
        if self.variables[column].text:
            return self._spread(column, self.variables[column].read()).tolist()
        return [f"{value:.10g}" for value in self._spread(column, self._numbers(column)).tolist()]

    def _numbers(self, k: int) -> FloatArray:
        one = self.variables[k]
        if one.text:
            raise self.source.error(
                "the variable holds characters, not numbers", "table-not-a-number", column=self.names[k],
                remedy="store it as float or double, or declare it as 'ignore'",
            )  # fmt: skip
        data = one.read()
        values = data.astype(np.float64)
        for key in ("_FillValue", "missing_value"):
            fill = np.asarray(one.attributes.get(key, np.empty(0)))
            if fill.dtype.kind in "iuf" and fill.size:
                with np.errstate(over="ignore", invalid="ignore"):
                    values[np.isin(data, fill.astype(data.dtype))] = np.nan
        scale, offset = _number(one, "scale_factor", 1.0), _number(one, "add_offset", 0.0)
        if (scale, offset) == (1.0, 0.0):
            return values  # adding 0 would turn -0.0 into 0.0
        with np.errstate(over="ignore", invalid="ignore"):
            return values * scale + offset

    def _check(self, k: int) -> None:
        one = self.variables[k]
        names = one.dimensions
        if len(set(names)) == len(names) and all(
            self.shape.get(name) == n for name, n in zip(names, one.shape, strict=True)
        ):
            return
        here, there = (
            ", ".join(f"{name}: {n}" for name, n in pairs)
            for pairs in (zip(names, one.shape, strict=True), self.shape.items())
        )
        raise self.source.error(
            f"the variable is over ({here}) and the values over ({there})", "table-columns",
            column=self.names[k],
            remedy="give it dimensions that the values have (in HDF5: scales, or labels of their axes), "
            "or declare it as 'ignore'",
        )  # fmt: skip

    def _spread(self, k: int, values: NDArray[Any]) -> NDArray[Any]:
        """``values`` (over the variable's dimensions) at every row."""
        names = self.variables[k].dimensions
        order = sorted(range(len(names)), key=lambda i: list(self.shape).index(names[i]))
        size = [n if name in names else 1 for name, n in self.shape.items()]
        whole = np.broadcast_to(values.transpose(order).reshape(size), tuple(self.shape.values()))
        return whole.reshape(-1)


def tables_of(
    source: Source,
    options: ReadOptions,
    variables: Sequence[Variable],
    said: Mapping[str, str],
    *,
    format: str,
    group: str | None = None,
) -> list[Table]:
    """Tables of variables: one, or one for each wavelength or item where a variable tells them apart.

    said : global attributes as text, the header lines of delimited text. group : the name of these variables
    where the file has several such tables. Raises TableError.
    """
    numeric = [one for one in variables if not one.text]
    at = shaping([(one.name, one.shape) for one in numeric], options)
    largest = None if at is None else numeric[at]
    if largest is None or largest.size == 0:
        raise source.error("the file holds no values", "table-empty", remedy="check that it is whole")
    names = [_column_name(source, one) for one in variables]
    shape = dict(zip(largest.dimensions, largest.shape, strict=True))
    if len(shape) < len(largest.dimensions) or not shape:
        raise source.error(
            f"the largest variable, {largest.name[:40]}, can't be a column", "table-columns",
            column=largest.name[:40], remedy="store numbers over named dimensions, each once",
        )  # fmt: skip
    if largest.size * 8 > LARGEST:  # before the rows are numbered
        raise source.error(
            f"the largest variable, {largest.name[:40]}, has {largest.size:,} numbers, more than "
            f"{LARGEST / 1e9:.1f} GB", "table-too-large", column=largest.name[:40],
            remedy="write the variables of one table only, or divide it",
        )  # fmt: skip
    head = head_of(source, said, _FOREIGN_KEYS)
    columns = _Columns(source, variables, names, shape, np.arange(1, largest.size + 1))
    return read_columns(source, options, head, columns, format=format, text=False, group=group)


def shaping(arrays: Sequence[tuple[str, tuple[int, ...]]], options: ReadOptions) -> int | None:
    """Which of the arrays (name, shape) shapes the table: the largest of the values, else of all."""
    declared = dict(options.columns)
    named = {k: parse_column(declared.get(name, name)) for k, (name, _) in enumerate(arrays)}
    values = [k for k, column in named.items() if column is not None and column.kind == "value"]
    return max(
        values or range(len(arrays)), key=lambda k: (len(arrays[k][1]), prod(arrays[k][1])), default=None
    )


def words_of(characters: NDArray[Any]) -> NDArray[Any]:
    """Text that stands as characters along the last axis (..., n) as an object array of str (...)."""
    rows = characters.reshape(-1, characters.shape[-1]) if characters.size else np.empty((0, 1), "S1")
    words = [b"".join(row).decode("utf-8", "replace").strip("\0 ") for row in rows]
    return np.asarray(words, object).reshape(characters.shape[:-1])


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
