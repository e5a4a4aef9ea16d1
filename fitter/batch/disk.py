"""A disk that takes no more, told as such."""

from __future__ import annotations

import errno
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from fitter.errors import FitError

_FULL = (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def disk(folder: Path) -> Generator[None]:
    """Turns a disk that takes no more into an error that says what to do."""
    try:
        yield
    except OSError as error:
        full = error.errno in _FULL
        raise FitError(
            f"the disk of {folder} is full" if full
            else f"results can't be written: {error.strerror or error}",
            code="disk-full" if full else "output-unwritable", file=str(folder),
            remedy=("make room" if full else "mend that") + " and give the same command again: what is "
            "finished is kept",
        ) from error  # fmt: skip
