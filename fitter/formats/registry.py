"""The registry of file formats: found by looking into this folder, chosen by a file's content."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from fitter.formats.read_options import ReadOptions
from fitter.formats.source import Source
from fitter.registered import declared
from fitter.table import Table


@dataclass(frozen=True)
class Loss:
    """Something a written file does not hold: a stable slug and a sentence."""

    code: str
    message: str


@dataclass(frozen=True)
class Format:
    """One file format. A module of this folder that has one as ``FORMAT`` is registered by that alone.

    name : short stable name, as in ``Metadata.source_format``.
    description : one sentence for help texts.
    conventions : those of ``CONVENTIONS`` that its reader takes, the default first.
    sniff : (first bytes, file size) -> 0 (not this format) ... 1 (certain).
    read : (source, options) -> the tables in it, at least one. Raises TableError.
    together : (sources, options) -> tables, where one measurement is spread over several files: all files of
        this format in one folder, archive or list. None where every file stands for itself.
    write : (table, path) -> what had to be left out or changed; None where it is read only. Raises TableError
        for a table the format can't hold at all. A folder is written where one measurement is several files.
    """

    name: str
    description: str
    conventions: tuple[str, ...]
    sniff: Callable[[bytes, int], float]
    read: Callable[[Source, ReadOptions], list[Table]]
    together: Callable[[Sequence[Source], ReadOptions], list[Table]] | None = None
    write: Callable[[Table, Path], list[Loss]] | None = None


#: Below this score a format is only a guess, and a known foreign signature wins.
SURE = 0.5

#: Formats that are recognised so that the message can name them, though nothing here reads them yet.
_FOREIGN: tuple[tuple[bytes, str], ...] = (
    (rb"\x1f\x8b", "gzip-compressed: unpack it first"),
    (rb"%PDF-", "a PDF document"),
    (rb"\x89PNG|\xff\xd8\xff", "a picture"),
    (rb"CDF\x05", "a NetCDF file of version 5: write it as another kind (nccopy -k classic, or -k netCDF-4)"),
    (rb"\x93NUMPY", "a NumPy array: build fitter.Table(wi=..., wo=..., value=...) from it"),
    (rb"\s*[\[{]\s*[\"\[{\]}]", "JSON"),
    (rb"\s*<\?xml|\s*<\w+[^>]*>", "XML"),
)


def _first_foreign(head: bytes) -> int:
    """The first byte that no text has, where 64 or more of a text come before it; else 0."""
    found = re.search(rb"[\x00-\x08\x0e-\x1f\x7f-\xff]", head)
    return found.start() if found is not None and found.start() >= 64 else 0


@cache
def formats() -> tuple[Format, ...]:
    """All registered formats, by name."""
    import fitter.formats as here

    return tuple(sorted(declared(here, "FORMAT", Format), key=lambda entry: entry.name))


def detect(source: Source) -> Format:
    """The format of ``source`` by content alone. Raises TableError that says what the bytes are instead."""
    head = source.head
    if not head.strip(b"\xef\xbb\xbf \t\r\n"):
        empty = "empty" if source.size == 0 else "blank"
        raise source.error(
            f"the file is {empty} ({source.size} bytes)", "table-empty",
            cause="a download or copy that failed", remedy="fetch the file again",
        )  # fmt: skip
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip()[:2048].lower()
    if start.startswith(b"<") and re.search(rb"<!doctype html|<html|<head|<body", start):
        raise source.error(
            "this is an HTML page, not a table", "table-html",
            cause="a web page (often a login or error page) was saved in place of the data",
            remedy="download the data file itself",
        )  # fmt: skip
    scored = [(entry.sniff(head, source.size), entry) for entry in formats()]
    score, best = max(scored, key=lambda pair: pair[0])
    if score < SURE:
        for signature, what in _FOREIGN:
            if re.match(signature, head, re.MULTILINE):
                raise source.error(
                    f"the file is {what}", "table-unknown-format", offset=0,
                    remedy=f"convert it to one of: {', '.join(entry.name for entry in formats())}",
                )  # fmt: skip
    if score == 0:
        at = _first_foreign(head)
        raise source.error(
            f"the bytes ({head[at : at + 8].hex(' ')} ...) are no table this program knows",
            "table-unknown-format", offset=at, cause="binary data of another kind, or a damaged file",
            remedy=f"use one of: {', '.join(entry.name for entry in formats())}",
        )  # fmt: skip
    return best
