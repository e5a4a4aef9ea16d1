"""A tile: a box of a table's nodes, all channels, predicted stage by stage and coded without other tiles.

Numbers here are in steps: twice the error that is allowed. What is coded of a node is the whole number that
brings its prediction next to its value, so that the error is half a step at most.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.compression import entropy
from fitter.compression.archive import pack_parts, unpack_parts
from fitter.compression.dither import dither, kinds
from fitter.compression.rules import NARROWEST, USUAL, Rules, Seen, classes, next_error
from fitter.compression.stages import Numbers, Stage, neighbours, stages, woven

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

#: Numbers below this are worked on in single precision, which is right to 1/250 of a step there.
SINGLE = float(1 << 15)
#: Dithers that are tried until the mean error of each channel is below _MEAN (steps; the bound is half of
#: one), and the fewest numbers for which a mean says anything.
_SEEDS, _MEAN, _FEW = 6, 0.006, 2000

_FAULTS = {
    1: "the rules end early", 2: "a rule that is as before, where none was",
    3: "a number of a class that has no distribution", 4: "a number that no encoder wrote",
    5: "the bits end early", 6: "its tokens end elsewhere than its words",
}  # fmt: skip

#: Gives a channel's predictions, expected widths and corrections, (*nodes) each.
_Visit = Callable[[Stage, int, Seen], tuple[Numbers, Numbers, Numbers]]


def encode(steps: FloatArray) -> tuple[bytes, Numbers]:
    """The tile (C, *shape) of numbers in steps, NaN where there is nothing to code, and what it decodes to.

    Where a correction would be too large to code there is none: the caller compares. Errors are as good as
    independent, so that the mean of a few thousand may be felt; then another dither is tried.
    """
    good = np.isfinite(steps)
    filled = _filled(steps)
    count = np.maximum(good.reshape(len(good), -1).sum(axis=1), 1)
    best: tuple[float, bytes] | None = None
    for seed in range(_SEEDS):
        data, decoded = _encode(filled, good, seed)
        error = np.where(good, decoded - filled, 0.0).reshape(len(good), -1).sum(axis=1) / count
        mean = float(np.abs(error).max(initial=0.0))
        if best is None or mean < best[0]:
            best = mean, data
        if mean <= _MEAN or good.size < _FEW:
            break
    assert best is not None
    # What the decoder makes of it counts, not what the encoder thinks that it will.
    return best[1], decode(best[1], good.shape, None if good.all() else good)


def _encode(filled: FloatArray, good: BoolArray, seed: int) -> tuple[bytes, FloatArray]:
    """The same of numbers without gaps."""
    rules = Rules()
    coder = entropy.Encoder()
    rest: list[IntArray] = []
    bits: list[IntArray] = []

    def visit(stage: Stage, k: int, seen: Seen) -> tuple[Numbers, Numbers, Numbers]:
        target, here = filled[stage.target][k], good[stage.target][k]
        weights, widths = rules.choose((stage.axis, k), seen, target, here)
        predicted, width = seen.predicted(weights), seen.width(widths)
        added = dither(predicted.shape, seed, stage.number, k, predicted.dtype)
        number = np.rint(target - predicted + added)
        number[np.abs(number) > entropy.LARGEST] = 0.0
        correction = np.where(here, number.astype(predicted.dtype) - added, 0)
        sided = np.where(added < 0, -number, number)
        token, count, low = entropy.tokens(sided[here].astype(np.int64))
        coder.write(token, kinds(classes(width), added)[here])
        bits.append(count[count > 0])
        rest.append(low[count > 0])
        return predicted, width, correction.astype(predicted.dtype)

    first = filled[(slice(None), *(0 for _ in range(filled.ndim - 1)))]
    number = number_type(float(np.abs(filled).max(initial=0.0)))
    decoded = _walk(first.astype(number), filled.shape, visit)
    distributions, words = coder.finish()
    none = np.zeros(0, np.int64)
    parts = [
        number.char.upper().encode() + bytes([seed]) + first.astype(number.newbyteorder("<")).tobytes(),
        bytes(rules.written),
        distributions.tobytes(),
        entropy.pack_bits(np.concatenate([*rest, none]), np.concatenate([*bits, none])).tobytes(),
        words.astype("<u4").tobytes(),
    ]
    return pack_parts(parts), decoded.astype(np.float64)


def decode(data: bytes, shape: tuple[int, ...], good: BoolArray | None) -> Numbers:
    """The numbers (C, *shape) in steps that :func:`encode` coded where ``good``, None for everywhere, in the
    tile's own type.

    Raises ValueError where the bytes don't make up a tile. Their first one says in which type it is worked,
    in lower case where it is one of version 2.
    """
    from fitter.kernels import tiles

    first, written, table, packed, words = unpack_parts(data, 5)
    kind = first[:1].lower().decode("latin-1")
    second = first[:1] == kind.encode("latin-1")
    if kind not in ("f", "d"):
        raise ValueError("it is worked in no known type")
    stated = np.dtype("<f8" if second else f"<{kind}")
    if len(first) != 2 + stated.itemsize * shape[0] or len(table) % 4:
        raise ValueError("its parts have other lengths than the tile's")
    with np.errstate(over="ignore"):  # of numbers that no encoder wrote
        start = np.frombuffer(first[2:], stated).astype(kind)
    which, ends, low = entropy.tables(np.frombuffer(table, np.uint8).reshape(-1, 4))
    found = np.empty(shape, start.dtype)
    fault = tiles.decoded(
        start, np.array(shape[1:], np.int64), first[1], np.frombuffer(written, np.uint8).astype(np.int64),
        np.frombuffer(words, "<u4").astype(np.uint32), not second, which, ends, low,
        np.frombuffer(packed + bytes(8), np.uint8), np.zeros(0, bool) if good is None else good.reshape(-1),
        USUAL, NARROWEST, found.reshape(-1),
    )  # fmt: skip
    if fault:
        raise ValueError(_FAULTS[fault])
    return found


def number_type(largest: float) -> np.dtype[Any]:
    """The type that a tile of numbers up to ``largest`` is worked in: single precision where that will do."""
    return np.dtype(np.float32 if largest < SINGLE else np.float64)


def _walk(first: Numbers, shape: tuple[int, ...], visit: _Visit) -> Numbers:
    """All nodes of a tile (C, *shape), from the numbers (C,) of its first node."""
    known = first.reshape(-1, *(1 for _ in shape[1:]))
    error = np.zeros_like(known)
    for stage in stages(shape[1:]):
        near = neighbours(stage, known, error)
        new, wrong = np.empty_like(near.slope), np.empty_like(near.slope)
        corrections: list[Numbers] = []
        for k in range(shape[0]):
            predicted, width, correction = visit(stage, k, Seen.of(near, k, corrections))
            np.add(predicted, correction, out=new[k])
            wrong[k] = next_error(correction, width)
            corrections.append(correction)
        known, error = woven(stage, known, new), woven(stage, error, wrong)
    return known


def _filled(steps: FloatArray) -> FloatArray:
    """The same with NaN replaced by the number before it in its channel, 0 where there is none."""
    flat = steps.reshape(len(steps), -1)
    last = np.maximum.accumulate(np.where(np.isfinite(flat), np.arange(flat.shape[1]), 0), axis=1)
    found = np.take_along_axis(flat, last, axis=1)
    return np.where(np.isfinite(found), found, 0.0).reshape(steps.shape)


@dataclass(frozen=True)
class Box:
    """A tile's place: rows [start, stop) of each axis."""

    start: tuple[int, ...]
    stop: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(b - a for a, b in zip(self.start, self.stop, strict=True))

    @property
    def slices(self) -> tuple[slice, ...]:
        return tuple(slice(a, b) for a, b in zip(self.start, self.stop, strict=True))
