"""Held: a table that another library holds in memory, in place of a file's bytes."""

from __future__ import annotations

from typing import Any

from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format
from fitter.formats.source import Source
from fitter.formats.tabular import CONVENTIONS
from fitter.table import Table


class Held(Source):
    """A data frame, Arrow table or xarray object, and the :class:`Format` that it is read as.

    It has no bytes, and so neither a hash of them nor an end that could be missing.
    """

    def __init__(self, given: Any, name: str | None, format: Format) -> None:
        super().__init__(b"", name)
        self.given = given
        self.format = format
        self.digest = ""


def held(given: Any, name: str | None) -> Held | None:
    """``given`` as a :class:`Held` where it is such an object, told by what it offers; None where it isn't.

    xarray's objects have ``data_vars`` or can be made to; data frames and Arrow tables offer the Arrow C
    stream (pandas from 2.2, Polars, pyarrow, and others).
    """
    # First, because xarray's objects of late offer the stream, too, without dimensions and attributes.
    if hasattr(given, "data_vars") or (hasattr(given, "to_dataset") and hasattr(given, "coords")):
        return Held(given, name, XARRAY)
    return Held(given, name, ARROW) if hasattr(given, "__arrow_c_stream__") else None


def _no_bytes(head: bytes, size: int) -> float:
    del head, size
    return 0.0


def _arrow(source: Source, options: ReadOptions) -> list[Table]:
    from fitter.formats.arrow import read_arrow

    assert isinstance(source, Held)
    return read_arrow(source, source.given, options)


def _xarray(source: Source, options: ReadOptions) -> list[Table]:
    from fitter.formats.xarrays import read_dataset

    assert isinstance(source, Held)
    return read_dataset(source, source.given, options)


# Not registered, since no bytes are ever these: they have the readers' interface for the loader's sake.
ARROW = Format("arrow", "Columns of a data frame or Arrow table", CONVENTIONS, _no_bytes, _arrow)
XARRAY = Format("xarray", "Variables of an xarray Dataset or DataArray", CONVENTIONS, _no_bytes, _xarray)
