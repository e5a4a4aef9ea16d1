"""Rows of numbers in a text file, with errors that name row and column."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter.formats.source import Source

FloatArray = NDArray[np.float64]

#: Cells that mean "not measured".
MISSING = frozenset({"", "na", "n/a", "#n/a", "nan", "null", "none", "-", "--", "missing", "nd"})


@dataclass(frozen=True)
class Rows:
    """The data lines of a text: ``lines`` as written, ``numbers`` their 1-based rows in the file.

    ``delimiter`` None means white space; ``names`` has one name per column, for errors.
    """

    source: Source
    lines: list[str]
    numbers: NDArray[np.intp] | range
    delimiter: str | None
    names: Sequence[str]

    def __len__(self) -> int:
        return len(self.lines)

    def floats(self, use: Sequence[int]) -> FloatArray:
        """The columns ``use`` as (n, len(use)); missing cells are NaN. TableError on any other text."""
        self._check_widths()
        if not any('"' in line for line in self.lines):
            try:
                return np.loadtxt(
                    self.lines,
                    np.float64,
                    comments=None,
                    delimiter=self.delimiter,
                    usecols=list(use),
                    ndmin=2,
                )
            except ValueError:
                pass  # a cell that is no plain number: read again below, slowly, to find and name it
        values = np.empty((len(self), len(use)))
        for k, cells in enumerate(self._cells()):
            for j, column in enumerate(use):
                values[k, j] = self._number(cells[column], k, column)
        return values

    def texts(self, column: int) -> list[str]:
        """One column as written, white space stripped."""
        self._check_widths()
        return [cells[column] for cells in self._cells()]

    def _cells(self) -> Iterator[list[str]]:
        """Each row's cells, stripped of white space and quotes; cells beyond the last column are left out.

        One row at a time: the cells of a whole file take several times its size.
        """
        width = len(self.names)
        return (split(line, self.delimiter)[:width] for line in self.lines)

    def _check_widths(self) -> None:
        width = len(self.names)
        for k, line in enumerate(self.lines):
            if '"' in line or self.delimiter is None:
                cells = split(line, self.delimiter)
                count = len(cells)
            else:
                cells, count = None, line.count(self.delimiter) + 1
            if count == width:
                continue
            if count == width + 1 and not (cells or split(line, self.delimiter))[-1]:
                continue  # a delimiter at the end of the line
            last = k == len(self) - 1 and count < width
            raise self.source.error(
                f"{count} columns where there should be {width} ({', '.join(self.names)})", "table-row-width",
                row=int(self.numbers[k]),
                cause="the file is cut off here" if last else "a missing or doubled delimiter, a stray line",
                remedy="fetch the file again" if last else "mend the row, or begin it with # to leave it out",
            )  # fmt: skip

    def _number(self, cell: str, k: int, column: int) -> float:
        found = number(cell)
        if found is not None:
            return found
        decimal_comma = cell.count(",") == 1 and cell.replace(",", "").replace("-", "").isdecimal()
        raise self.source.error(
            f"{cell[:40]!r} is not a number", "table-not-a-number", row=int(self.numbers[k]),
            column=self.names[column], cause="a decimal comma" if decimal_comma else None,
            remedy="write decimals with a point" if decimal_comma
            else "mend the cell, or leave it empty (or nan) where nothing was measured",
        )  # fmt: skip


def number(word: str) -> float | None:
    """The number that a word stands for, NaN for the usual words of a missing one; None if it is none."""
    if word.lower() in MISSING:
        return np.nan
    if "_" in word:  # Python reads 1_0 as 10, no instrument writes that
        return None
    try:
        return float(word)
    except ValueError:
        return None


def split(line: str, delimiter: str | None) -> list[str]:
    """Cells of one line, stripped of white space and quotes; ``delimiter`` None means white space."""
    if delimiter is None:
        return [cell.strip('"') for cell in line.split()]
    if '"' in line:
        line = line.replace("\x00", "")
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]
    return [cell.strip() for cell in line.split(delimiter)]


def is_number(cell: str) -> bool:
    """Whether a cell is a number or a mark for a missing one."""
    return number(cell) is not None
