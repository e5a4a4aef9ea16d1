"""Rows of a large plain text by pyarrow, where that means the same as reading them word by word.

Plain is a body of ASCII lines without quotes, comments, blank lines or odd control characters. There
pyarrow's cells are those of :mod:`fitter.formats.text`. A cell it does not take for a number, or a row of
another width, is left to the careful reader, which knows more words for a missing one and names the place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.formats.source import Source
from fitter.formats.text import MISSING, Rows
from fitter.parts import in_parts

FloatArray = NDArray[np.float64]

#: Smaller texts are read word by word before pyarrow is even imported.
SMALLEST = 1 << 21
#: Bytes that are parsed at a time.
SEGMENT = 1 << 24
#: Bytes that are looked through at a time: they stay in the cache.
_CHECKED = 1 << 18
#: A line is rarely longer: where a part of the text ends is looked for in its last bytes.
_LINE = 1 << 12
_NEWLINE, _RETURN, _TAB, _SPACE, _PLUS = b"\n\r\t +"
#: A quote, a comment, or a "nan(...)" that only pyarrow takes for a number, and where such marks stand.
_MARKS = np.frombuffer(b'"#(', np.uint8)
_LOWEST, _MARK_SPAN = _MARKS.min(), np.ptp(_MARKS)

#: Words for a missing value as people write them; "nan" itself is a number to pyarrow.
_MISSING = sorted({form(word) for word in MISSING - {"nan"} for form in (str.lower, str.upper, str.title)})


@dataclass(frozen=True)
class PlainRows:
    """The rows of ``source`` from byte ``start`` on, parsed when asked for; used as :class:`text.Rows` are.

    numbers : their rows in the file, from 1. careful : gives the same rows read word by word.
    """

    source: Source
    start: int
    numbers: range
    delimiter: str | None
    names: Sequence[str]
    careful: Callable[[], Rows]
    segment: int = SEGMENT

    def __len__(self) -> int:
        return len(self.numbers)

    def floats(self, use: Sequence[int]) -> FloatArray:
        """The columns ``use`` as (n, len(use)); missing cells are NaN. TableError on any other text."""
        import pyarrow

        found = np.empty((len(use), len(self))).T  # each column contiguous
        at = 0
        for parsed in self._parsed(use, pyarrow.float64()):
            if parsed is None or at + len(parsed) > len(self):
                return self._word_by_word.floats(use)
            for k, column in enumerate(parsed.columns):
                filled = at
                for chunk in column.chunks:
                    found[filled : filled + len(chunk), k] = chunk.to_numpy(zero_copy_only=False)
                    filled += len(chunk)
            at += len(parsed)
        return found if at == len(self) else self._word_by_word.floats(use)

    def texts(self, column: int) -> list[str]:
        """One column as written, white space stripped."""
        import pyarrow

        found: list[str] = []
        for parsed in self._parsed([column], pyarrow.string()):
            if parsed is None:
                return self._word_by_word.texts(column)
            found += [str(cell).strip() for cell in parsed.column(0).to_pylist()]
        return found if len(found) == len(self) else self._word_by_word.texts(column)

    @cached_property
    def _word_by_word(self) -> Rows:
        return self.careful()

    def _parsed(self, use: Sequence[int], kind: Any) -> Iterator[Any]:
        """An Arrow table of each segment's columns ``use``; None where it can't be one."""
        import pyarrow
        from pyarrow import csv

        names = [str(k) for k in range(len(self.names))]
        wanted = [str(k) for k in use]
        read = csv.ReadOptions(column_names=names)
        layout = csv.ParseOptions(delimiter=self.delimiter or " ", quote_char=False)
        convert = csv.ConvertOptions(
            include_columns=wanted, column_types=dict.fromkeys(wanted, kind), null_values=_MISSING,
            strings_can_be_null=False, check_utf8=False,
        )  # fmt: skip

        def parse(segment: memoryview) -> Any:
            text = segment if self.delimiter else _squeezed(bytes(segment))
            try:
                return csv.read_csv(pyarrow.BufferReader(text), read, layout, convert)
            except pyarrow.ArrowInvalid:
                return None

        # The next segment is parsed while the caller works on one.
        with ThreadPoolExecutor(1) as pool:
            ahead: Future[Any] | None = None
            for segment in _segments(self.source, self.start, self.segment):
                one, ahead = ahead, pool.submit(parse, segment)
                if one is not None:
                    yield one.result()
            if ahead is not None:
                yield ahead.result()


def plain_rows(
    source: Source, start: int, row: int, delimiter: str | None, names: Sequence[str],
    careful: Callable[[], Rows], segment: int = SEGMENT,
) -> PlainRows | None:  # fmt: skip
    """The rows from byte ``start``, where row ``row`` begins, to the end; None where the text isn't plain."""
    # Blank lines are counted here and not by pyarrow: where there are any, the counts will not agree.
    count = 0
    for part in _segments(source, start, segment):
        octets = np.frombuffer(part, np.uint8)
        ends = _line_ends(octets, min(segment, _CHECKED), white=delimiter is None)
        if ends is None:
            return None
        count += ends + int(octets[-1] != _NEWLINE)
    return PlainRows(source, start, range(row, row + count), delimiter, names, careful, segment)


def _line_ends(octets: NDArray[np.uint8], size: int, *, white: bool) -> int | None:
    """How many lines end in a plain text, looked through ``size`` bytes at a time; None where it isn't plain.

    white : whether white space separates the words.
    """
    ends = np.zeros(-(-len(octets) // size), np.int64)
    plain = np.ones(len(ends), bool)

    def look(where: slice) -> None:
        part, k = octets[where], where.start // size
        ends[k] = np.count_nonzero(part == _NEWLINE)
        # Numbers and most that stands between them are from "+" on: nearly always that settles it.
        if np.count_nonzero(part.view(np.int8) < _PLUS) == ends[k]:
            return
        fine = part.max() < 128 and part.min() > 0
        if fine and (part - _LOWEST <= _MARK_SPAN).any():
            fine = not np.isin(part, _MARKS).any()
        # Nearly always lines' ends are all that there is below a space.
        if fine and (others := np.count_nonzero(part < _SPACE) - ends[k]):
            returns = where.start + np.flatnonzero(part == _RETURN)
            fine = bool((octets[np.minimum(returns + 1, len(octets) - 1)] == _NEWLINE).all())
            # Form feeds and the like are white space, but not to pyarrow.
            fine &= not white or others == len(returns) + np.count_nonzero(part == _TAB)
        plain[k] = fine

    in_parts(look, len(octets), size)
    return int(ends.sum()) if plain.all() else None


def _segments(source: Source, start: int, size: int) -> Iterator[memoryview]:
    """The bytes from ``start``, in parts that end with a line's end (but for the last)."""
    while start < source.size:
        part = source.part(start, min(start + size, source.size))
        if start + len(part) < source.size:
            for first in (max(0, len(part) - _LINE), 0):
                if end := bytes(part[first:]).rfind(b"\n") + 1:
                    part = part[: first + end]
                    break
            else:  # a line longer than a part is no line of a table: what is left is taken whole
                part = source.part(start, source.size)
        if not len(part):
            return  # the file has been cut off meanwhile
        yield part
        start += len(part)


def _squeezed(text: bytes) -> bytes:
    """``text`` with one space between the words of a line and none around them."""
    text = text.replace(b"\t", b" ").replace(b"\r\n", b"\n")
    while b"  " in text:
        text = text.replace(b"  ", b" ")
    return text.replace(b"\n ", b"\n").replace(b" \n", b"\n").strip(b" ")
