"""The container file: magic, version, a JSON header, then named zstd blocks with a checksum each."""

from __future__ import annotations

import json
import os
import struct
import tempfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import zstandard
from numpy.typing import NDArray

from fitter.errors import TableError

MAGIC = b"\x89BRDFfit"
VERSION = 1
# magic, version, header length, crc32 of the header
_PREFIX = struct.Struct("<8sHII")
LEVEL = 9
# No table is larger than this once unpacked (a forged length must not fill the memory).
_LARGEST = 1 << 32


@dataclass(frozen=True)
class Block:
    """One array, packed: bytes shuffled by significance, then zstd."""

    name: str
    dtype: str
    shape: tuple[int, ...]
    data: bytes

    @property
    def crc(self) -> int:
        return zlib.crc32(self.data)


def pack(name: str, array: NDArray[Any], level: int = LEVEL) -> Block:
    """A block of ``array``. Shuffling puts equal-significance bytes together, where they repeat."""
    array = np.ascontiguousarray(array)
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    raw = np.frombuffer(little.tobytes(), np.uint8).reshape(array.size, array.dtype.itemsize).T.tobytes()
    data = zstandard.ZstdCompressor(level=level).compress(raw)
    return Block(name, little.dtype.str, array.shape, data)


def unpack(block: Block, file: str | None = None) -> NDArray[Any]:
    """The array of a block. Raises TableError that names the block when its content makes no sense."""
    dtype = np.dtype(block.dtype)
    size = int(np.prod(block.shape, dtype=np.int64)) * dtype.itemsize
    stated = zstandard.frame_content_size(block.data) if len(block.data) >= 18 else size
    if not 0 <= size <= _LARGEST or stated != size:
        raise _damaged(f"block {block.name!r} claims {size} bytes", file, block.name)
    try:
        raw = zstandard.ZstdDecompressor().decompress(block.data, max_output_size=size) if size else b""
    except zstandard.ZstdError as error:
        raise _damaged(f"block {block.name!r} can't be unpacked ({error})", file, block.name) from error
    if len(raw) != size:
        raise _damaged(f"block {block.name!r} holds {len(raw)} bytes, {size} expected", file, block.name)
    columns = np.frombuffer(raw, np.uint8).reshape(dtype.itemsize, -1).T
    array = np.frombuffer(columns.tobytes(), dtype).reshape(block.shape)
    return array.astype(dtype.newbyteorder("="))


def write(header: Mapping[str, Any], blocks: Mapping[str, Block], path: Path) -> None:
    """Write aside and rename: a file of that name is always whole."""
    text = encode_header(header, blocks)
    descriptor, aside = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(text)
            for block in blocks.values():
                stream.write(block.data)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(aside, 0o644)
        os.replace(aside, path)
    except BaseException:
        Path(aside).unlink(missing_ok=True)
        raise


def encode_header(header: Mapping[str, Any], blocks: Mapping[str, Block]) -> bytes:
    """Everything before the first block."""
    listed = [
        {"name": b.name, "dtype": b.dtype, "shape": list(b.shape), "bytes": len(b.data), "crc32": b.crc}
        for b in blocks.values()
    ]
    text = json.dumps({**header, "blocks": listed}, separators=(",", ":")).encode()
    return _PREFIX.pack(MAGIC, VERSION, len(text), zlib.crc32(text)) + text


def read(data: bytes, file: str | None = None) -> tuple[dict[str, Any], dict[str, Block]]:
    """``(header, blocks)`` of a container; every checksum is verified.

    Raises
    ------
    TableError : not a container, another version, truncated or corrupted (names the block).
    """
    if len(data) < _PREFIX.size or not data.startswith(MAGIC):
        raise TableError(
            "this is not a compressed table", code="compressed-magic", file=file,
            offset=0, cause="another kind of file, or its first bytes are lost",
            remedy="read measured files with fitter.load",
        )  # fmt: skip
    _, version, length, crc = _PREFIX.unpack_from(data)
    if version != VERSION:
        raise TableError(
            f"the container has version {version}, this library reads {VERSION}", code="compressed-version",
            file=file, offset=len(MAGIC),
            remedy="use the version of brdf-fitter that wrote it, or a newer one",
        )  # fmt: skip
    text = data[_PREFIX.size : _PREFIX.size + length]
    if len(text) < length or zlib.crc32(text) != crc:
        raise _damaged("the header is damaged", file, "header")
    header = cast("dict[str, Any]", json.loads(text))
    blocks: dict[str, Block] = {}
    start = _PREFIX.size + length
    for item in header["blocks"]:
        part = data[start : start + item["bytes"]]
        start += item["bytes"]
        if len(part) < item["bytes"]:
            raise _damaged(f"the file ends inside block {item['name']!r}", file, item["name"])
        if zlib.crc32(part) != item["crc32"]:
            raise _damaged(f"block {item['name']!r} fails its checksum", file, item["name"])
        blocks[item["name"]] = Block(item["name"], item["dtype"], tuple(item["shape"]), part)
    if start != len(data):
        raise _damaged(f"{len(data) - start} bytes follow the last block", file, "end")
    return header, blocks


def _damaged(message: str, file: str | None, block: str) -> TableError:
    return TableError(
        message, code="compressed-damaged", file=file, column=block,
        cause="the file was cut short or changed after it was written",
        remedy="copy it again from its source, or compress the original table again",
    )  # fmt: skip
