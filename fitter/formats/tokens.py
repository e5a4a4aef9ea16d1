"""Words and numbers of a keyword text (Zemax, LightTools, Integra), each with its row."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.errors import TableError
from fitter.formats.source import Source
from fitter.formats.text import number

FloatArray = NDArray[np.float64]


class Tokens:
    """Words of a text from first to last. Lines beginning with ``comment`` are kept in ``comments``."""

    def __init__(self, source: Source, comment: str) -> None:
        self.source = source
        self.comments: list[str] = []
        self._comment = comment
        # Line by line: the words of a whole file take ten times its size.
        self._lines = source.lines
        self._next = 0
        self._words: list[str] = []
        self._at = 0
        self._read_row = 1

    @property
    def row(self) -> int:
        """Row of the word that was read last (1 before any was read)."""
        return self._read_row

    @property
    def left(self) -> bool:
        """Whether there is another word."""
        while self._at == len(self._words):
            if self._next == len(self._lines):
                return False
            line = self._lines[self._next]
            self._next += 1
            if line.lstrip().startswith(self._comment):
                self.comments.append(line.strip().lstrip(self._comment).strip())
                continue
            self._words, self._at = line.split(), 0
        return True

    def peek(self) -> str:
        """The next word, "" at the end."""
        return self._words[self._at] if self.left else ""

    def word(self, what: str) -> str:
        """The next word. TableError that ``what`` is missing at the end of the file."""
        if not self.left:
            raise self.truncated(f"the file ends where {what} should be")
        return self._take(1)[0]

    def _take(self, most: int) -> list[str]:
        """The next words of the current line, ``most`` at most."""
        words = self._words[self._at : self._at + most]
        self._at += len(words)
        self._read_row = self._next
        return words

    def count(self, what: str) -> int:
        """The next word as a count of 1 or more."""
        word = self.word(what)
        if not (word.isascii() and word.isdecimal()) or int(word[:12]) == 0:
            raise self.error(
                f"{what} is {word[:40]!r}, not a count", "table-header", column=what,
                cause="a damaged header", remedy="write how many values follow",
            )  # fmt: skip
        return int(word)

    def numbers(self, count: int, what: str) -> FloatArray:
        """The next ``count`` words as numbers (marks for missing values are NaN)."""
        parts: list[FloatArray] = []
        found = 0
        while found < count and self.left:
            words = self._take(count - found)
            found += len(words)
            try:
                parts.append(np.array(words, np.float64))
            except ValueError:
                parts.append(np.array([self._number(word, what) for word in words]))
        if found < count:
            raise self.truncated(f"{what} should have {count} numbers and {found} are left")
        return np.concatenate(parts)

    def listed(self, what: str) -> FloatArray:
        """A count and that many numbers."""
        return self.numbers(self.count(what), what)

    def angles(self, what: str, most: float, count: int | None = None) -> FloatArray:
        """A list of increasing angles, in degrees from -``most`` to ``most``, as radians."""
        values = self.listed(what) if count is None else self.numbers(count, what)
        if not (np.isfinite(values).all() and (np.abs(values) <= most).all() and (np.diff(values) > 0).all()):
            raise self.error(
                f"{what} is no list of increasing angles within {most:g} deg", "table-angle-range",
                column=what, cause="a damaged header", remedy="write increasing angles in degrees",
            )  # fmt: skip
        return np.deg2rad(values)

    def chosen(self, what: str, among: tuple[str, ...]) -> str:
        """The next word, spelt as in ``among`` (case does not matter)."""
        word = self.word(what)
        for known in among:
            if known.lower() == word.lower():
                return known
        raise self.error(
            f"{what} is {word[:40]!r}, which is not known", "table-header", column=what,
            remedy=f"use one of {', '.join(among)}",
        )  # fmt: skip

    def truncated(self, message: str) -> TableError:
        """A TableError for a file that ends too early."""
        return self.error(
            message, "table-truncated", cause="the file is cut off", remedy="fetch the file again"
        )

    def error(self, message: str, code: str, **keywords: Any) -> TableError:
        """A TableError that names the file and the row of the last word."""
        return self.source.error(message, code, row=self.row, **keywords)

    def _number(self, word: str, what: str) -> float:
        found = number(word)
        if found is not None:
            return found
        raise self.error(
            f"{word[:40]!r} is not a number", "table-not-a-number", column=what,
            cause="a value is missing before it, so that the counts don't fit" if word[0].isalpha() else None,
            remedy="mend the number, or write nan where nothing was measured",
        )  # fmt: skip
