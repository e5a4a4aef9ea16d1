"""Delimited text: comma, tab, semicolon or white space, with declared columns and units."""

from __future__ import annotations

from pathlib import Path

from fitter.formats.delimited_header import read_head
from fitter.formats.delimited_writer import write_delimited
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format, Loss
from fitter.formats.source import Source
from fitter.formats.tabular import CONVENTIONS, read_columns
from fitter.table import Table

NAME = "delimited"
_CONTROL = bytes(c for c in range(32) if c not in b"\t\n\r\v\f")
_HIGH = bytes(range(128, 256))


def sniff(head: bytes, size: int) -> float:
    """Any text may be a delimited table, but every other format is asked first."""
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return 0.2  # UTF-16: the reader says so
    control = len(head) - len(head.translate(None, _CONTROL))
    foreign = len(head) - len(head.translate(None, _HIGH))
    # A few stray bytes are a damaged or Latin-1 text, whose reader can name the row; more are binary data.
    return 0.2 if control <= 0.02 * len(head) + 1 and foreign <= 0.2 * len(head) + 1 else 0.0


def read(source: Source, options: ReadOptions) -> list[Table]:
    """Tables of a delimited text: one, or one for each wavelength or item where a column tells them apart."""
    head, rows = read_head(source)
    return read_columns(source, options, head, rows, format=NAME, text=True)


def _write(table: Table, path: Path) -> list[Loss]:
    write_delimited(table, path)
    return []


FORMAT = Format(
    NAME,
    "Text columns (CSV, TSV, semicolons, spaces) declared by header names or columns=",
    CONVENTIONS,
    sniff,
    read,
    write=_write,
)
