"""Source: the bytes of one file, wherever they come from, and the errors that name it."""

from __future__ import annotations

import hashlib
import os
import re
import stat
from functools import cached_property, partial
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np

from fitter.digest import Digest, digest_of
from fitter.errors import NoTable, TableError

#: Bytes that are looked at to tell the format.
HEAD = 1 << 16
#: A file of so many bytes is not kept in memory longer than it is needed.
_LARGE = 1 << 24


class Source:
    """One file's bytes, read when first needed, so that a wrong file costs only its head.

    Parameters
    ----------
    given : a path, bytes or an open binary file (read from where it stands). A read-only memoryview is not
        copied: what it shows must not change.
    name : what errors call it; default the path's last part.

    Raises
    ------
    TableError : the file is missing, unreadable, or was opened as text.
    """

    def __init__(
        self, given: str | os.PathLike[str] | bytes | memoryview | BinaryIO, name: str | None = None
    ) -> None:
        self._path: Path | None = None
        self._bytes: bytes | memoryview = b""
        if isinstance(given, bytes | bytearray | memoryview):
            self._bytes = given if isinstance(given, memoryview) and given.readonly else bytes(given)
            self.name = name
        elif isinstance(given, str | os.PathLike):
            self._path = Path(given)
            self.name = self._path.name or str(self._path)
        elif hasattr(given, "read"):
            path = getattr(given, "name", None)
            self.name = name or (Path(path).name if isinstance(path, str) else None)
            content = cast("bytes | str", given.read())
            if isinstance(content, str):
                raise self.error(
                    "the file is open as text", "file-unreadable", remedy='open it with mode "rb"'
                )
            self._bytes = content
        else:
            raise TableError(
                f"can't read a table from {type(given).__name__}", code="file-unreadable",
                remedy="give a path, bytes, an open binary file or a data frame",
            )  # fmt: skip
        #: What tells that a file is still the one that was opened.
        self._state: tuple[int, ...] = ()
        self.head, self.size = self._open()

    def _open(self) -> tuple[bytes, int]:
        if self._path is None:
            return bytes(self._bytes[:HEAD]), len(self._bytes)
        try:
            with self._path.open("rb") as file:
                state = os.fstat(file.fileno())
                if stat.S_ISREG(state.st_mode):
                    self._state = _told_by(state)
                    return file.read(HEAD), state.st_size
                # A pipe has no size and can be read only once.
                self._path, self._bytes = None, file.read()
                return self._bytes[:HEAD], len(self._bytes)
        except (OSError, ValueError) as error:  # ValueError: a NUL in the path
            raise self._unreadable(error) from error

    def _unreadable(self, error: Exception) -> TableError:
        missing = isinstance(error, FileNotFoundError)
        reason = getattr(error, "strerror", None) or str(error)
        return self.error(
            f"the file can't be read: {reason}", "file-missing" if missing else "file-unreadable",
            remedy="check the path" if missing else "check that it is a plain file you may read",
        )  # fmt: skip

    @cached_property
    def buffer(self) -> memoryview:
        """All bytes, without a copy."""
        if self._path is None:
            return memoryview(self._bytes)
        try:
            return np.fromfile(self._path, np.uint8).data  # a quarter of the time of read_bytes()
        except OSError as error:
            raise self._unreadable(error) from error

    @cached_property
    def data(self) -> bytes:
        """All bytes; a copy only where they come from a path or a memoryview."""
        return self._bytes if isinstance(self._bytes, bytes) and self._path is None else bytes(self.buffer)

    def part(self, start: int, stop: int) -> memoryview:
        """The bytes from ``start`` to ``stop``: of a large file read now, so that not all need be in memory.

        Reading them twice is quicker than touching so much fresh memory once. :meth:`release` tells whether
        the file was the same all the time.
        """
        if not self._apart:
            return self.buffer[start:stop]
        assert self._path is not None
        try:
            return np.fromfile(self._path, np.uint8, max(0, stop - start), offset=start).data
        except OSError as error:
            raise self._unreadable(error) from error

    @property
    def _apart(self) -> bool:
        """Whether the bytes are those of a large file that is not in memory."""
        return self._path is not None and self.size > _LARGE and "buffer" not in self.__dict__

    @cached_property
    def ends_in_newline(self) -> bool:
        """Whether the last line is ended; a text cut in the middle of a number is not."""
        return bytes(self.part(max(0, self.size - 1), self.size)) in (b"\n", b"\r")

    def release(self) -> None:
        """Let go of the bytes of a large file; they are read again if they are needed again.

        Raises TableError where the file has changed since it was opened.
        """
        if self._path is None or self.size <= _LARGE:
            return
        _ = self.ends_in_newline  # said of the bytes that were read, as is the digest
        if self._apart:
            self.digest = self.sha256
            self._refuse_change(self._path)
        self.begin_digest()
        for name in ("buffer", "data", "lines"):
            self.__dict__.pop(name, None)

    def _refuse_change(self, path: Path) -> None:
        try:
            state = _told_by(path.stat())
        except OSError as error:
            raise self._unreadable(error) from error
        if state != self._state:
            raise self.error(
                "the file changed while it was read", "file-changed", cause="something else is writing it",
                remedy="load it again when that is done",
            )  # fmt: skip

    @cached_property
    def digest(self) -> str | Digest:
        """sha256 of all bytes, for :class:`fitter.metadata.Metadata`; that of a large file is yet to come.

        Who knows it already sets it.
        """
        if self._path is not None and self._apart:
            return Digest(partial(_file_digest, self._path))
        return digest_of(self.buffer)

    def begin_digest(self) -> None:
        """Have the digest of a large file computed from now on, beside what follows."""
        if isinstance(self.digest, Digest):
            self.digest.begin()

    @property
    def sha256(self) -> str:
        """Hexadecimal digest of all bytes."""
        return self.digest if isinstance(self.digest, str) else self.digest.hexdigest()

    def beside(self, name: str) -> Source | None:
        """The file called ``name`` in this file's folder; None where there is none or no folder is known."""
        path = None if self._path is None else self._path.with_name(name)
        return Source(path) if path is not None and path.is_file() else None

    @property
    def stem(self) -> str:
        """The name without its extension, "" when there is no name."""
        return Path(self.name).stem if self.name else ""

    @cached_property
    def lines(self) -> list[str]:
        """Lines of a UTF-8 text (a byte order mark is skipped), as an editor numbers them from 1."""
        # Decoded straight from the buffer: a copy of the bytes would be one more of the file's size.
        data = self.buffer
        if self.head.startswith((b"\xff\xfe", b"\xfe\xff")):
            raise self.error(
                "the text is UTF-16 encoded", "text-encoding", cause='it was saved as "Unicode text"',
                remedy="save it as UTF-8",
            )  # fmt: skip
        try:
            text = str(data, "utf-8-sig")
        except UnicodeDecodeError as error:
            self._refuse_nul(bytes(data[: error.start]))
            raise self.error(
                f"byte 0x{data[error.start]:02x} is not UTF-8", "text-encoding",
                row=_row_of(bytes(data[: error.start])),
                cause="a text in another encoding (Latin-1, Windows-1252), or binary data",
                remedy="save it as UTF-8",
            ) from error  # fmt: skip
        if "\0" in text:
            self._refuse_nul(bytes(data))
        # Not splitlines(): that also breaks at form feeds and other marks no editor counts as a line.
        lines = re.split(r"\r\n|\n|\r", text)
        if lines and not lines[-1]:
            lines.pop()
        return lines

    def _refuse_nul(self, data: bytes) -> None:
        """Raise TableError where a NUL is in the first bytes ``data`` of a text."""
        at = data.find(b"\0")
        if at >= 0:
            raise self.error(
                f"byte {at + 1} is NUL, which no text has", "text-nul", row=_row_of(data[:at]),
                cause="binary data, a UTF-16 text, or a file damaged while it was written",
                remedy="save the table as UTF-8 text, or fetch the file again",
            )  # fmt: skip

    def error(self, message: str, code: str, **keywords: Any) -> TableError:
        """A TableError that names this file."""
        return TableError(message, code=code, file=self.name, **keywords)

    def no_table(self, message: str, code: str, holds: str, **keywords: Any) -> NoTable:
        """An error for what holds no BRDF but what ``holds`` says; ``contents`` may tell more of it."""
        contents: dict[str, Any] = {"holds": holds, **keywords.pop("contents", {})}
        return NoTable(message, code=code, file=self.name, contents=contents, **keywords)


def _told_by(state: os.stat_result) -> tuple[int, ...]:
    return state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns


def _file_digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _row_of(before: bytes) -> int:
    """The row that follows the bytes ``before`` it."""
    return len(re.findall(rb"\r\n|\n|\r", before)) + 1
