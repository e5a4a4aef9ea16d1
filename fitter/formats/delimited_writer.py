"""Writing a table as self-describing delimited text that reads back bit for bit."""

from __future__ import annotations

import os
from collections.abc import Iterator

from fitter.formats.output import write_aside
from fitter.formats.tabular_writer import sheet
from fitter.table import Table


def write_delimited(table: Table, path: str | os.PathLike[str]) -> None:
    """Write ``table`` to ``path`` as comma-separated text, aside first and then renamed.

    Directions of scattered tables are vector components, those of grids their axes in radians; numbers
    have as many digits as a float64 needs, so geometry, values, sigma, channels, mask and hash come back
    exactly. Values are f_r in 1/sr. A table that keeps negatives or duplicates must be read so again.
    """
    write_aside(path, (f"{line}\n".encode() for line in _lines(table)))


def _lines(table: Table) -> Iterator[str]:
    content = sheet(table)
    yield from (f"# {key}: {text}" for key, text in content.statements.items())
    yield from (f"# note: {note}" for note in content.notes)
    yield f"# rows: {len(table)}"
    names = list(content.columns)
    blocks = [column.tolist() for column in content.columns.values()]
    yield ",".join(names if content.usable is None else [*names, "usable"])
    marks = None if content.usable is None else content.usable.tolist()
    for k, numbers in enumerate(zip(*blocks, strict=True)):
        cells = [repr(number) for number in numbers]
        if marks is not None:
            cells.append("1" if marks[k] else "0")
        yield ",".join(cells)
