"""Loading: from a path, bytes, an open file, a folder, a zip archive, a data frame or a list, to tables."""

from __future__ import annotations

import os
import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Protocol, TypeAlias, cast

from fitter.errors import NoTable, SpecError, TableError
from fitter.formats import archives
from fitter.formats.fills import Fills
from fitter.formats.held import Held, held
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format, detect
from fitter.formats.source import Source
from fitter.masking import Treatment
from fitter.metadata import Quantity
from fitter.table import Table


class ArrowStream(Protocol):
    """A data frame or Arrow table: what hands over its columns as an Arrow C stream."""

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object: ...


class LabelledArrays(Protocol):
    """An xarray Dataset or DataArray: arrays over named dimensions."""

    @property
    def coords(self) -> Any: ...
    @property
    def attrs(self) -> Any: ...


Given: TypeAlias = Source | str | os.PathLike[str] | bytes | BinaryIO | ArrowStream | LabelledArrays


def load(
    source: Given,
    *,
    quantity: Quantity | None = None,
    convention: str | None = None,
    item: str | int | None = None,
    columns: Mapping[str | int, str] | None = None,
    negatives: Treatment = "mask",
    duplicates: Treatment = "mask",
    fills: Fills = "mask",
    name: str | None = None,
) -> Table:
    """The one table in ``source``: a path, bytes or an open binary file, of any registered format.

    A data frame (pandas, Polars, Arrow) is read as delimited text of its columns would be, an xarray object
    as a NetCDF file of its variables.

    Parameters
    ----------
    quantity : "brdf", "ccbrdf" or "reflectance_factor", where the file can't say or says it wrongly.
    convention : one of :data:`fitter.formats.CONVENTIONS`, likewise.
    item : which table, where the file holds several: its name, or (where no table has it as its name) its
        position from 0.
    columns : declared columns: header name or 0-based position -> meaning, as "theta_i_deg", "brdf_R".
    negatives, duplicates : "mask" or "keep", as in :class:`fitter.Table`.
    fills : fill values: "mask", "keep", or "floors": repeated zeros and constant lowest values, too.
    name : what to call the table; default what the file says, else the file's name.

    Raises
    ------
    TableError : the bytes are no table, or not one that can be read without being told more.
    SpecError : an option outside its vocabulary.
    """
    tables = load_all(
        source, quantity=quantity, convention=convention, item=item, columns=columns, negatives=negatives,
        duplicates=duplicates, fills=fills, name=name,
    )  # fmt: skip
    if len(tables) > 1:
        labels = [_label(table) for table in tables]
        shown = ", ".join(labels[:12]) + (", ..." if len(labels) > 12 else "")
        raise TableError(
            f"the source holds {len(tables)} tables ({shown})", code="table-several",
            file=_name_of(source, name), parameter="item",
            remedy=f"choose one with item={labels[0]!r} or item=0, or use load_all",
        )  # fmt: skip
    return tables[0]


def load_all(
    source: Given | Sequence[Given],
    *,
    quantity: Quantity | None = None,
    convention: str | None = None,
    item: str | int | None = None,
    columns: Mapping[str | int, str] | None = None,
    negatives: Treatment = "mask",
    duplicates: Treatment = "mask",
    fills: Fills = "mask",
    name: str | None = None,
) -> list[Table]:
    """Every table in a file, folder (its visible files, by name), zip archive, data frame or list of these.

    Options as in :func:`load`; they hold for every file. ``item`` keeps one table only: by the name of
    a file's item or of a member, or by its position among all tables.

    Raises
    ------
    TableError : a file is no table (the error names it), or nothing is there to read.
    NoTable : all that is there was understood and holds no BRDF. Beside tables it is left out, with a note.
    """
    begun = time.perf_counter()
    options = ReadOptions(
        quantity=quantity, convention=convention, item=item, columns=columns or (),  # type: ignore[arg-type]
        negatives=negatives, duplicates=duplicates, fills=fills, name=name,
    )  # fmt: skip
    # A slot for each file in turn; the files of one spread-out measurement share the first one's.
    slots: list[list[Table]] = []
    spread: dict[tuple[str, str], tuple[int, Format, list[Source]]] = {}
    skipped: list[NoTable] = []
    inner = False
    for one, container in _sources(source, name):
        inner = container is not None
        entry = one.format if isinstance(one, Held) else detect(one)
        if convention is not None and convention not in entry.conventions:
            raise one.error(
                f"convention {convention!r} is not for {entry.name} files", "table-convention",
                parameter="convention",
                remedy=f"use one of {', '.join(entry.conventions)}" if entry.conventions else "leave it out",
            )  # fmt: skip
        if entry.together is not None and container is not None:
            key = (entry.name, container)
            if key not in spread:
                spread[key] = (len(slots), entry, [])
                slots.append([])
            spread[key][2].append(one)
            continue
        # One name can't be that of every file in a container.
        slots.append([])
        with _setting_aside(skipped):
            slots[-1] = entry.read(one, replace(options, name=None) if inner else options)
    for slot, entry, parts in spread.values():
        assert entry.together is not None
        with _setting_aside(skipped):
            slots[slot] = entry.together(parts, replace(options, name=None))
    tables = [table for slot in slots for table in slot]
    if not tables and skipped:
        raise skipped[0]
    beside = tuple(f"{one.file or 'A file'} holds {one.contents['holds']}: not read." for one in skipped)
    for table in tables if beside else ():
        table.metadata = table.metadata.but(notes=(*table.metadata.notes, *beside))
    if not tables:
        raise TableError("there is no file to read", code="table-empty", file=_name_of(source, name))
    if item is not None:
        tables = [_select(tables, item, _name_of(source, name))]
    if inner and name is not None and len(tables) == 1:
        tables[0].metadata = replace(tables[0].metadata, name=name)
    for table in tables:
        table.load_seconds = (time.perf_counter() - begun) / len(tables)
    return tables


@contextmanager
def _setting_aside(skipped: list[NoTable]) -> Generator[None]:
    """Add what holds no BRDF to ``skipped``, for the rest to be read."""
    try:
        yield
    except NoTable as error:
        skipped.append(error)


def _sources(
    given: object, name: str | None, within: str | None = None
) -> Iterator[tuple[Source, str | None]]:
    """Every file in ``given``, and the folder, archive or list it was found in (None for a lone file)."""
    if isinstance(given, list | tuple):
        for one in cast("list[object]", given):
            yield from _sources(one, None, within or "list")
        return
    if isinstance(given, str | os.PathLike) and os.path.isdir(given):
        for path in sorted(Path(given).iterdir()):
            if path.is_file() and not path.name.startswith("."):
                yield from _sources(path, None, str(given))
        return
    memory = held(given, name)
    if memory is not None:
        yield memory, within
        return
    # Source itself refuses what it can't read.
    source = given if isinstance(given, Source) else Source(given, name)  # type: ignore[arg-type]
    if archives.is_archive(source):
        for folder, member in _members(source):
            yield member, f"{within} {source.name} {source.sha256} {folder}"
    else:
        yield source, within


def _members(archive: Source) -> Iterator[tuple[str, Source]]:
    """(folder inside the archive, file) of every file in it."""
    with archives.opened(archive, BytesIO(archive.data)) as content:
        wanted = archives.files(content)
        archives.refuse_large(archive, wanted)
        for member in wanted:
            yield str(Path(member.filename).parent), archives.unpacked(archive, content, member)


def _label(table: Table) -> str:
    return str(table.metadata.provenance.get("item", table.metadata.name))


def _select(tables: list[Table], item: str | int, file: str | None) -> Table:
    labels = [_label(table) for table in tables]
    wanted = str(item)
    for names in (labels, [t.metadata.name for t in tables], [_file_of(t) for t in tables]):
        if names.count(wanted) == 1:
            return tables[names.index(wanted)]
    # A number that is no item's name is a position, as text too: form fields and shells know only text.
    if wanted.isdecimal() and int(wanted) < len(tables):
        return tables[int(wanted)]
    shown = ", ".join(labels[:20]) + (", ..." if len(labels) > 20 else "")
    raise SpecError(
        f"there is no item {item!r}", code="unknown-item", file=file, parameter="item",
        remedy=f"the items are {shown}; or give a position from 0 to {len(labels) - 1}",
    )  # fmt: skip


def _file_of(table: Table) -> Any:
    return table.metadata.provenance.get("file")


def _name_of(given: object, name: str | None) -> str | None:
    if isinstance(given, str | os.PathLike):
        return Path(given).name
    return name
