"""Byte strings in one: each with its length, compressed where that makes it shorter; and exact arrays."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

LEVEL = 19
#: Large parts are packed at this level: the highest ones take a second for a megabyte.
_QUICK, _LARGE = 9, 1 << 20
_HEAD = struct.Struct("<BI")
#: No part is larger than this once unpacked: a forged length must not fill the memory.
_LARGEST = 1 << 32


def squeezed(data: bytes) -> bytes:
    """``data`` through zstd, without checksum."""
    level = LEVEL if len(data) <= _LARGE else _QUICK
    return zstandard.ZstdCompressor(level=level).compress(data)


def unsqueezed(data: bytes) -> bytes:
    """Inverse of :func:`squeezed`. Raises ValueError."""
    try:
        size = zstandard.frame_content_size(data)
        if not 0 <= size <= _LARGEST:
            raise ValueError(f"it claims {size} bytes")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size) if size else b""
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from error


def pack_parts(parts: Sequence[bytes]) -> bytes:
    """The parts, one after another."""
    found: list[bytes] = []
    for part in parts:
        smaller = squeezed(part)
        stored = smaller if len(smaller) < len(part) else part
        found += [_HEAD.pack(stored is smaller, len(stored)), stored]
    return b"".join(found)


def unpack_parts(data: bytes, count: int) -> list[bytes]:
    """The ``count`` parts. Raises ValueError where there are others."""
    found: list[bytes] = []
    place = 0
    for _ in range(count):
        if place + _HEAD.size > len(data):
            raise ValueError("it ends early")
        small, length = _HEAD.unpack_from(data, place)
        place += _HEAD.size
        part = data[place : place + length]
        if len(part) < length:
            raise ValueError("it ends early")
        found.append(unsqueezed(part) if small else part)
        place += length
    if place != len(data):
        raise ValueError(f"{len(data) - place} bytes too many")
    return found


def pack_array(array: NDArray[Any]) -> bytes:
    """An array, exactly: bytes of equal significance together, where they repeat, then zstd."""
    array = np.ascontiguousarray(array)
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    raw = np.frombuffer(little.tobytes(), np.uint8).reshape(array.size, array.dtype.itemsize).T.tobytes()
    return squeezed(raw)


def unpack_array(data: bytes, dtype: str, shape: tuple[int, ...] | None = None) -> NDArray[Any]:
    """Inverse of :func:`pack_array`; flat without ``shape``. Raises ValueError."""
    kind = np.dtype(dtype)
    raw = unsqueezed(data)
    columns = np.frombuffer(raw, np.uint8).reshape(kind.itemsize, -1).T
    flat = np.frombuffer(columns.tobytes(), kind)
    if shape is not None and flat.size != int(np.prod(shape, dtype=np.int64)):
        raise ValueError(f"it holds {flat.size} numbers, not {'x'.join(map(str, shape))}")
    return (flat if shape is None else flat.reshape(shape)).astype(kind.newbyteorder("="))
