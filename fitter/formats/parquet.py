"""Parquet: the columns of delimited text, and its header lines as key-value metadata of the schema."""

from __future__ import annotations

import json
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.formats.arrow_columns import floats, refuse_same_names
from fitter.formats.output import write_aside
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format, Loss
from fitter.formats.source import Source
from fitter.formats.tabular import CONVENTIONS, read_columns
from fitter.formats.tabular_header import head_of
from fitter.formats.tabular_writer import sheet
from fitter.table import Table

FloatArray = NDArray[np.float64]

NAME = "parquet"
_MAGIC = b"PAR1"
#: Bytes the columns may unpack to, whatever their count of rows: runs of one value pack without limit.
LARGEST = 1 << 30
#: Metadata of the programs that wrote the file, not of the measurement.
FOREIGN_KEYS = frozenset({"pandas", "ARROW:schema"})


def sniff(head: bytes, size: int) -> float:
    """Sure by the first four bytes."""
    return 1.0 if head.startswith(_MAGIC) else 0.0


@dataclass(frozen=True)
class Columns:
    """The columns of a Parquet file, as the tabular reader wants them."""

    source: Source
    names: Sequence[str]
    numbers: range

    def __len__(self) -> int:
        return len(self.numbers)

    def floats(self, use: Sequence[int]) -> FloatArray:
        """The columns ``use`` as (n, len(use)); null is NaN. TableError for text, dates, nested columns."""
        return floats(
            self.source, self.names, len(self), use, self.column, lambda name: refusing(self.source, name)
        )

    def texts(self, column: int) -> list[str]:
        """One column as text, white space stripped; null is empty."""
        import pyarrow as arrow

        with refusing(self.source, self.names[column]):
            cells = self.column(column).cast(arrow.string()).to_pylist()
        return ["" if cell is None else str(cell).strip() for cell in cells]

    def column(self, k: int) -> Any:
        """Column ``k``, an Arrow chunked array."""
        name = self.names[k]
        with refusing(self.source, name):
            table = _open(self.source).read(columns=[name], use_threads=False)
            if table.column_names != [name] or table.num_rows != len(self):
                raise ValueError(f"{table.num_rows} rows of {', '.join(table.column_names)[:80]}")
            return table.column(0)


def read(source: Source, options: ReadOptions) -> list[Table]:
    """Tables of a Parquet file: one, or one for each wavelength or item where a column tells them apart."""
    source.begin_digest()
    with refusing(source, offset=_footer(source)):
        file = _open(source)
        schema, metadata = file.schema_arrow, file.metadata
        rows, names = int(metadata.num_rows), list(schema.names)
        groups = [int(metadata.row_group(k).num_rows) for k in range(metadata.num_row_groups)]
        said = statements(metadata.metadata or {})
    if rows < 1 or not names or sum(groups) != rows or min(groups) < 0:
        raise source.error(
            f"the file states {rows:,} rows of {len(names)} columns in {len(groups)} groups", "table-empty",
            offset=_footer(source), remedy="check that it is whole",
        )  # fmt: skip
    if rows * len(names) * 8 > LARGEST:
        raise source.error(
            f"the file states {rows:,} rows of {len(names)} columns, more than {LARGEST / 1e9:.1f} GB",
            "table-too-large", offset=_footer(source),
            remedy="write the columns of one table only, divide it, or use --out-of-core",
        )  # fmt: skip
    refuse_same_names(source, names)
    columns = Columns(source, names, range(1, rows + 1))
    del file  # nothing may hold the bytes when the columns have been read
    head = head_of(source, said, FOREIGN_KEYS)
    return read_columns(source, options, head, columns, format=NAME, text=False)


def write(table: Table, path: Path) -> list[Loss]:
    """Write ``table`` as Parquet: float64 columns and metadata that read back bit for bit."""
    import pyarrow as arrow
    from pyarrow import parquet

    content = sheet(table)
    said = {**content.statements, "notes": json.dumps(content.notes)}
    columns: dict[str, Any] = dict(content.columns)
    if content.usable is not None:
        columns["usable"] = content.usable
    arrays = [arrow.array(np.ascontiguousarray(column)) for column in columns.values()]
    sink = arrow.BufferOutputStream()
    parquet.write_table(arrow.table(arrays, names=list(columns), metadata=said), sink, compression="zstd")
    write_aside(path, [sink.getvalue().to_pybytes()])
    return []


FORMAT = Format(
    NAME,
    "Parquet columns declared as in delimited text",
    CONVENTIONS,
    sniff,
    read,
    write=write,
)


def _open(source: Source) -> Any:
    import pyarrow as arrow  # a fifth of a second, and only where such a file is met
    from pyarrow import parquet

    return parquet.ParquetFile(arrow.BufferReader(arrow.py_buffer(source.buffer)), pre_buffer=False)


def _footer(source: Source) -> int:
    """The byte at which the file's footer begins: its schema, and where its columns are."""
    end = max(source.size - 8, 0)
    length = int.from_bytes(bytes(source.buffer[end : end + 4]), "little")
    return end - length if length <= end else end


@contextmanager
def refusing(
    source: Source, column: str | None = None, offset: int | None = None
) -> Generator[None]:
    """Turn what pyarrow raises at damaged bytes into a TableError that names the column, or the byte."""
    from pyarrow import ArrowException

    try:
        yield
    except (ArrowException, OSError, ValueError, MemoryError) as error:
        reason = str(error).partition("\n")[0][:160]
        raise source.error(
            f"the Parquet file can't be read: {reason}", "table-truncated", column=column,
            offset=offset, cause="the file is cut off, damaged or encrypted", remedy="fetch the file again",
        ) from error  # fmt: skip


def statements(metadata: Mapping[bytes, bytes]) -> dict[str, str]:
    """The schema's key-value metadata as text."""
    return {key.decode(): text.decode() for key, text in metadata.items()}
