"""Other error-bounded compressors, each given the treatment that suits it best.

All of them get what keeps a pointwise relative bound: signed logarithms, for which the bound is one number.
Each is tried on every sensible arrangement of the channels, in single and double precision, with each of its
predictors, and the smallest result whose every value is within the bound counts. What is no finite number
takes the value before it, and a packed bit says so.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Arrays = Sequence[NDArray[Any]]
#: In the order of the benchmark's columns; the last one is always there.
NAMES = ("zfp", "SZ3", "Blosc2", "quantise + zstd")
_MODULES = {"zfp": "zfpy", "SZ3": "pysz", "Blosc2": "blosc2"}


@dataclass(frozen=True)
class Packed:
    """bytes : of the values. unpack : back to the values (N, C). how : which treatment it was."""

    size: int
    unpack: Callable[[], FloatArray]
    how: str


def missing() -> list[str]:
    """The compressors that are not installed."""
    return [name for name, module in _MODULES.items() if _module(module) is None]


def _module(name: str) -> ModuleType | None:
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def smallest(
    name: str, value: FloatArray, shape: tuple[int, ...], tolerance: float, floor: FloatArray
) -> Packed:
    """``value`` (N, C), arranged as ``shape``, by the compressor ``name``."""
    y = _filled(np.copysign(np.log1p(np.abs(value) / floor), value))
    bound = float(np.log1p(tolerance)) * (1 - 1e-6)
    flags = zstandard.ZstdCompressor(level=19).compress(np.packbits(~np.isfinite(value)).tobytes())
    work = {"zfp": _zfp, "SZ3": _sz3, "Blosc2": _blosc2, "quantise + zstd": _zstd}[name]
    best: Packed | None = None
    for arrangement, split, join in _arrangements(shape, y.shape[1]):
        for size, unpack, how in work(split(y), bound):
            if best is not None and size + len(flags) >= best.size:
                continue
            if float(np.abs(join(unpack()) - y).max()) <= bound * (1 + 1e-9):

                def whole(unpack: Callable[[], Arrays] = unpack, join: Any = join) -> FloatArray:
                    found = join(unpack()).astype(np.float64)
                    return np.copysign(np.expm1(np.abs(found)) * floor, found)

                best = Packed(size + len(flags), whole, f"{arrangement}, {how}")
    assert best is not None
    return best


def _filled(y: FloatArray) -> FloatArray:
    last = np.maximum.accumulate(np.where(np.isfinite(y), np.arange(len(y))[:, None], 0), axis=0)
    found = np.take_along_axis(y, last, axis=0)
    return np.where(np.isfinite(found), found, 0.0)


def _arrangements(
    shape: tuple[int, ...], channels: int
) -> Iterator[tuple[str, Callable[[FloatArray], Arrays], Callable[[Arrays], FloatArray]]]:
    def each(y: FloatArray) -> Arrays:
        return [np.ascontiguousarray(column.reshape(shape)) for column in y.T]

    def first(y: FloatArray) -> Arrays:
        return [np.ascontiguousarray(y.T).reshape(channels, *shape)]

    def last(y: FloatArray) -> Arrays:
        return [np.ascontiguousarray(y).reshape(*shape, channels)]

    yield "channel by channel", each, lambda parts: np.stack([part.reshape(-1) for part in parts], axis=1)
    if channels > 1 and len(shape) < 4:  # four dimensions are all that some of them take
        yield "channels first", first, lambda parts: parts[0].reshape(channels, -1).T
        yield "channels last", last, lambda parts: parts[0].reshape(-1, channels)


_Trial = tuple[int, Callable[[], Arrays], str]


def _zfp(parts: Arrays, bound: float) -> Iterator[_Trial]:
    zfpy = importlib.import_module("zfpy")
    for kind in (np.float32, np.float64):
        # Its errors are often far below its tolerance: the largest that keeps the bound is looked for.
        for factor in 2.0 ** np.arange(5.0, -3.0, -0.5):
            found = [zfpy.compress_numpy(p.astype(kind), tolerance=bound * factor) for p in parts]
            unpack = lambda found=found: [zfpy.decompress_numpy(f) for f in found]  # noqa: E731
            yield sum(map(len, found)), unpack, f"{kind.__name__}, tolerance {factor:g} times the bound"


def _sz3(parts: Arrays, bound: float) -> Iterator[_Trial]:
    pysz = importlib.import_module("pysz")
    for kind in (np.float32, np.float64):
        for predictor in ("INTERP_LORENZO", "INTERP", "LORENZO_REG"):
            found: list[tuple[Any, tuple[int, ...]]] = []
            for part in parts:
                config = pysz.szConfig(part.shape)
                config.cmprAlgo = getattr(pysz.szAlgorithm, predictor)
                config.errorBoundMode = pysz.szErrorBoundMode.ABS
                config.absErrorBound = bound - (1e-6 * float(np.abs(part).max()) if kind is np.float32 else 0)
                if config.absErrorBound > 0:
                    found.append((pysz.sz.compress(part.astype(kind), config)[0], part.shape))
            if len(found) == len(parts):
                unpack = lambda found=found, kind=kind: [  # noqa: E731
                    pysz.sz.decompress(data, kind, shape)[0] for data, shape in found
                ]
                yield sum(len(data) for data, _ in found), unpack, f"{kind.__name__}, {predictor}"


def _blosc2(parts: Arrays, bound: float) -> Iterator[_Trial]:
    blosc2 = importlib.import_module("blosc2")
    for axis in (None, -1, -2):
        for name in ("SHUFFLE", "BITSHUFFLE", "NOFILTER"):
            found: list[tuple[bytes, Any, tuple[int, ...]]] = []
            for part in parts:
                bins = np.rint(part / (2 * bound)).astype(np.int64)
                bins = bins if axis is None else np.diff(bins, axis=axis, prepend=0)
                bins = _narrow(bins)
                data = blosc2.compress2(
                    bins, codec=blosc2.Codec.ZSTD, clevel=9, filters=[blosc2.Filter[name]], nthreads=1,
                    typesize=bins.dtype.itemsize,
                )  # fmt: skip
                found.append((data, bins.dtype, part.shape))
            unpack = _unbinned(found, blosc2.decompress2, axis, bound)
            yield sum(len(f[0]) for f in found), unpack, name.lower()


def _zstd(parts: Arrays, bound: float) -> Iterator[_Trial]:
    found: list[tuple[bytes, Any, tuple[int, ...]]] = []
    for part in parts:
        bins = _narrow(np.rint(part / (2 * bound)).astype(np.int64))
        found.append((zstandard.ZstdCompressor(level=19).compress(bins.tobytes()), bins.dtype, part.shape))
    unpack = _unbinned(found, zstandard.ZstdDecompressor().decompress, None, bound)
    yield sum(len(f[0]) for f in found), unpack, "level 19"


def _unbinned(
    found: list[tuple[bytes, Any, tuple[int, ...]]], inflate: Any, axis: int | None, bound: float
) -> Callable[[], Arrays]:
    def unpack() -> Arrays:
        parts: list[FloatArray] = []
        for data, kind, shape in found:
            bins = np.frombuffer(inflate(data), kind).reshape(shape)
            bins = bins if axis is None else np.cumsum(bins, axis=axis, dtype=np.int64)
            parts.append(bins * (2 * bound))
        return parts

    return unpack


def _narrow(bins: NDArray[np.int64]) -> NDArray[Any]:
    low, high = int(bins.min()), int(bins.max())
    for kind in (np.int8, np.int16, np.int32):
        if np.iinfo(kind).min <= low and high <= np.iinfo(kind).max:
            return bins.astype(kind)
    return bins
