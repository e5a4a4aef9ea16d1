"""Directions of scattered samples as bytes, exactly: a list of those that repeat, z from x and y."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.compression.archive import pack_array, pack_parts, unpack_array, unpack_parts
from fitter.compression.container import Block, damaged

FloatArray = NDArray[np.float64]

#: Directions are listed once each where there are this many times fewer of them than samples.
_REPEATED = 4


def direction_block(name: str, w: FloatArray) -> Block:
    """A block of unit vectors (N, 3), bit by bit."""
    bits = np.ascontiguousarray(w).view(np.int64)
    listed, which = np.unique(bits, axis=0, return_inverse=True)
    about = {"samples": len(w), "listed": len(w)}
    parts: list[bytes] = []
    if _REPEATED * len(listed) <= len(w):
        about["listed"] = len(listed)
        parts.append(pack_array(which.reshape(-1).astype(np.int32)))
        w = listed.view(np.float64)
    x, y, z = w.T
    # The square root is rounded correctly everywhere: what z differs by is a few units of its last place.
    away = np.ascontiguousarray(z).view(np.int64) ^ _third(x, y).view(np.int64)
    parts += [pack_array(part) for part in (x, y, away)]
    return Block(name, pack_parts(parts), about)


def directions_of(block: Block) -> FloatArray:
    """Inverse of :func:`direction_block`. Raises TableError."""
    samples, listed = int(block.about["samples"]), int(block.about["listed"])
    try:
        *which, x, y, away = unpack_parts(block.data, 3 if listed == samples else 4)
        x, y = (unpack_array(part, "<f8", (listed,)) for part in (x, y))
        z = (unpack_array(away, "<i8", (listed,)) ^ _third(x, y).view(np.int64)).view(np.float64)
        w = np.stack([x, y, z], axis=1)
        return w[unpack_array(which[0], "<i4", (samples,))] if which else w
    except (ValueError, IndexError) as error:
        raise damaged(f"block {block.name!r} can't be unpacked ({error})", None, block.name) from error


def _third(x: FloatArray, y: FloatArray) -> FloatArray:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))
