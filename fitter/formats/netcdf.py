"""Classic NetCDF (versions 1 and 2) with CF-style attributes: arrays over named dimensions.

Variables are the columns of delimited text, global attributes its header lines. A coordinate variable stands
for its whole dimension, so a product grid is stored as axes and arrays. NetCDF-4, which is HDF5, is not read:
the HDF5 library ends the whole process at some damaged files.
"""

from __future__ import annotations

import json
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.formats.columns import parse_column
from fitter.formats.output import write_aside
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format, Loss
from fitter.formats.source import Source
from fitter.formats.tabular import CONVENTIONS, read_columns
from fitter.formats.tabular_header import Head, note_list, state
from fitter.formats.tabular_writer import sheet
from fitter.grid import GRID_AXES
from fitter.table import Table

FloatArray = NDArray[np.float64]

NAME = "netcdf"
_MAGIC = (b"CDF\x01", b"CDF\x02")
#: Bytes the columns may take: a coordinate of few numbers stands for all rows.
LARGEST = 1 << 30
_UNITS = {
    "degree": "deg", "degrees": "deg", "deg": "deg", "radian": "rad", "radians": "rad", "rad": "rad",
    "nm": "nm", "nanometer": "nm", "nanometers": "nm", "um": "um", "micrometer": "um", "micrometers": "um",
    "micron": "um", "microns": "um",
}  # fmt: skip
#: Global attributes of the conventions themselves, not of the measurement.
_FOREIGN_KEYS = frozenset({"Conventions", "_NCProperties"})


def sniff(head: bytes, size: int) -> float:
    """Sure by the first four bytes."""
    return 1.0 if head.startswith(_MAGIC) else 0.0


@dataclass(frozen=True)
class _Variable:
    """One array: its dimensions, its numbers as stored, its attributes (text decoded)."""

    name: str
    dimensions: tuple[str, ...]
    data: NDArray[Any]
    attributes: Mapping[str, Any]


@dataclass(frozen=True)
class _Columns:
    """Variables spread over ``shape``, the dimensions of the largest, as the tabular reader wants them."""

    source: Source
    variables: Sequence[_Variable]
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
        if one.data.dtype.kind not in "iuf":
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


def read(source: Source, options: ReadOptions) -> list[Table]:
    """Tables of a NetCDF file: one, or one for each wavelength or item where a variable tells them apart."""
    with _refusing(source):
        variables, said = _contents(source)
        numeric = [one for one in variables if one.data.dtype.kind != "S"]
        largest = max(numeric, key=lambda one: (len(one.dimensions), one.data.size), default=None)
    if largest is None or largest.data.size == 0:
        raise source.error("the file holds no values", "table-empty", remedy="check that it is whole")
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
    return read_columns(source, options, head, columns, format=NAME, text=False)


def write(table: Table, path: Path) -> list[Loss]:
    """Write ``table`` as classic NetCDF: float64 variables and attributes that read back bit for bit."""
    from scipy.io import netcdf_file  # a tenth of a second, and only here

    content = sheet(table)
    sink = BytesIO()
    file: Any = netcdf_file(sink, "w", version=2)
    file.Conventions = b"CF-1.11"
    for key, words in {**content.statements, "notes": json.dumps(content.notes)}.items():
        setattr(file, key, words.encode())
    axes: dict[str, FloatArray] = {}
    if table.grid is not None:
        axes = {f"{name}_rad": table.grid.axes[name] for name in GRID_AXES[table.grid.system]}
    dimensions = {name: len(axis) for name, axis in axes.items()} or {"sample": len(table)}
    for name, size in dimensions.items():
        file.createDimension(name, size)
    columns: dict[str, NDArray[Any]] = dict(content.columns)
    if content.usable is not None:
        columns["usable"] = content.usable.astype(np.int8)
    for name, column in columns.items():
        over = (name,) if name in axes else tuple(dimensions)
        variable = file.createVariable(name, "b" if name == "usable" else "d", over)
        variable[:] = axes[name] if name in axes else column.reshape(tuple(dimensions.values()))
        unit = "radian" if name in axes else "sr-1" if name.startswith(("brdf", "sigma")) else "1"
        variable.units = unit.encode()
    file.flush()
    write_aside(path, [sink.getvalue()])
    file.close()
    return []


FORMAT = Format(
    NAME,
    "Classic NetCDF with CF-style attributes, variables named as in delimited text",
    CONVENTIONS,
    sniff,
    read,
    write=write,
)


@contextmanager
def _refusing(source: Source) -> Generator[None]:
    """Turn what the parser raises at damaged bytes into a TableError."""
    try:
        yield
    except (
        ArithmeticError, AssertionError, AttributeError, LookupError, MemoryError, OSError, TypeError,
        ValueError,
    ) as error:  # fmt: skip
        raise source.error(
            "the NetCDF file can't be read", "table-truncated", cause="the file is cut off or damaged",
            remedy="fetch the file again",
        ) from error  # fmt: skip


def _contents(source: Source) -> tuple[list[_Variable], dict[str, str]]:
    """The variables that have numbers or text, and the global attributes as text."""
    from scipy.io import netcdf_file

    file: Any = netcdf_file(BytesIO(source.data), "r", mmap=False)
    variables = [
        _Variable(
            str(name), tuple(map(str, one.dimensions)), np.asarray(one.data),
            {key: _plain(value) for key, value in one._attributes.items()},
        )
        for name, one in file.variables.items()
    ]  # fmt: skip
    said = {key: _plain(value) for key, value in file._attributes.items()}
    return variables, {key: str(value) for key, value in said.items()}


def _plain(value: Any) -> Any:
    return value.decode() if isinstance(value, bytes) else value


def _number(one: _Variable, key: str, default: float) -> float:
    value = np.asarray(one.attributes.get(key, default))
    return float(value.reshape(-1)[0]) if value.dtype.kind in "iuf" and value.size else default


def _column_name(source: Source, one: _Variable) -> str:
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
