"""Storage: named bytes, in a folder of this machine or wherever an fsspec URL leads.

A name is a path below the storage's root, as ``results/ID.json``. What is written
appears whole or not at all.
"""

from __future__ import annotations

import errno
import importlib
import shutil
import time
import uuid
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Protocol
from urllib.parse import urlsplit

from fitter.documents import write_bytes
from fitter.errors import SpecError

#: Protocols whose files appear only when they are whole. On the others we write aside and rename.
#: Bytes that are fetched at a time where a file is read in pieces.
_BLOCK = 1 << 20
_WHOLE = {"s3", "s3a", "gs", "gcs", "az", "abfs", "abfss", "adl", "oci", "oss", "memory"}


class Storage(Protocol):
    """What the service needs of it."""

    def read(self, name: str) -> bytes:
        """Raises FileNotFoundError."""
        ...

    def open(self, name: str) -> BinaryIO:
        """The bytes, to be read in pieces. Raises FileNotFoundError."""
        ...

    def write(self, name: str, content: bytes) -> None: ...

    def take(self, name: str, file: Path) -> None:
        """Keep a local file's bytes; the file itself may be gone afterwards."""
        ...

    def holds(self, name: str) -> bool: ...

    def drop(self, name: str) -> None:
        """Delete it, if it is there."""
        ...

    def ages(self, folder: str) -> Iterator[tuple[str, float]]:
        """Every name below a folder, and how many seconds ago it was written."""
        ...


class Folder:
    """A folder of this machine."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def read(self, name: str) -> bytes:
        return (self._root / name).read_bytes()

    def open(self, name: str) -> BinaryIO:
        return (self._root / name).open("rb")

    def write(self, name: str, content: bytes) -> None:
        write_bytes(content, self._root / name)

    def take(self, name: str, file: Path) -> None:
        path = self._root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            file.replace(path)
        except OSError as error:
            if error.errno != errno.EXDEV:
                raise
            # Another disk: copied aside first, so that it still appears whole.
            aside = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
            shutil.copyfile(file, aside)
            aside.replace(path)

    def holds(self, name: str) -> bool:
        return (self._root / name).exists()

    def drop(self, name: str) -> None:
        (self._root / name).unlink(missing_ok=True)

    def ages(self, folder: str) -> Iterator[tuple[str, float]]:
        now = time.time()
        for path in sorted((self._root / folder).rglob("*")):
            try:
                if path.is_file():
                    yield path.relative_to(self._root).as_posix(), now - path.stat().st_mtime
            except FileNotFoundError:
                continue  # somebody else deleted it just now


class Remote:
    """Whatever fsspec has a file system for. Its credentials are in the environment, as fsspec wants them."""

    def __init__(self, url: str) -> None:
        try:
            fsspec: Any = importlib.import_module("fsspec")
            self._files, root = fsspec.core.url_to_fs(url)
        except ImportError as error:
            raise SpecError(
                f"this storage needs a package that is not installed: {error}", code="extra-missing",
                parameter="storage",
                remedy="pip install 'brdf-fitter[storage]', and what fsspec names for this protocol",
            ) from error  # fmt: skip
        except ValueError as error:
            raise SpecError(
                f"not a storage's URL: {error}", code="bad-call", parameter="storage",
                remedy="give one that fsspec knows, as s3://bucket/folder",
            ) from error  # fmt: skip
        self._root = str(root).rstrip("/")
        self._whole = urlsplit(url).scheme in _WHOLE

    def read(self, name: str) -> bytes:
        found: bytes = self._files.cat_file(self._path(name))
        return found

    def open(self, name: str) -> BinaryIO:
        opened: BinaryIO = self._files.open(self._path(name), "rb", block_size=_BLOCK)
        return opened

    def write(self, name: str, content: bytes) -> None:
        with self._appearing(name) as out:
            out.write(content)

    def take(self, name: str, file: Path) -> None:
        with file.open("rb") as source, self._appearing(name) as out:
            shutil.copyfileobj(source, out, 1 << 20)

    def holds(self, name: str) -> bool:
        return bool(self._files.exists(self._path(name)))

    def drop(self, name: str) -> None:
        try:
            self._files.rm_file(self._path(name))
        except FileNotFoundError:
            return

    def ages(self, folder: str) -> Iterator[tuple[str, float]]:
        now = time.time()
        self._files.invalidate_cache()
        for path in sorted(self._files.find(self._path(folder))):
            yield path[len(self._root) :].lstrip("/"), now - self._files.modified(path).timestamp()

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}"

    @contextmanager
    def _appearing(self, name: str) -> Generator[Any]:
        path = self._path(name)
        aside = path if self._whole else f"{path}.{uuid.uuid4().hex}.part"
        self._files.makedirs(path.rpartition("/")[0], exist_ok=True)
        with self._files.open(aside, "wb") as out:
            yield out
        if aside != path:
            self._files.mv(aside, path)


def open_storage(where: str | Path) -> Storage:
    """The storage at a folder or an fsspec URL. Raises SpecError."""
    return Remote(where) if isinstance(where, str) and "://" in where else Folder(Path(where))
