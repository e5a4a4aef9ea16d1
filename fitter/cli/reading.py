"""Reading tables: the options that every verb shares, and finding a result's table again."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from fitter.cli.values import pair
from fitter.errors import SpecError, TableError

if TYPE_CHECKING:
    from fitter.cli.screen import Screen
    from fitter.compression import CompressedTable
    from fitter.formats import ReadOptions
    from fitter.large import LargeTable
    from fitter.table import Table

READING = "reading options (what a file can't say about itself)"


def add_reading_options(parser: argparse.ArgumentParser) -> None:
    """``--quantity`` and the other options of :func:`fitter.load`."""
    from fitter.formats import CONVENTIONS
    from fitter.metadata import QUANTITIES

    group = parser.add_argument_group(READING)
    group.add_argument("--quantity", choices=QUANTITIES, help="what the values are")
    group.add_argument(
        "--convention", choices=tuple(CONVENTIONS), metavar="NAME",
        help="; ".join(f"{name}: {meaning}" for name, meaning in CONVENTIONS.items()),
    )  # fmt: skip
    group.add_argument(
        "--item", help="which table of a file that holds several: its name, or its position from 0"
    )
    group.add_argument(
        "--column", type=pair, action="append", default=[], metavar="NAME=MEANING",
        help="what a column of a text table means, as thetai=theta_i_deg or 5=brdf_R; NAME is a header's "
        "name or a position from 0 (repeatable)",
    )  # fmt: skip
    group.add_argument(
        "--negatives", choices=("mask", "keep"), help="negative values: mask (default) or keep"
    )
    group.add_argument(
        "--duplicates", choices=("mask", "keep"), help="repeated geometries: mask (default) or keep"
    )
    group.add_argument(
        "--fills", choices=("mask", "keep", "floors"),
        help="fill values: mask (default) or keep; floors: repeated zeros and constant lowest values, too",
    )  # fmt: skip


def add_out_of_core(parser: argparse.ArgumentParser) -> None:
    """``--out-of-core``: for tables that don't fit into memory."""
    parser.add_argument(
        "--out-of-core", action="store_true",
        help="leave the table in its file (Parquet or delimited text) and read it part by part",
    )  # fmt: skip


def open_large(given: argparse.Namespace, seed: int, screen: Screen) -> LargeTable:
    """The table of ``--out-of-core``, read through once. Raises TableError or SpecError."""
    from fitter import large

    with screen.progress("reading") as report:
        return large.open_large(given.table, seed=seed, progress=report, **reading_options(given).to_dict())


def reading_options(given: argparse.Namespace) -> ReadOptions:
    """The options that :func:`add_reading_options` added. Raises SpecError."""
    from fitter.formats import read_options

    names = ("quantity", "convention", "item", "negatives", "duplicates", "fills")
    chosen: dict[str, Any] = {name: getattr(given, name) for name in names}
    if given.column:
        chosen["columns"] = dict(given.column)
    return read_options(chosen)


@dataclass(frozen=True)
class Opened:
    """A table and where it came from, so that a result can say it; ``small`` where it was compressed."""

    table: Table
    source: Mapping[str, Any]
    small: CompressedTable | None = None

    def compressed_to(self, tolerance: float) -> Opened:
        """The same, compressed to a relative error bound; the source says so."""
        from fitter.compression import compress

        small = compress(self.table, tolerance)
        return Opened(small.decompress(), {**self.source, "compressed_to": tolerance}, small)


def open_table(path: str | Path, options: ReadOptions) -> Opened:
    """The one table at ``path``, of any format. Raises TableError or SpecError."""
    from fitter.formats import load

    source = {"path": str(Path(path).resolve()), "options": options.to_dict()}
    table = load(path, **options.to_dict())
    # A compressed table is handed on as such, so that a fit of it can say so.
    return Opened(table, source, open_container(path) if is_container(path) else None)


def is_container(path: str | Path) -> bool:
    """Whether ``path`` holds a compressed table, by its first bytes."""
    from fitter.formats.compressed import MAGIC

    try:
        with Path(path).open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC
    except (OSError, ValueError):
        return False  # whoever reads it as a table says what is wrong with it


def open_container(path: str | Path, damage: Literal["refuse", "keep"] = "refuse") -> CompressedTable:
    """The compressed table at ``path``. Raises TableError, also where it can't be read at all.

    ``damage`` : as of :meth:`fitter.compression.CompressedTable.load`.
    """
    from fitter.compression import CompressedTable

    try:
        return CompressedTable.load(path, damage=damage)
    except OSError as error:
        raise TableError(
            f"the file can't be read: {error.strerror}", code="file-unreadable", file=str(path),
            remedy="check the path",
        ) from error  # fmt: skip


def table_of(
    described: Mapping[str, Any], given: str | None, options: ReadOptions, *, result: str | Path
) -> Opened:
    """The table that a result was made from: the one given, else the one the result remembers.

    Raises SpecError where it is another table than the result's.
    """
    from fitter.formats import read_options

    source = described.get("source")
    remembered = source if isinstance(source, dict) else {}
    path: str | None = given or remembered.get("path")
    if path is None:
        raise SpecError(
            "the result does not say which file its table came from", code="table-unknown", file=str(result),
            parameter="table", remedy="name it with --table",
        )  # fmt: skip
    if remembered.get("out_of_core"):
        raise SpecError(
            "the result was fitted out of core, and this needs its table in memory", code="table-too-large",
            file=str(result), parameter="table", remedy="fit a part of the table that fits into memory",
        )  # fmt: skip
    if not options.to_dict():
        # The same file read the same way, also where it has moved.
        options = read_options(remembered.get("options") or {})
    if given is None and not Path(path).exists():
        raise SpecError(
            f"the table that this result was made from is not there: {path}", code="table-missing",
            file=str(result), parameter="table", cause="it was moved or deleted",
            remedy="name it with --table",
        )  # fmt: skip
    opened = open_table(path, options)
    if "compressed_to" in remembered:
        opened = opened.compressed_to(remembered["compressed_to"])
    if opened.table.hash != described.get("hash"):
        raise SpecError(
            f"{path} is not the table that this result was made from", code="table-differs", file=str(result),
            parameter="table", cause="the file has changed since, or was read with other options",
            remedy="fit the table again, or name the right one with --table",
        )  # fmt: skip
    return opened
