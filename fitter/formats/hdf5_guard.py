"""pyfive with limits: what damaged sizes and addresses could make it allocate or follow without end.

It reads through a handle that lends it only as many bytes as a file's structure can have: circles end. And it
makes room for an attribute's values only when the file has them.
"""

from __future__ import annotations

from functools import cache
from typing import Any

#: Bytes of structure pyfive may read: this, and a share of the file's. One costs it up to twelve of memory.
_STRUCTURE, _SHARE = 1 << 19, 4
#: Cost of a read beside its bytes, so that reads of nothing end too.
_READ = 16
#: Bytes that one value of variable length, and one reference, takes in an attribute.
_VARIABLE, _REFERENCE = 16, 8


class Lent:
    """The file as pyfive reads it. Raises ValueError when it has read more than a structure can have.

    place : the byte at which it last read something.
    """

    closed = False

    def __init__(self, data: memoryview) -> None:
        self._data, self._at = data, 0
        self.place = 0
        self._left = _STRUCTURE + len(data) // _SHARE

    def seek(self, offset: int, whence: int = 0) -> int:
        self._at = max(offset + (0, self._at, len(self._data))[whence], 0)
        return self._at

    def tell(self) -> int:
        return self._at

    def read(self, size: int = -1) -> bytes:
        end = len(self._data) if size < 0 else min(self._at + size, len(self._data))
        self._left -= max(end - self._at, 0) + _READ
        if self._left < 0:
            raise ValueError("the file's structure leads in a circle")
        piece = bytes(self._data[self._at : end])
        if piece:
            self.place = self._at
        self._at += len(piece)
        return piece


def stated_end(data: memoryview) -> int:
    """Where the superblock says that the file ends, 0 where it doesn't (HDF5 File Format, II.A)."""
    at = {0: 40, 1: 44, 2: 28, 3: 28}.get(data[8] if len(data) > 8 else -1)
    return 0 if at is None else int.from_bytes(bytes(data[at : at + 8]), "little")


def guarded(lent: Lent) -> Any:
    """The HDF5 file of these bytes, a pyfive.File whose text is decoded. Raises what pyfive raises."""
    return _guarded_file()(lent, decode_strings=True)


@cache
def _guarded_file() -> Any:
    """A pyfive.File that looks at an attribute's size first. pyfive loads with the first such file."""
    import pyfive
    from pyfive import dataobjects, p5t

    file_class: Any = pyfive.File
    objects_class: Any = dataobjects.DataObjects

    class Objects(objects_class):
        def _attr_value(self, ptype: Any, buf: Any, count: int, offset: int) -> Any:
            each = _REFERENCE if isinstance(ptype, p5t.P5ReferenceType) else _VARIABLE
            varies = isinstance(ptype, p5t.P5SequenceType | p5t.P5ReferenceType | p5t.P5VlenStringType)
            if varies and not 0 <= count <= (len(buf or b"") - offset) // each:
                raise ValueError(f"an attribute claims {count:,} values")
            return super()._attr_value(ptype, buf, count, offset)

    class File(file_class):
        def _get_dataobjects(self, obj_addr: int) -> Any:
            known = self._dataobjects_cache
            if obj_addr not in known:
                known[obj_addr] = Objects(
                    self._fh, obj_addr, decode_strings=self.decode_strings, global_heaps=self._global_heaps
                )
            return known[obj_addr]

    return File
