"""Arrow: columns of data frames (pandas, Polars) and Arrow tables, which mean what those of text mean.

All of them hand over their columns through the Arrow C stream. What delimited text states in its header
lines is the schema's metadata in an Arrow table and ``attrs`` of a pandas frame; Polars has no place for it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from fitter.formats.arrow_columns import floats, refuse_same_names
from fitter.formats.extras import optional_package
from fitter.formats.read_options import ReadOptions
from fitter.formats.source import Source
from fitter.formats.tabular import read_columns
from fitter.formats.tabular_header import Head, note_list, state
from fitter.formats.tabular_writer import sheet
from fitter.table import Table

FloatArray = NDArray[np.float64]

#: Metadata that belongs to the program that made the table, not to the measurement.
_FOREIGN_KEYS = frozenset({"pandas", "ARROW:schema"})
#: What pandas calls an index that has no name: row labels that mean nothing.
_UNNAMED_INDEX = re.compile(r"__index_level_\d+__")


@dataclass(frozen=True)
class _Columns:
    """The columns of an Arrow table, as the tabular reader wants them."""

    source: Source
    table: Any
    names: Sequence[str]
    numbers: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.numbers)

    def floats(self, use: Sequence[int]) -> FloatArray:
        """The columns ``use`` as (n, len(use)); null is NaN. TableError for text, dates, nested columns."""
        return floats(
            self.source, self.names, len(self), use, self.table.column,
            lambda name: _refusing(self.source, name),
        )  # fmt: skip

    def texts(self, column: int) -> list[str]:
        """One column as text, white space stripped; null is empty."""
        with _refusing(self.source, self.names[column]):
            cells: list[object] = self.table.column(column).to_pylist()
        return ["" if cell is None else str(cell).strip() for cell in cells]


def read_arrow(source: Source, given: Any, options: ReadOptions) -> list[Table]:
    """Tables in an object with ``__arrow_c_stream__``: one, or one for each wavelength or item.

    Raises TableError.
    """
    import pyarrow as arrow

    with _refusing(source):
        table: Any = arrow.RecordBatchReader.from_stream(given).read_all()
    kept = [k for k, name in enumerate(table.column_names) if not _UNNAMED_INDEX.fullmatch(name)]
    table = table.select(kept)
    names: list[str] = list(table.column_names)
    if not names or not table.num_rows:
        raise source.error(
            f"the table has {table.num_rows:,} rows of {len(names)} columns", "table-empty",
            remedy="check what was selected of it",
        )  # fmt: skip
    refuse_same_names(source, names)
    columns = _Columns(source, table, names, np.arange(1, table.num_rows + 1))
    head = _head(source, table.schema.metadata or {})
    return read_columns(source, options, head, columns, format="arrow", text=False)


def arrow_table(table: Table) -> Any:
    """``table`` as a ``pyarrow.Table`` of float64 columns whose schema's metadata states the rest.

    :func:`fitter.load` makes the same table of it again, bit for bit.
    """
    import pyarrow as arrow

    columns, said, notes = _sheet(table)
    arrays = [arrow.array(np.ascontiguousarray(column)) for column in columns.values()]
    return arrow.table(arrays, names=list(columns), metadata={**said, "notes": json.dumps(notes)})


def pandas_frame(table: Table) -> Any:
    """``table`` as a ``pandas.DataFrame``; ``attrs`` state what columns can't. TableError without pandas."""
    pandas = optional_package("pandas", None, "data frames of pandas", table.metadata.name or None)
    columns, said, notes = _sheet(table)
    frame = pandas.DataFrame(columns)
    frame.attrs = {**said, "notes": notes}
    return frame


def polars_frame(table: Table) -> Any:
    """``table`` as a ``polars.DataFrame``, which holds its columns and nothing else. TableError without."""
    polars = optional_package("polars", None, "data frames of Polars", table.metadata.name or None)
    columns = _sheet(table)[0]
    return polars.DataFrame({name: np.ascontiguousarray(column) for name, column in columns.items()})


def _sheet(table: Table) -> tuple[dict[str, NDArray[Any]], dict[str, str], list[str]]:
    """Columns, statements and notes of a table."""
    content = sheet(table)
    columns: dict[str, NDArray[Any]] = dict(content.columns)
    if content.usable is not None:
        columns["usable"] = content.usable
    return columns, dict(content.statements), list(content.notes)


def _head(source: Source, metadata: Mapping[bytes, bytes]) -> Head:
    """Statements in the schema's metadata, and those that pandas hands on there from ``attrs``."""
    with _refusing(source):
        said: dict[str, object] = {key.decode(): text.decode() for key, text in metadata.items()}
        frame = json.loads(str(said.get("pandas", "{}")))
    attributes = cast("dict[str, Any]", frame).get("attributes") if isinstance(frame, dict) else None
    if isinstance(attributes, dict):
        said |= cast("dict[str, object]", attributes)
    head = Head()
    for key, words in said.items():
        if key == "notes":
            head.notes += note_list(source, words if isinstance(words, str) else json.dumps(words))
        elif key not in _FOREIGN_KEYS:
            state(source, head, key, words if isinstance(words, str) else json.dumps(words))
    return head


@contextmanager
def _refusing(source: Source, column: str | None = None) -> Generator[None]:
    """Turn what the other library raises into a TableError."""
    import pyarrow as arrow

    try:
        yield
    except (arrow.ArrowException, ValueError, TypeError, NotImplementedError) as error:
        reason = str(error).partition("\n")[0][:160]
        raise source.error(
            f"the columns can't be taken over: {reason}", "table-columns", column=column,
            cause="a column of mixed or unusual types",
            remedy="give columns of numbers only, and of text for item",
        ) from error  # fmt: skip
