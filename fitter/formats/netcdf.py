"""Classic NetCDF (versions 1 and 2) with CF-style attributes: arrays over named dimensions.

Variables are the columns of delimited text, global attributes its header lines: see
:mod:`fitter.formats.arrays`. NetCDF-4 is another kind of file: :mod:`fitter.formats.hdf5` reads it.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.errors import TableError
from fitter.formats.arrays import Variable, tables_of, words_of
from fitter.formats.labelled import labelled
from fitter.formats.output import write_aside
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format, Loss
from fitter.formats.source import Source
from fitter.formats.tabular import CONVENTIONS
from fitter.table import Table

NAME = "netcdf"
_MAGIC = (b"CDF\x01", b"CDF\x02")


def sniff(head: bytes, size: int) -> float:
    """Sure by the first four bytes."""
    return 1.0 if head.startswith(_MAGIC) else 0.0


def read(source: Source, options: ReadOptions) -> list[Table]:
    """Tables of a NetCDF file: one, or one for each wavelength or item where a variable tells them apart."""
    stream = BytesIO(source.data)
    with _refusing(source, stream.tell):
        variables, said = _contents(source, stream)
    return tables_of(source, options, variables, said, format=NAME)


def write(table: Table, path: Path) -> list[Loss]:
    """Write ``table`` as classic NetCDF: float64 variables and attributes that read back bit for bit."""
    from scipy.io import netcdf_file  # a tenth of a second, and only here

    content = labelled(table)
    sink = BytesIO()
    file: Any = netcdf_file(sink, "w", version=2)
    for key, words in content.attributes.items():
        setattr(file, key, words.encode())
    for name, size in content.dimensions.items():
        file.createDimension(name, size)
    for name, (over, column, unit) in content.variables.items():
        variable = file.createVariable(name, "b" if column.dtype == np.int8 else "d", over)
        variable[:] = column
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
def _refusing(
    source: Source, at: Callable[[], int] | None = None, column: str | None = None
) -> Generator[None]:
    """Turn what the parser raises at damaged bytes into a TableError. ``at`` says how far it had read."""
    try:
        yield
    except TableError:
        raise
    except (
        ArithmeticError, AssertionError, AttributeError, LookupError, MemoryError, OSError, TypeError,
        ValueError,
    ) as error:  # fmt: skip
        raise source.error(
            "the NetCDF file can't be read", "table-truncated", column=column,
            offset=None if at is None else min(at(), source.size), cause="the file is cut off or damaged",
            remedy="fetch the file again",
        ) from error  # fmt: skip


def _contents(source: Source, stream: BytesIO) -> tuple[list[Variable], dict[str, str]]:
    """The variables that have numbers or text, and the global attributes as text."""
    from scipy.io import netcdf_file

    file: Any = netcdf_file(stream, "r", mmap=False)
    variables: list[Variable] = []
    for name, one in file.variables.items():
        with _refusing(source, column=str(name)[:40]):
            variables.append(_variable(str(name), one))
    said = {key: _plain(value) for key, value in file._attributes.items()}
    return variables, {key: str(value) for key, value in said.items()}


def _variable(name: str, one: Any) -> Variable:
    data: NDArray[Any] = np.asarray(one.data)
    dimensions = tuple(map(str, one.dimensions))
    attributes = {key: _plain(value) for key, value in one._attributes.items()}
    if data.dtype.kind == "S":  # characters: text along the last dimension
        data, dimensions = words_of(data if data.ndim else data.reshape(1)), dimensions[:-1]
        return Variable(name, dimensions, data.shape, attributes, lambda: data, text=True)
    if data.dtype.kind not in "iuf" or data.ndim != len(dimensions):
        raise ValueError(name)
    return Variable(name, dimensions, data.shape, attributes, lambda: data)


def _plain(value: Any) -> Any:
    return value.decode() if isinstance(value, bytes) else value
