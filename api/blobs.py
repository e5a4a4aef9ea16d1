"""Blobs: uploaded bytes, named by their sha256."""

from __future__ import annotations

import hashlib
import os
import tempfile
import threading
from pathlib import Path
from types import TracebackType
from typing import Self

from api.problems import Problem


class Incoming:
    """Bytes on their way in: written aside, hashed as they pass, gone unless :meth:`Blobs.keep` takes them.

    A context manager; on leaving it whatever was not kept is deleted.
    """

    def __init__(self, folder: Path, limit: int) -> None:
        handle, name = tempfile.mkstemp(dir=folder)
        self.path = Path(name)
        self.size = 0
        self._limit = limit
        self._file = os.fdopen(handle, "wb")
        self._digest = hashlib.sha256()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
        self.path.unlink(missing_ok=True)

    def write(self, chunk: bytes) -> None:
        """Append. Raises Problem (413) as soon as the limit is passed."""
        self.size += len(chunk)
        if self.size > self._limit:
            raise Problem.too_large(self._limit)
        self._digest.update(chunk)
        self._file.write(chunk)

    def finish(self) -> str:
        """Everything is on the disk; the sha256 of it."""
        self._file.flush()
        os.fsync(self._file.fileno())
        return self._digest.hexdigest()


class Blobs:
    """A folder of files named by their content.

    ``lock`` guards the step from "no row names this blob" to its deletion: whoever adds a row that
    names a blob, or drops one, holds it.
    """

    def __init__(self, folder: Path) -> None:
        self._kept = folder / "blobs"
        self._aside = folder / "incoming"
        for one in (self._kept, self._aside):
            one.mkdir(parents=True, exist_ok=True)
        self.lock = threading.Lock()

    def clear_incoming(self) -> None:
        """Delete what a dead process left half-written. Only for the folder's one owner, at start."""
        for path in self._aside.iterdir():
            path.unlink()

    def incoming(self, limit: int) -> Incoming:
        """A new upload of at most ``limit`` bytes."""
        return Incoming(self._aside, limit)

    def path(self, sha256: str) -> Path:
        """Where the blob is (or would be)."""
        return self._kept / sha256[:2] / sha256

    def keep(self, incoming: Incoming, sha256: str) -> None:
        """Rename the finished upload into place; the same bytes again change nothing."""
        target = self.path(sha256)
        target.parent.mkdir(exist_ok=True)
        incoming.path.replace(target)

    def drop(self, sha256: str) -> None:
        """Delete the blob, which no row may name any more."""
        self.path(sha256).unlink(missing_ok=True)
