"""JSON documents: written aside and renamed, read with an error that names the file."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
import orjson
from numpy.typing import NDArray

from fitter.errors import SpecError

#: The kind of a document that holds several fits of one table.
FITS = "brdf-fitter/fits"


def finite_or_none(array: NDArray[Any]) -> Any:
    """Nested lists with None where not finite: JSON has no NaN."""
    if array.ndim == 0:
        return float(array) if np.isfinite(array) else None
    return [finite_or_none(np.asarray(part)) for part in array]


def floats(nested: Any) -> NDArray[np.float64]:
    """The inverse of :func:`finite_or_none`: None becomes NaN."""
    return np.asarray(nested, dtype=np.float64)


def dumps(document: Mapping[str, Any]) -> bytes:
    """Compact JSON; numpy scalars and arrays are understood, NaN becomes null."""
    return orjson.dumps(document, option=orjson.OPT_SERIALIZE_NUMPY)


def file_stem(name: str, longest: int = 80) -> str:
    """A table's name as that of a file, which every file system takes."""
    return re.sub(r"[^\w.+-]+", "_", name).strip("._")[:longest] or "table"


@contextmanager
def aside(path: Path) -> Generator[IO[bytes]]:
    """A stream into a file of the same folder, which takes the place of ``path`` when the block ends well: no
    reader ever sees half a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        # mkstemp makes files private; results are ordinary files.
        mask = os.umask(0)
        os.umask(mask)
        Path(name).chmod(0o666 & ~mask)
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def write_bytes(content: bytes, path: Path) -> None:
    """Write a file aside and rename it into place."""
    with aside(path) as stream:
        stream.write(content)


def write_document(document: Mapping[str, Any], path: Path) -> None:
    """Write a JSON document aside and rename it into place."""
    write_bytes(dumps(document), path)


def read_document(path: Path, code: str) -> Mapping[str, Any]:
    """Read a JSON object. Raises SpecError naming the file when it is missing or isn't one."""
    try:
        document = orjson.loads(path.read_bytes())
    except OSError as error:
        raise SpecError(f"can't be read: {error.strerror}", code=code, file=str(path)) from error
    except orjson.JSONDecodeError as error:
        raise SpecError(
            f"is not JSON ({error.msg})", code=code, file=str(path), row=error.lineno,
            remedy="give a result file that brdf-fitter wrote",
        ) from error  # fmt: skip
    if not isinstance(document, dict):
        raise SpecError("is not a JSON object", code=code, file=str(path))
    return document
