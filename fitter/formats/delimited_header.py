"""The head of a delimited text table: comment lines that state things, delimiter, header row."""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence

import numpy as np

from fitter.errors import TableError
from fitter.formats.arrow_text import SEGMENT, SMALLEST, PlainRows, plain_rows
from fitter.formats.columns import parse_column
from fitter.formats.source import Source
from fitter.formats.tabular_header import Head, state
from fitter.formats.text import Rows, is_number, split

_STATEMENT = re.compile(r"#+\s*([A-Za-z][\w ]*?)\s*:\s*(.*)")


def read_head(source: Source) -> tuple[Head, Rows | PlainRows]:
    """Statements and data rows of a text; column names are the header row's, or "column 0", ...

    Raises TableError where nothing but comments is there, or a statement can't be understood.
    """
    return (_plain(source) if source.size >= SMALLEST else None) or _word_by_word(source)


def _word_by_word(source: Source) -> tuple[Head, Rows]:
    head, rows = _rows(source, source.lines)
    promised = head.numbers.get("rows")
    if promised is not None and promised != len(rows):
        raise source.error(
            f"the file has {len(rows)} rows and states {promised:g}", "table-truncated",
            row=int(rows.numbers[-1]), cause="the file is cut off, or rows were added by hand",
            remedy="fetch the file again, or correct the line '# rows:'",
        )  # fmt: skip
    return head, rows


def head_of(source: Source) -> tuple[int, int, str | None, list[str], Head]:
    """What begins a large text: the byte and the row where its values begin, delimiter, names, statements.

    Raises TableError where its first bytes hold no row of values.
    """
    start = source.head if source.size <= len(source.head) else source.head[: source.head.rfind(b"\n") + 1]
    first = Source(start, source.name)
    head, rows = _rows(first, first.lines)
    row = int(rows.numbers[0])
    ends = re.finditer(rb"\r\n|\n|\r", start)
    at = 0
    for _ in range(row - 1):
        at = next(ends).end()
    mark = codecs.BOM_UTF8
    at = at or len(mark) * start.startswith(mark)
    return at, row, rows.delimiter, list(rows.names), head


def _plain(source: Source, segment: int = SEGMENT) -> tuple[Head, PlainRows] | None:
    """The same of a large text that pyarrow can read; None of all others, whatever is wrong with them."""
    try:
        start, row, delimiter, names, head = head_of(source)
    except TableError:
        return None
    if re.search(rb"\r(?!\n)", source.head[:start]):
        return None
    source.begin_digest()  # the sooner it is known, the sooner the text can go
    plain = plain_rows(
        source, start, row, delimiter, names, lambda: _word_by_word(source)[1], segment
    )  # fmt: skip
    return None if plain is None or head.numbers.get("rows", len(plain)) != len(plain) else (head, plain)


def _rows(source: Source, lines: Sequence[str]) -> tuple[Head, Rows]:
    head = Head()
    texts: list[str] = []
    numbers: list[int] = []
    for number, line in enumerate(lines, start=1):
        bare = line.strip()
        if not bare:
            continue
        if bare.startswith("#"):
            if not texts:
                _statement(source, head, bare, number)
            continue
        # Only white space that no delimiter gives meaning to may go.
        texts.append(line.strip(" "))
        numbers.append(number)
    if not texts:
        raise source.error(
            "the file holds comments but no rows", "table-empty", row=len(lines),
            remedy="check that it is whole",
        )  # fmt: skip
    delimiter = next((d for d in (";", "\t", ",") if d in texts[0]), None)
    first = split(texts[0], delimiter)
    if not all(is_number(cell) for cell in first):
        names = first[:-1] if len(first) > 1 and not first[-1] else first
        texts = texts[1:]
        if not texts:
            raise source.error(
                "the file has a header row but no rows of values", "table-empty", row=numbers[0],
                cause="the file is cut off", remedy="check that it is whole",
            )  # fmt: skip
        numbers = numbers[1:]
    else:
        names = _names_from_comment(head, len(first)) or [f"column {k}" for k in range(len(first))]
    return head, Rows(source, texts, np.asarray(numbers, np.intp), delimiter, names)


def _statement(source: Source, head: Head, line: str, row: int) -> None:
    match = _STATEMENT.fullmatch(line)
    head.comments.append(line.lstrip("#").strip())
    if match:
        state(source, head, match[1], match[2].strip(), row)


def _names_from_comment(head: Head, width: int) -> list[str] | None:
    """Column names from the last comment above the values (as numpy.savetxt writes them), if it has them."""
    if not head.comments:
        return None
    line = head.comments[-1]
    delimiter = next((d for d in (";", "\t", ",") if d in line), None)
    names = split(line, delimiter)
    return names if len(names) == width and any(parse_column(name) for name in names) else None
