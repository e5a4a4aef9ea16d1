"""The container file: magic, version, a packed JSON header, then named blocks with a checksum each."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, cast

from numpy.typing import NDArray

from fitter.compression.archive import pack_array, squeezed, unpack_array, unsqueezed
from fitter.errors import TableError

MAGIC = b"\x89BRDFfit"
#: What is written, and what is read: tiles of version 2 have another order of tokens, see tile.
VERSION, READ = 3, (2, 3)
# magic, version, length of the packed header, its crc32
_PREFIX = struct.Struct("<8sHII")

#: What to do with a block that is damaged: refuse the file, or read the others.
Damage = Literal["refuse", "keep"]


@dataclass(frozen=True)
class Block:
    """Bytes with a name, and what is to be known to read them."""

    name: str
    data: bytes
    about: Mapping[str, Any] = field(default_factory=dict[str, Any])

    @property
    def crc(self) -> int:
        return zlib.crc32(self.data)


def array_block(name: str, array: NDArray[Any]) -> Block:
    """A block of an array, exactly."""
    return Block(name, pack_array(array), {"dtype": array.dtype.newbyteorder("<").str, "shape": array.shape})


def array_of(block: Block) -> NDArray[Any]:
    """The array of a block. Raises TableError that names the block when its content makes no sense."""
    try:
        return unpack_array(block.data, block.about["dtype"], tuple(block.about["shape"]))
    except (ValueError, TypeError, KeyError) as error:
        raise damaged(f"block {block.name!r} can't be unpacked ({error})", None, block.name) from error


def encode(header: Mapping[str, Any], blocks: Sequence[Block]) -> bytes:
    """The file."""
    listed = [{"name": b.name, "bytes": len(b.data), "crc32": b.crc, **b.about} for b in blocks]
    text = squeezed(json.dumps({**header, "blocks": listed}, separators=(",", ":")).encode())
    prefix = _PREFIX.pack(MAGIC, VERSION, len(text), zlib.crc32(text))
    return b"".join([prefix, text, *(block.data for block in blocks)])


def decode(
    data: bytes, file: str | None = None, damage: Damage = "refuse"
) -> tuple[dict[str, Any], dict[str, Block], dict[str, str]]:
    """``(header, blocks, damaged)`` of a container; every checksum is verified.

    damaged : what is wrong with each block that is not among ``blocks``; empty unless ``damage`` is "keep".

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
    if version not in READ:
        raise TableError(
            f"the container has version {version}, this library reads {READ[0]} and {READ[1]}",
            code="compressed-version", file=file, offset=len(MAGIC),
            remedy="use the version of brdf-fitter that wrote it",
        )  # fmt: skip
    text = data[_PREFIX.size : _PREFIX.size + length]
    if len(text) < length or zlib.crc32(text) != crc:
        message = "the header is damaged, and without it no block can be read"
        raise damaged(message, file, "header", whole=True)
    try:
        header = cast("dict[str, Any]", json.loads(unsqueezed(text)))
    except ValueError as error:
        raise damaged(f"the header can't be unpacked ({error})", file, "header", whole=True) from error
    blocks: dict[str, Block] = {}
    lost: dict[str, str] = {}
    start = _PREFIX.size + length
    for item in header.pop("blocks"):
        name, size, stated = item.pop("name"), item.pop("bytes"), item.pop("crc32")
        block = Block(name, data[start : start + size], item)
        start += size
        if len(block.data) < size:
            lost[name] = f"the file ends {'inside' if block.data else 'before'} block {name!r}"
        elif block.crc != stated:
            lost[name] = f"block {name!r} fails its checksum"
        else:
            blocks[name] = block
        if name in lost and damage == "refuse":
            raise damaged(lost[name], file, name)
    if start < len(data):
        lost["end"] = f"{len(data) - start} bytes follow the last block"
        if damage == "refuse":
            raise damaged(lost["end"], file, "end")
    return header, blocks, lost


def damaged(message: str, file: str | None, block: str, *, whole: bool = False) -> TableError:
    """The error for a block that can't be read; ``whole`` where nothing else can be read, either."""
    rest = "" if whole else "; `brdf-fitter decompress --salvage` reads the other blocks"
    return TableError(
        message, code="compressed-damaged", file=file, column=block,
        cause="the file was cut short or changed after it was written",
        remedy=f"copy it again from its source, or compress the original table again{rest}",
    )  # fmt: skip
