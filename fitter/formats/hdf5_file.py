"""What stands in an HDF5 file: its groups, their datasets and attributes, through pyfive.

pyfive is Python all through, so damage can't end the process; what it could do to memory and time is limited
in :mod:`fitter.formats.hdf5_guard`.
"""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from fitter.errors import TableError
from fitter.formats.hdf5_guard import Lent, guarded, stated_end
from fitter.formats.hdf5_storage import Stored
from fitter.formats.source import Source

_DEEPEST, _MOST = 16, 20_000
#: Attributes that hold the file's structure, not what was measured.
STRUCTURE = frozenset({
    "CLASS", "NAME", "REFERENCE_LIST", "DIMENSION_LIST", "DIMENSION_LABELS", "_Netcdf4Dimid",
    "_Netcdf4Coordinates", "_nc3_strict", "_NCProperties", "NX_class", "signal", "axes",
})  # fmt: skip
_NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"


@dataclass(frozen=True)
class Dataset:
    """One dataset. ``path`` is its own from the root, ``address`` where its header is.

    scales : for each axis the path of the dimension scale attached to it, None where there is none.
    kind : "number", "text", "record" (named fields) or "other", which is not read.
    """

    path: str
    address: int
    shape: tuple[int, ...]
    attributes: Mapping[str, Any]
    scales: tuple[str | None, ...]
    kind: str
    stored: Stored
    heaps: Any

    @property
    def name(self) -> str:
        """The last part of its path."""
        return self.path.rpartition("/")[2]

    @property
    def is_scale(self) -> bool:
        """Whether it is a coordinate of a dimension."""
        return self.attributes.get("CLASS") == "DIMENSION_SCALE"

    @property
    def is_bare_dimension(self) -> bool:
        """Whether it stands for a dimension's size only."""
        return self.is_scale and str(self.attributes.get("NAME", "")).startswith(_NO_VARIABLE)

    def read(self) -> NDArray[Any]:
        """Its numbers as stored, or its text as an object array of str. Raises TableError."""
        with refusing(self.stored.source, self.path.lstrip("/")):
            return self.texts() if self.kind == "text" else self.stored.array()

    def texts(self) -> NDArray[Any]:
        """Its text as an object array of str."""
        kind = np.dtype(self.stored.known.dtype)
        if kind.kind == "S":
            words = [bytes(word) for word in self.stored.array().reshape(-1)]
        else:
            ids = self.stored.raw(np.dtype([("size", "<u4"), ("at", "<u8"), ("number", "<u4")])).reshape(-1)
            words = [self.heaps.word(int(one["at"]), int(one["number"]), int(one["size"])) for one in ids]
        decoded = [word.decode("utf-8", "replace").strip("\0 ") for word in words]
        return np.asarray(decoded, object).reshape(self.shape)


@dataclass(frozen=True)
class Group:
    """A group: its path ("" for the root), its attributes, its datasets in the file's order.

    unread : name -> reason, of the datasets whose type or storage is not read.
    """

    path: str
    attributes: Mapping[str, Any]
    datasets: tuple[Dataset, ...]
    unread: Mapping[str, str]


@dataclass
class _Heaps:
    """Words of any length, which stand in collections apart from the dataset."""

    handle: Any
    known: dict[int, Any]

    def word(self, at: int, number: int, size: int) -> bytes:
        from pyfive.misc_low_level import GlobalHeap

        if at == 0 or number == 0:
            return b""
        if at not in self.known:
            self.known[at] = GlobalHeap(self.handle, at)
        return cast("bytes", self.known[at].objects[number])[:size]


def groups_of(source: Source) -> list[Group]:
    """Every group of the file, parents first. Raises TableError for damage and for what is not read."""
    lent = Lent(source.buffer)
    with refusing(source, lent=lent):
        file = guarded(lent)
        found = list(_walk(file))
        heaps = _Heaps(file._fh, {})
        places = {address: path for _, links, _ in reversed(found) for path, address, _ in reversed(links)}
        ids = {
            int(one.attrs["_Netcdf4Dimid"]): path
            for _, links, _ in found for path, _, one in links if "_Netcdf4Dimid" in one.attrs
        }  # fmt: skip
        groups: list[Group] = []
        for (path, attributes), links, unknown in found:
            datasets = [
                Dataset(
                    where, address, tuple(int(n) for n in one.shape), _plain_all(one.attrs),
                    _scales(where, one, places, ids), _kind(one), Stored(source, one.id, file.userblock_size),
                    heaps,
                )
                for where, address, one in links
            ]  # fmt: skip
            groups.append(Group(path, attributes, tuple(datasets), unknown))
        return groups


@contextmanager
def refusing(source: Source, column: str | None = None, lent: Lent | None = None) -> Generator[None]:
    """Turn what pyfive raises at damaged bytes, and at what it does not read, into a TableError.

    column : what is being read; lent : what it is read through, which knows the byte.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of attributes and types it does not know
            yield
    except TableError:
        raise
    except Exception as error:
        if not isinstance(error, _EXPECTED) and type(error).__module__.partition(".")[0] != "pyfive":
            raise
        reason = " ".join(str(error).split())[:120]
        offset = None if lent is None else lent.place
        if lent is not None and stated_end(source.buffer) > source.size:
            offset, reason = source.size, f"it ends before byte {stated_end(source.buffer):,}, as it states"
        if isinstance(error, RuntimeError | AssertionError) and not isinstance(error, RecursionError):
            raise unread(source, reason, column, offset) from error
        raise source.error(
            f"the HDF5 file can't be read{': ' if reason else ''}{reason}", "table-truncated", column=column,
            offset=offset, cause="the file is cut off or damaged", remedy="fetch the file again",
        ) from error  # fmt: skip


def unread(source: Source, reason: str, column: str | None, offset: int | None = None) -> TableError:
    """A TableError for a type or a form of storage that is not read."""
    return source.error(
        f"the HDF5 file has what is not read{': ' if reason else ''}{reason[:120]}", "table-hdf5-feature",
        column=column, offset=offset,
        cause="links to other files, a rare type or the newest form of storage (libver='latest'), or damage",
        remedy="write it anew: h5repack -f GZIP=4 in.h5 out.h5, or nccopy -k classic in.nc out.nc",
    )  # fmt: skip


_EXPECTED = (
    ArithmeticError, AssertionError, AttributeError, LookupError, MemoryError, OSError, RuntimeError,
    TypeError, ValueError, struct.error, zlib.error,
)  # fmt: skip

_Links = list[tuple[str, int, Any]]


def _walk(file: Any) -> Iterator[tuple[tuple[str, dict[str, Any]], _Links, dict[str, str]]]:
    """((path, attributes), datasets, unread ones) of every group, parents first."""
    import pyfive

    seen: set[int] = {file._dataobjects.offset}
    waiting: list[tuple[str, Any, int]] = [("", file, 0)]
    count = 0
    while waiting:
        path, group, depth = waiting.pop(0)
        links: _Links = []
        unknown: dict[str, str] = {}
        for name, address in group._links.items():
            count += 1
            if count > _MOST or depth > _DEEPEST:
                raise ValueError("it has too many groups and datasets")
            if not isinstance(address, int):
                continue  # a soft link: what it names stands elsewhere in the file
            try:
                one: Any = group.get_lazy_view(name)
            except RecursionError:
                raise
            except (RuntimeError, AssertionError, TypeError) as error:  # TypeError: one without a shape
                unknown[name] = str(error)
                continue
            if isinstance(one, pyfive.Dataset):
                links.append((f"{path}/{name}", address, one))
            elif isinstance(one, pyfive.Group) and address not in seen:
                seen.add(address)
                waiting.append((f"{path}/{name}", one, depth + 1))
        yield (path, _plain_all(group.attrs)), links, unknown


def _kind(one: Any) -> str:
    from pyfive.p5t import P5CompoundType, P5OpaqueType, P5VlenStringType

    stored = one.id.get_type()
    if isinstance(stored, P5VlenStringType):
        return "text"
    if isinstance(stored, P5OpaqueType):
        return "other"
    kind = np.dtype(stored.dtype).kind
    if isinstance(stored, P5CompoundType) and kind == "V" and stored.is_atomic:
        return "record"
    return {"i": "number", "u": "number", "f": "number", "S": "text"}.get(kind, "other")


def _scales(path: str, one: Any, places: Mapping[int, str], ids: Mapping[int, str]) -> tuple[str | None, ...]:
    """For each axis the path of its dimension scale, or None."""
    rank = len(one.shape)
    listed = one.attrs.get("DIMENSION_LIST")
    if listed is not None and len(listed) == rank:
        first = [next(iter(axis), None) if axis is not None else None for axis in listed]
        return tuple(None if ref is None else places.get(ref.address_of_reference) for ref in first)
    if "_Netcdf4Coordinates" in one.attrs and rank > 1:
        numbers = np.asarray(one.attrs["_Netcdf4Coordinates"]).reshape(-1).tolist()
        if len(numbers) == rank:
            return tuple(ids.get(number) for number in numbers)
    if one.attrs.get("CLASS") in (b"DIMENSION_SCALE", "DIMENSION_SCALE") and rank == 1:
        return (path,)
    return (None,) * rank


def _plain_all(attributes: Mapping[str, Any]) -> dict[str, Any]:
    return {key: _plain(value) for key, value in attributes.items()}


def _plain(value: Any) -> Any:
    """An attribute as text, a number or a list of these."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace").rstrip("\0")
    if isinstance(value, np.ndarray) and value.dtype.kind in "SO":
        words = [_plain(word) for word in value.reshape(-1).tolist()]
        return words[0] if len(words) == 1 else words
    return value
