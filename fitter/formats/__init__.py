"""Reading and writing tables: one module per file format, chosen by content, never by file name."""

from __future__ import annotations

from fitter.formats.delimited_writer import write_delimited
from fitter.formats.describe import describe
from fitter.formats.loading import load, load_all
from fitter.formats.read_options import CONVENTIONS, ReadOptions, read_options
from fitter.formats.registry import Format, Loss, formats
from fitter.formats.writing import write

__all__ = [
    "CONVENTIONS", "Format", "Loss", "ReadOptions", "describe", "formats", "load", "load_all", "read_options",
    "write", "write_delimited",
]  # fmt: skip
