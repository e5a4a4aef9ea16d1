"""A table's values as tiles, and the tiles as values again, within the bound.

A tile's block holds the coded tile, which of its nodes are finite and what the others are, and what the
table's values differ by from the decoded ones where the bound asks for it: whole steps, or the value itself.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.compression import scale, tile
from fitter.compression.archive import pack_array, pack_parts, unpack_array, unpack_parts
from fitter.compression.arrangement import TILE, boxes
from fitter.compression.container import Block, damaged
from fitter.compression.folds import Folds, fold
from fitter.compression.tile import Box

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

#: Corrections of more steps than this are not worth the name.
_MOST_STEPS = 1 << 40


@dataclass(frozen=True)
class Scale:
    """tolerance, floor (C,) : of the guarantee, 0 for lossless. step : of the signed logarithm, see scale."""

    tolerance: float
    floor: FloatArray
    step: float

    @property
    def exact(self) -> bool:
        return self.step == 0

    def steps(self, value: FloatArray) -> FloatArray:
        """(N, C) of values (N, C), as rounding takes them to have values without a mean error."""
        if self.exact:
            return value
        y = scale.logarithms(value, self.floor)
        return (y - scale.lift(y, self.step)) / self.step

    def values(self, steps: NDArray[np.floating[Any]]) -> FloatArray:
        """(N, C) what steps (N, C) are decoded to."""
        return np.asarray(steps, np.float64) if self.exact else scale.values(steps.T, self.step, self.floor)


@dataclass(frozen=True)
class Coded:
    """blocks : of the tiles. decoded : (N, C) what they come back as."""

    blocks: list[Block]
    scale: Scale
    folds: Folds
    decoded: FloatArray


def encode(
    value: FloatArray, shape: tuple[int, ...], tolerance: float, floor: FloatArray, most: int = TILE
) -> Coded:
    """Values (N, C), arranged as ``shape``, in tiles of about ``most`` nodes."""
    if tolerance < scale.SMALLEST_TOLERANCE:
        step = 0.0
    else:
        y = np.abs(scale.logarithms(value, floor))
        step = scale.step_of(tolerance, float(y.max(where=np.isfinite(y), initial=0.0)))
    used = Scale(tolerance if step else 0.0, floor, step)
    cube, folds = _folded(value, shape, used)
    if folds.mirrored and step:
        used = Scale(tolerance, floor, step * (1.0 - scale.FOLDED_GUARD))
        cube, folds = _folded(value, shape, used)
    places = boxes(folds.shape, most)
    coded = [_encode_box(cube[(slice(None), *box.slices)], used.exact) for box in places]
    channels = value.shape[1]
    stored = np.empty((*folds.shape, channels))
    for box, (_, back) in zip(places, coded, strict=True):
        stored[box.slices] = np.moveaxis(back, 0, -1)
    steps = folds.spread(stored).reshape(-1, channels)
    decoded, fixed = _fixed(value, steps, used)
    owner = np.zeros(folds.shape, np.intp)
    for k, box in enumerate(places):
        owner[box.slices] = k
    blocks = [
        Block(
            f"values {k}",
            pack_parts([*parts, *_fixes(fixed, owner, folds, channels, k)]),
            {"start": list(box.start), "stop": list(box.stop)},
        )
        for k, (box, (parts, _)) in enumerate(zip(places, coded, strict=True))
    ]
    return Coded(blocks, used, folds, decoded)


def _folded(value: FloatArray, shape: tuple[int, ...], used: Scale) -> tuple[FloatArray, Folds]:
    steps = np.ascontiguousarray(used.steps(value).T).reshape(value.shape[1], *shape)
    return fold(steps, exact=used.exact)


def _encode_box(steps: FloatArray, exact: bool) -> tuple[list[bytes], NDArray[np.floating[Any]]]:
    """The parts of a tile (C, *shape), and what it decodes to."""
    if exact:
        return [pack_array(steps), b"", b""], steps
    good = np.isfinite(steps)
    coded, back = tile.encode(steps)
    if good.all():
        return [coded, b"", b""], back
    others = steps[~good].astype("<f8").tobytes()
    return [coded, np.packbits(good).tobytes(), others], np.where(good, back, steps)


@dataclass(frozen=True)
class _Fixed:
    """Elements, sorted positions in the flat (N C,) table, that need whole steps more, or their own value."""

    stepped: IntArray
    steps: IntArray
    raw: IntArray
    value: FloatArray


def _fixed(value: FloatArray, steps: FloatArray, used: Scale) -> tuple[FloatArray, _Fixed]:
    """(N, C) what is read back, each within the bound, and what had to be done for that."""
    decoded = used.values(steps)
    none = np.zeros(0, np.int64)
    if used.exact:
        return decoded, _Fixed(none, none, none, np.zeros(0))
    with np.errstate(invalid="ignore"):
        wrong = ~(np.abs(scale.error_in_bounds(value, decoded, used.floor, used.tolerance)) <= 1.0)
    index = np.flatnonzero(wrong)
    channel = index % value.shape[1]
    target, floor = value.reshape(-1)[index], used.floor[channel]
    start = steps.reshape(-1)[index]
    wanted = scale.logarithms(target[:, None], floor[:, None])[:, 0] / used.step
    away = np.rint(wanted - start)
    away = np.where(np.abs(away) < _MOST_STEPS, away, 0.0)
    # One at a time, each with the floor of its own channel.
    moved = scale.values((start + away)[:, None], used.step, floor).T
    error = scale.error_in_bounds(target[:, None], moved, floor[:, None], used.tolerance)
    good = np.abs(error[:, 0]) <= 1.0
    flat = decoded.reshape(-1)
    flat[index] = np.where(good, moved[:, 0], target)
    return flat.reshape(decoded.shape), _Fixed(
        index[good], away[good].astype(np.int64), index[~good], target[~good]
    )


def _fixes(fixed: _Fixed, owner: NDArray[np.intp], folds: Folds, channels: int, k: int) -> list[bytes]:
    """The parts of tile ``k`` about what is fixed in it."""
    found: list[bytes] = []
    for index, content in ((fixed.stepped, fixed.steps), (fixed.raw, fixed.value)):
        here = owner[folds.stored(index // channels)] == k if len(index) else np.zeros(0, bool)
        places = index[here]
        found.append(_sparse(np.diff(places, prepend=0)))
        found.append(_sparse(content[here]))
    return found


def _sparse(numbers: NDArray[Any]) -> bytes:
    return pack_array(numbers) if len(numbers) else b""


def _unsparse(data: bytes, kind: str) -> NDArray[Any]:
    if not data:
        return np.zeros(0, kind)
    return unpack_array(data, kind)


@dataclass(frozen=True)
class Tile:
    """A decoded tile: ``value`` (*shape, C) in 1/sr; the elements ``fixed`` (sorted positions in the flat
    (N C,) table) are ``replaced`` instead."""

    box: Box
    value: FloatArray
    fixed: IntArray
    replaced: FloatArray

    @property
    def nbytes(self) -> int:
        return self.value.nbytes + self.replaced.nbytes + self.fixed.nbytes


def decode(block: Block, used: Scale, folds: Folds) -> Tile:
    """The tile of a block. Raises TableError that names it where its content makes no sense."""
    box = place(block, folds)
    try:
        return _decode(block, box, used, folds)
    except ValueError as error:  # and nothing else: a kernel that can't be compiled is no damage
        raise damaged(f"block {block.name!r} can't be unpacked ({error})", None, block.name) from error


def place(block: Block, folds: Folds) -> Box:
    """Where a block's tile is among what is stored. Raises TableError where that is nowhere."""
    ends = block.about.get("start"), block.about.get("stop")
    start = stop = np.zeros(0, np.int64)
    with contextlib.suppress(TypeError, ValueError, OverflowError):  # what is no number is no place either
        start, stop = (np.array(end, np.int64) for end in ends)
    fits = start.shape == stop.shape == (len(folds.shape),)
    if not (fits and bool(((start >= 0) & (start < stop) & (stop <= folds.shape)).all())):
        message = f"block {block.name!r} is from {ends[0]} to {ends[1]}, which is no tile"
        raise damaged(message, None, block.name)
    return Box(tuple(start.tolist()), tuple(stop.tolist()))


def _decode(block: Block, box: Box, used: Scale, folds: Folds) -> Tile:
    channels = len(used.floor)
    shape = (channels, *box.shape)
    coded, bits, others, *fixes = unpack_parts(block.data, 7)
    good = None
    if bits:
        flags = np.unpackbits(np.frombuffer(bits, np.uint8), count=int(np.prod(shape)))
        good = flags.astype(bool).reshape(shape)
    steps = unpack_array(coded, "<f8", shape) if used.exact else tile.decode(coded, shape, good)
    value = np.ascontiguousarray(used.values(steps.reshape(channels, -1).T)).reshape(*box.shape, channels)
    if good is not None:
        channel, node = np.divmod(np.flatnonzero(~good), good.size // channels)
        kept = np.frombuffer(others, "<f8")
        if len(kept) != len(node):
            raise ValueError(f"{len(kept)} numbers for {len(node)} nodes")
        value.reshape(-1)[node * channels + channel] = kept
    stepped, moves, raw, content = (
        _unsparse(data, kind) for data, kind in zip(fixes, ("<i8", "<i8", "<i8", "<f8"), strict=True)
    )
    stepped, raw = np.cumsum(stepped), np.cumsum(raw)
    if len(stepped) != len(moves) or len(raw) != len(content):
        raise ValueError("its fixed values are not as many as their places")
    inside = _inside(stepped // channels, box, folds)
    _inside(raw // channels, box, folds)
    if len(stepped):
        channel = stepped % channels
        moved = (steps[(channel, *inside)] + moves)[:, None]
        content = np.concatenate([scale.values(moved, used.step, used.floor[channel])[0], content])
    index = np.concatenate([stepped, raw])
    order = np.argsort(index)
    return Tile(box, value, index[order], content[order])


def _inside(samples: IntArray, box: Box, folds: Folds) -> tuple[NDArray[np.intp], ...]:
    """Rows of a tile, one (n,) for each axis, of the table's samples (n,). Raises ValueError for others'."""
    where = folds.stored(samples)
    for i, start, stop in zip(where, box.start, box.stop, strict=True):
        if ((i < start) | (i >= stop)).any():
            raise ValueError("it fixes values of another tile")
    return tuple(i - start for i, start in zip(where, box.start, strict=True))
