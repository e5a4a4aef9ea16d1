"""HDF5 files written byte by byte, in the layout of HDF5 1.6 (File Format Specification 3.0, version 0).

Variables are contiguous, or in deflated chunks; dimension scales are attached as netCDF-4 does. h5py reads
what this writes.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

NONE = 0xFFFFFFFFFFFFFFFF
FLOATS = {8: (63, 64, 52, 11, 0, 52, 1023), 4: (31, 32, 23, 8, 0, 23, 127)}


@dataclass
class Var:
    """A dataset. ``over`` names the scales of its axes; ``chunks`` makes it chunked, ``filters`` packs these.

    gaps : chunks that are left out. A dataset whose own name is in its ``over`` alone is a scale.
    """

    data: Any
    over: Sequence[str] = ()
    attributes: Mapping[str, Any] = field(default_factory=dict[str, Any])
    chunks: tuple[int, ...] | None = None
    filters: Sequence[int] = (2, 1, 3)
    gaps: int = 0


Tree = Mapping[str, "Var | Tree"]


def padded(data: bytes, to: int = 8) -> bytes:
    return data + bytes(-len(data) % to)


def type_of(a: np.ndarray) -> bytes:
    """The datatype message of an array; an object array is one of texts of any length."""
    kind, size = a.dtype.kind, a.dtype.itemsize
    if a.dtype.names:
        members = b"".join(
            padded(name.encode() + b"\0") + struct.pack("<IB3xI4x16x", a.dtype.fields[name][1], 0, 0)
            + type_of(np.empty(0, a.dtype[name])) for name in a.dtype.names
        )  # fmt: skip
        return struct.pack("<BHBI", 0x16, len(a.dtype.names), 0, size) + members
    if kind == "f":
        sign, *rest = FLOATS[size]
        return struct.pack("<BBBBIHHBBBBI", 0x11, 0x20, sign, 0, size, 0, *rest)
    if kind in "iu":
        return struct.pack("<BBBBIHH", 0x10, 8 * (kind == "i"), 0, 0, size, 0, 8 * size)
    if kind == "S":
        return struct.pack("<BBBBI", 0x13, 1, 0, 0, size)
    text = struct.pack("<BBBBI", 0x13, 0, 0, 0, 1)
    return struct.pack("<BBBBI", 0x19, 1, 0, 0, 16) + text


REFERENCE = struct.pack("<BBBBI", 0x17, 0, 0, 0, 8)
REFERENCES = struct.pack("<BBBBI", 0x19, 0, 0, 0, 16) + REFERENCE


def space_of(shape: tuple[int, ...]) -> bytes:
    return struct.pack(f"<BBB5x{len(shape)}Q", 1, len(shape), 0, *shape)


def header(messages: Sequence[tuple[int, bytes]]) -> bytes:
    body = b"".join(
        struct.pack("<HHB3x", kind, len(padded(data)), 0) + padded(data) for kind, data in messages
    )
    return struct.pack("<BxHII4x", 1, len(messages), 1, len(body)) + body


def attribute(name: str, kind: bytes, shape: tuple[int, ...], data: bytes) -> tuple[int, bytes]:
    word, space = name.encode() + b"\0", space_of(shape)
    head = struct.pack("<BxHHH", 1, len(word), len(kind), len(space))
    return 0x0C, head + padded(word) + padded(kind) + padded(space) + data


class Writer:
    """``bytes()`` of a tree of groups and variables."""

    def __init__(self, tree: Tree, attributes: Mapping[str, Any]) -> None:
        self.buffer = bytearray(96)
        self.heap: list[bytes] = []
        self.heap_at = self.put(bytes(4096))
        self.places: dict[str, int] = {}
        root = self.group(tree, attributes)
        words = b"".join(
            struct.pack("<HHIQ", k, 1, 0, len(word)) + padded(word)
            for k, word in enumerate(self.heap, start=1)
        )
        free = struct.pack("<HHIQ", 0, 0, 0, 4096 - 16 - len(words))
        self.buffer[self.heap_at : self.heap_at + 4096] = (
            struct.pack("<4sB3xQ", b"GCOL", 1, 4096) + words + free
        ).ljust(4096, b"\0")
        self.buffer[:96] = struct.pack(
            "<8s8BHHIQQQQQQII16x", b"\x89HDF\r\n\x1a\n", 0, 0, 0, 0, 0, 8, 8, 0, 16, 16, 0, 0, NONE,
            len(self.buffer), NONE, 0, root, 0, 0,
        )  # fmt: skip

    def put(self, data: bytes) -> int:
        at = len(self.buffer)
        self.buffer += padded(data)
        return at

    def word(self, data: bytes, count: int) -> bytes:
        """A place in the heap of words, as a value of variable length."""
        self.heap.append(data)
        return struct.pack("<IQI", count, self.heap_at, len(self.heap))

    def values(self, a: np.ndarray) -> bytes:
        if a.dtype.kind != "O":
            return a.tobytes()
        return b"".join(self.word(word.encode(), len(word.encode())) for word in a.reshape(-1).tolist())

    def attributes(self, said: Mapping[str, Any]) -> list[tuple[int, bytes]]:
        arrays = {
            key: np.asarray(value, object if isinstance(value, str | list) else None)
            for key, value in said.items()
        }
        return [attribute(key, type_of(a), a.shape, self.values(a)) for key, a in arrays.items()]

    def group(self, tree: Tree, attributes: Mapping[str, Any]) -> int:
        # Scales first: the others refer to them.
        order = sorted(tree, key=lambda name: getattr(tree[name], "over", None) != (name,))
        at = {
            name: self.variable(name, one) if isinstance(one := tree[name], Var) else self.group(one, {})
            for name in order
        }
        names = sorted(tree)
        words, offsets = bytearray(8), {}
        for name in names:
            offsets[name] = len(words)
            words += padded(name.encode() + b"\0")
        heap = self.put(struct.pack("<4sB3xQQQ", b"HEAP", 0, len(words), 1, len(self.buffer) + 32) + words)
        nodes = b"".join(struct.pack("<QQII16x", offsets[name], at[name], 0, 0) for name in names)
        leaf = self.put((struct.pack("<4sBxH", b"SNOD", 1, len(names)) + nodes).ljust(1288, b"\0"))
        last = offsets[names[-1]] if names else 0
        tree_at = self.put(
            struct.pack("<4sBBHQQQQQ", b"TREE", 0, 0, 1, NONE, NONE, 0, leaf, last).ljust(544, b"\0")
        )
        return self.put(header([(0x11, struct.pack("<QQ", tree_at, heap)), *self.attributes(attributes)]))

    def variable(self, name: str, one: Var) -> int:
        a = np.asarray(one.data)
        messages = [(1, space_of(a.shape)), (3, type_of(a)), (5, bytes([2, 2, 2, 0]))]
        if one.chunks is None:
            raw = self.values(a)
            messages.append((8, struct.pack("<BBQQ", 3, 1, self.put(raw) if raw else NONE, len(raw))))
        else:
            messages += self.chunked(a, one)
        messages += self.attributes(one.attributes)
        if one.over == (name,):
            messages += [self.scale("DIMENSION_SCALE", "CLASS"), self.scale(name, "NAME")]
        elif one.over:
            refs = b"".join(self.word(struct.pack("<Q", self.places[scale]), 1) for scale in one.over)
            messages.append(attribute("DIMENSION_LIST", REFERENCES, (len(one.over),), refs))
        self.places[name] = self.put(header(messages))
        return self.places[name]

    def scale(self, text: str, key: str) -> tuple[int, bytes]:
        a = np.asarray(text.encode() + b"\0", f"S{len(text) + 1}")
        return attribute(key, type_of(a), (), a.tobytes().ljust(len(text) + 1, b"\0"))

    def chunked(self, a: np.ndarray, one: Var) -> list[tuple[int, bytes]]:
        assert one.chunks is not None
        rank, width = a.ndim, a.dtype.itemsize
        entries: list[bytes] = []
        starts = list(product(*(range(0, n, c) for n, c in zip(a.shape, one.chunks, strict=True))))
        for start in starts[: len(starts) - one.gaps]:
            block = np.zeros(one.chunks, a.dtype)
            part = a[tuple(slice(s, s + c) for s, c in zip(start, one.chunks, strict=True))]
            block[tuple(slice(n) for n in part.shape)] = part
            data = block.tobytes()
            for number in one.filters:
                if number == 2:
                    data = np.frombuffer(data, np.uint8).reshape(-1, width).T.tobytes()
                elif number == 1:
                    data = zlib.compress(data)
                elif number == 3:
                    data += fletcher32(data)
            key = struct.pack(f"<II{rank + 1}Q", len(data), 0, *start, 0)
            entries.append(key + struct.pack("<Q", self.put(data)))
        end = (-(-n // c) * c for n, c in zip(a.shape, one.chunks, strict=True))
        last = struct.pack(f"<II{rank + 1}Q", 0, 0, *end, 0)
        tree = struct.pack("<4sBBHQQ", b"TREE", 1, 0, len(entries), NONE, NONE) + b"".join(entries) + last
        at = self.put(tree.ljust(24 + 64 * (24 + 8 * rank) + 16 + 8 * rank, b"\0"))
        layout = struct.pack(f"<BBBQ{rank}II", 3, 2, rank + 1, at, *one.chunks, width)
        values = {1: (6,), 2: (width,), 3: ()}
        pipeline = struct.pack("<BB6x", 1, len(one.filters))
        for number in one.filters:
            data = values.get(number, ())
            pipeline += struct.pack(f"<HHHH{len(data)}I", number, 0, 0, len(data), *data)
            pipeline += bytes(4 * (len(data) % 2))
        return [(8, layout), *([(0x0B, pipeline)] if one.filters else [])]


def fletcher32(data: bytes) -> bytes:
    """HDF5's checksum: sums over big-endian 16-bit words."""
    low = high = 0
    for (word,) in struct.iter_unpack(">H", padded(data, 2)):
        low = (low + word) % 65535
        high = (high + low) % 65535
    return struct.pack("<I", high << 16 | low)


def hdf5(tree: Tree, **attributes: Any) -> bytes:
    """A file of groups and variables, with attributes at its root."""
    return bytes(Writer(tree, attributes).buffer)
