"""Parts of a file that is too large for memory: Parquet and delimited text, each part an ordinary Table.

What a row means can't depend on the other rows here. Grids are therefore not looked for across parts,
repeated geometries are not masked, and a file that holds several tables is refused.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from fitter.errors import TableError
from fitter.formats import delimited, parquet
from fitter.formats.arrow_text import SEGMENT, plain_rows
from fitter.formats.delimited_header import head_of
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import detect
from fitter.formats.source import Source
from fitter.formats.tabular import Rows, read_columns
from fitter.formats.tabular_header import Head
from fitter.formats.tabular_header import head_of as header_of
from fitter.formats.text import Rows as TextRows
from fitter.metadata import Symmetry
from fitter.table import Table

#: Rows of a part: sixteen of the blocks that a fit works in.
ROWS = 1 << 20


@dataclass(frozen=True)
class Part:
    """``table`` holds the ``rows`` of one part, None if none is usable. symmetry : as the file states it."""

    table: Table | None
    rows: int
    symmetry: Symmetry | None


def parts(path: str | os.PathLike[str], options: ReadOptions, rows: int = ROWS) -> Iterator[Part]:
    """The parts of a file, in its order, of ``rows`` rows each (of a text: of about as many).

    Raises TableError as reading the whole file would, with rows numbered as in the file; and for a format
    that can't be read in parts.
    """
    source = Source(path)
    entry = detect(source)
    if entry.name == parquet.NAME:
        text, found = False, _batches(source, Path(path), rows)
    elif entry.name == delimited.NAME:
        text, found = True, _segments(source, Path(path), rows)
    else:
        raise source.error(
            f"{entry.name} files are not read in parts", "table-not-in-parts",
            remedy="load it whole, or convert it to Parquet or delimited text",
        )  # fmt: skip
    kept = replace(options, duplicates="keep")
    for of_part, head, piece in found:
        try:
            tables = read_columns(of_part, kept, head, piece, format=entry.name, text=text)
        except TableError as error:
            error.file = source.name
            if error.code != "table-nothing-usable":
                raise
            yield Part(None, len(piece), None)
            continue
        if len(tables) > 1 or "item" in tables[0].metadata.provenance:
            raise source.error(
                "the file holds several tables", "table-several", cause="a column tells them apart",
                remedy="divide it, or declare that column as 'ignore'",
            )  # fmt: skip
        yield Part(tables[0], len(piece), cast("Symmetry | None", head.stated.get("symmetry")))


@dataclass(frozen=True)
class _Batch(parquet.Columns):
    """The columns of some rows of a Parquet file, which are in memory already."""

    batch: Any

    def column(self, k: int) -> Any:
        import pyarrow

        return pyarrow.chunked_array([self.batch.column(k)])


def _batches(source: Source, path: Path, rows: int) -> Iterator[tuple[Source, Head, Rows]]:
    from pyarrow.parquet import ParquetFile

    with parquet.refusing(source):
        file = ParquetFile(path, pre_buffer=False)
        said = parquet.statements(file.metadata.metadata or {})
        names = list(file.schema_arrow.names)
        batches = iter(file.iter_batches(batch_size=rows))
    at = 1
    none = Source(b"", source.name)
    while True:
        with parquet.refusing(source):
            batch = next(batches, None)
        if batch is None:
            return
        numbers = range(at, at + batch.num_rows)
        at = numbers.stop
        head = _of_a_part(header_of(source, said, parquet.FOREIGN_KEYS))
        yield none, head, _Batch(source, names, numbers, batch)


def _segments(source: Source, path: Path, rows: int) -> Iterator[tuple[Source, Head, Rows]]:
    start, row, delimiter, names, head = head_of(source)
    body = source.head[start:]
    line = len(body) / max(1, body.count(b"\n"))
    size = min(max(int(rows * line), 1 << 10), 1 << 30)
    with path.open("rb") as file:
        file.seek(start)
        rest = b""
        while block := file.read(size):
            whole = rest + block
            end = whole.rfind(b"\n") + 1
            rest = whole[end:]
            if end:
                yield from _lines(source, whole[:end], row, delimiter, names, head)
                row += whole.count(b"\n", 0, end)
        if rest:
            yield from _lines(source, rest, row, delimiter, names, head)


def _lines(
    source: Source, text: bytes, row: int, delimiter: str | None, names: list[str], head: Head
) -> Iterator[tuple[Source, Head, Rows]]:
    """The rows in whole lines of a text, of which the first is number ``row``; nothing if all are blank."""
    part = Source(text, source.name)
    part.digest = ""  # of a part nobody asks for it

    def careful() -> TextRows:
        numbered = [
            (number, line.strip(" ")) for number, line in enumerate(part.lines, start=row)
            if line.strip() and not line.strip().startswith("#")
        ]  # fmt: skip
        numbers = np.array([number for number, _ in numbered], np.intp)
        return TextRows(part, [line for _, line in numbered], numbers, delimiter, names)

    rows = plain_rows(part, 0, row, delimiter, names, careful, SEGMENT) or careful()
    if len(rows):
        yield part, _of_a_part(head), rows


def _of_a_part(head: Head) -> Head:
    """Without what is said of the whole file only."""
    stated = {key: text for key, text in head.stated.items() if key not in ("rows", "grid", "periodic")}
    return replace(head, stated=stated)
