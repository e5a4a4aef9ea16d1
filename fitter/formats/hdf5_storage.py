"""The stored numbers of an HDF5 dataset: nothing is allocated before the file is known to hold it.

Facts: HDF5 File Format Specification 3.0, chapters IV.A.2.h (layouts) and IV.A.2.l (filters).
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.formats.source import Source

#: What deflate can at most unpack a byte to (RFC 1951: 258 bytes from two bits).
_DEFLATE = 1032
#: Up to so many bytes sizes are not looked at.
SMALL = 1 << 22
_UNDEFINED = 0xFFFFFFFFFFFFFFFF
_DEFLATE_FILTER, _SHUFFLE, _FLETCHER32 = 1, 2, 3
_FILTERS = {4: "szip", 5: "nbit", 6: "scaleoffset", 32000: "LZF", 32001: "Blosc", 32015: "Zstandard"}


class Damaged(ValueError):
    """What the file says of a dataset can't be true."""


@dataclass(frozen=True)
class Stored:
    """Where a dataset's bytes are. ``base`` is added to its addresses; ``known`` is pyfive's DatasetID."""

    source: Source
    known: Any
    base: int

    def array(self) -> NDArray[Any]:
        """All numbers, as stored; as float64 with NaN where there are parts that were never written.

        Raises Damaged where the sizes don't fit the file, NotImplementedError for what is not read.
        """
        kind = np.dtype(self.known.dtype)
        return self.raw(np.dtype(kind.str) if kind.fields is None else kind)

    def raw(self, kind: np.dtype[Any]) -> NDArray[Any]:
        """:meth:`array` with its elements read as ``kind``, which has the size of the stored ones."""
        shape = tuple(int(n) for n in self.known.shape)
        count = math.prod(shape)
        layout = self.known.layout_class
        if count == 0:
            return np.empty(shape, kind)
        if layout == 0:
            data = self.known._data or b""
            if len(data) < count * kind.itemsize:
                raise Damaged(f"{count:,} numbers are in {len(data):,} bytes")
            return np.frombuffer(data, kind, count).reshape(shape)
        if layout == 1 and self.known.data_offset != _UNDEFINED:
            start = self.base + int(self.known.data_offset)
            end = start + count * kind.itemsize
            if end > self.source.size:
                raise Damaged(f"its numbers end at byte {end:,} of {self.source.size:,}")
            return np.frombuffer(self.source.buffer, kind, count, start).reshape(shape)
        if layout not in (1, 2):
            raise NotImplementedError(f"data of layout class {layout}")
        index: dict[tuple[int, ...], Any] = {} if layout == 1 else self.known.index
        return self._from_chunks(shape, kind, index)

    def _from_chunks(
        self, shape: tuple[int, ...], kind: np.dtype[Any], index: dict[tuple[int, ...], Any]
    ) -> NDArray[Any]:
        chunks = tuple(int(n) for n in self.known.chunks or shape)
        size = math.prod(chunks) * kind.itemsize
        pipeline: list[dict[str, Any]] = self.known.filter_pipeline or []
        for step in pipeline:
            number = int(step["filter_id"])
            if number not in (_DEFLATE_FILTER, _SHUFFLE, _FLETCHER32):
                raise NotImplementedError(f"its data are filtered by {_FILTERS.get(number, number)}")
        total = math.prod(shape) * kind.itemsize
        stored = sum(min(int(one.size), self.source.size) for one in index.values())
        most = max(_DEFLATE * stored, self.source.size, SMALL)
        if len(chunks) != len(shape) or min(chunks) < 1 or total > most or size > max(most, 2 * total):
            raise Damaged(f"{total:,} bytes in chunks of {size:,} are claimed where {stored:,} are stored")
        inside = {at: one for at, one in index.items() if all(a < n for a, n in zip(at, shape, strict=True))}
        whole = math.prod(-(-n // c) for n, c in zip(shape, chunks, strict=True))
        if any(a % c for at in inside for a, c in zip(at, chunks, strict=True)) or len(inside) > whole:
            raise Damaged("its chunks don't lie on their grid")
        gaps = len(inside) < whole
        if gaps and (kind.kind not in "iuf" or (2 * len(inside) < whole and total > SMALL)):
            raise Damaged(f"{whole - len(inside):,} of its {whole:,} chunks were never written")
        out: NDArray[Any] = np.full(shape, np.nan) if gaps else np.empty(shape, kind)
        for at, one in inside.items():
            block = self._block(one, pipeline, size, kind).reshape(chunks)
            here = tuple(slice(a, min(a + c, n)) for a, c, n in zip(at, chunks, shape, strict=True))
            out[here] = block[tuple(slice(0, part.stop - part.start) for part in here)]
        return out

    def _block(
        self, one: Any, pipeline: list[dict[str, Any]], size: int, kind: np.dtype[Any]
    ) -> NDArray[Any]:
        """The elements of one chunk of ``size`` bytes."""
        start = self.base + int(one.byte_offset)
        data = bytes(self.source.buffer[start : start + int(one.size)])
        if len(data) < int(one.size):
            raise Damaged(f"a chunk ends at byte {start + int(one.size):,} of {self.source.size:,}")
        for k in reversed(range(len(pipeline))):
            if int(one.filter_mask) >> k & 1:
                continue
            step = pipeline[k]["filter_id"]
            if step == _DEFLATE_FILTER:
                unpacker = zlib.decompressobj()
                data = unpacker.decompress(data, size + 8)  # room for checksums behind it
                if not unpacker.eof:
                    raise Damaged(f"a chunk unpacks to more than its {size:,} bytes, or is cut off")
            elif step == _SHUFFLE:
                data = _unshuffled(data, kind.itemsize)
            else:
                data = _checked(data)
        if len(data) != size:
            raise Damaged(f"a chunk has {len(data):,} bytes, not {size:,}")
        return np.frombuffer(data, kind)


def _unshuffled(data: bytes, width: int) -> bytes:
    """Bytes that stand grouped by their place in each number, in the numbers' order again."""
    whole = len(data) - len(data) % width
    planes = np.frombuffer(data, np.uint8, whole).reshape(width, -1)
    return planes.T.tobytes() + data[whole:]


def _checked(data: bytes) -> bytes:
    """``data`` without the checksum at its end, which has to be right."""
    from pyfive import btree

    tree: Any = btree.BTreeV1RawDataChunks
    tree._verify_fletcher32(data)
    return data[:-4]
