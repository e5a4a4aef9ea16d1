"""Tensor files: named arrays in one little-endian file, the container of EPFL's RGL material database.

``tensor_file\\0``, version (two bytes), the number of fields; for each field its name, number of
dimensions, type, place in the file and shape (J. Dupuy, W. Jakob 2018, "An adaptive parameterization for
efficient material acquisition and rendering", and the reader published with it,
github.com/rgl-epfl/brdf-loader).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.formats.source import Source

MAGIC = b"tensor_file\0"
VERSION = (1, 0)
#: Element types by their number in the file.
_TYPES = {
    1: "<u1", 2: "<i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<u8", 8: "<i8",
    9: "<f2", 10: "<f4", 11: "<f8",
}  # fmt: skip
#: More dimensions than any field of such a file has.
_MOST_DIMENSIONS = 16
_HEAD = struct.Struct("<12sBBI")
_ALIGNMENT = 8


def fields(source: Source) -> dict[str, NDArray[Any]]:
    """Every field by its name, as views of the file's bytes: nothing is allocated by what a header claims.

    Raises TableError for a wrong version or type, and for fields that don't lie inside the file.
    """
    data, at = source.buffer, _HEAD.size
    if len(data) < at:
        raise _cut(source, "the header", "header", 0)
    _, major, minor, count = _HEAD.unpack_from(data)
    if (major, minor) != VERSION:
        raise source.error(
            f"the tensor file has version {major}.{minor}", "table-header", column="version",
            offset=12, cause="a newer kind of file, or a damaged one", remedy="use a file of version 1.0",
        )  # fmt: skip
    found: dict[str, NDArray[Any]] = {}
    for k in range(count):
        what, start = f"the description of field {k + 1} of {count}", at
        if at + 2 > len(data):
            raise _cut(source, what, "header", at)
        (length,) = struct.unpack_from("<H", data, at)
        if at + length + 13 > len(data):
            raise _cut(source, what, "header", start)
        name = bytes(data[at + 2 : at + 2 + length]).decode(errors="replace")
        dimensions, kind, offset = struct.unpack_from("<HBQ", data, at + 2 + length)
        at += length + 13
        if at + 8 * dimensions > len(data):
            raise _cut(source, what, "header", start)
        shape: tuple[int, ...] = struct.unpack_from(f"<{dimensions}Q", data, at)
        at += 8 * dimensions
        if name in found or kind not in _TYPES or dimensions > _MOST_DIMENSIONS or 0 in shape:
            wrong = (
                "is there twice" if name in found
                else f"has the unknown type {kind}" if kind not in _TYPES
                else f"has the shape {shape[:8]}"
            )  # fmt: skip
            raise source.error(
                f"the field {name[:40]!r} {wrong}", "table-header", column=name[:40], offset=start,
                cause="a damaged file", remedy="fetch the file again",
            )  # fmt: skip
        dtype = np.dtype(_TYPES[kind])
        size = math.prod(shape)
        if offset + size * dtype.itemsize > len(data):
            raise _cut(source, f"the field {name[:40]!r} {shape[:8]}", name[:40], start)
        found[name] = np.frombuffer(data, dtype, size, offset).reshape(shape)
    return found


def tensor_bytes(arrays: Mapping[str, NDArray[Any]]) -> Iterator[bytes]:
    """The parts of a tensor file that holds ``arrays``, each stored in its own type."""
    kinds = {np.dtype(name).str.lstrip("<|"): kind for kind, name in _TYPES.items()}
    stored = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    at = _HEAD.size + sum(13 + len(name.encode()) + 8 * a.ndim for name, a in stored.items())
    yield _HEAD.pack(MAGIC, *VERSION, len(stored))
    gaps: list[int] = []
    for name, array in stored.items():
        gaps.append(-at % _ALIGNMENT)
        at += gaps[-1]
        label = name.encode()
        kind = kinds[array.dtype.str.lstrip("<|")]
        yield struct.pack("<H", len(label)) + label
        yield struct.pack(f"<HBQ{array.ndim}Q", array.ndim, kind, at, *array.shape)
        at += array.nbytes
    for gap, array in zip(gaps, stored.values(), strict=True):
        yield bytes(gap)
        yield array.tobytes()


def _cut(source: Source, what: str, field: str, at: int) -> Exception:
    return source.error(
        f"the file ends inside {what}: it has {source.size:,} bytes", "table-truncated", column=field,
        offset=at, cause="the file is cut off, or its header is damaged", remedy="fetch the file again",
    )  # fmt: skip
