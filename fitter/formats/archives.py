"""Zip archives of tables: what is in them, unpacked within bounds. Errors name the archive and the member."""

from __future__ import annotations

import lzma
import zipfile
import zlib
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from fitter.formats.source import Source

#: An archive may not unpack to more than this many bytes, whatever its directory claims.
MAX_UNPACKED = 1 << 30


def is_archive(source: Source) -> bool:
    """Whether a file is a zip archive, by its first bytes."""
    return source.head.startswith((b"PK\x03\x04", b"PK\x05\x06"))


@contextmanager
def opened(archive: Source, file: BinaryIO | Path) -> Generator[zipfile.ZipFile]:
    """The archive, read from ``file``; ``archive`` names it. Raises TableError where it is damaged."""
    with _refusing(archive):
        content = zipfile.ZipFile(file)
    with content:
        yield content


def files(content: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    """The files of an archive but for hidden ones, in its order."""
    return [
        m for m in content.infolist()
        if not m.is_dir() and not any(p.startswith((".", "__MACOSX")) for p in Path(m.filename).parts)
    ]  # fmt: skip


def refuse_large(archive: Source, members: Sequence[zipfile.ZipInfo]) -> None:
    """Raise TableError where the members claim to be more than may be unpacked together."""
    claimed = sum(m.file_size for m in members)
    if claimed > MAX_UNPACKED:
        raise archive.error(
            f"the archive claims to unpack to {claimed / 1e9:.1f} GB", "archive-too-large",
            remedy="unpack it and load the folder",
        )  # fmt: skip


def unpacked(archive: Source, content: zipfile.ZipFile, member: zipfile.ZipInfo) -> Source:
    """The file that is a member. Raises TableError; the column is the member, the offset where it begins."""
    with _refusing(archive, member):
        # read() stops at the size that the directory claims, which the caller has refused where it is large.
        return Source(content.read(member), Path(member.filename).name)


@contextmanager
def _refusing(archive: Source, member: zipfile.ZipInfo | None = None) -> Generator[None]:
    column = None if member is None else member.filename[:80]
    offset = None if member is None else member.header_offset
    try:
        yield
    except (
        zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError, ValueError, OverflowError,
    ) as error:  # fmt: skip
        raise archive.error(
            f"the zip archive is damaged: {error}", "archive-damaged", column=column, offset=offset,
            remedy="fetch the file again",
        ) from error  # fmt: skip
    except (RuntimeError, NotImplementedError) as error:
        raise archive.error(
            f"the zip archive can't be unpacked: {error}", "archive-damaged", column=column, offset=offset,
            cause="a password or an unusual compression", remedy="unpack it and load the folder",
        ) from error  # fmt: skip
