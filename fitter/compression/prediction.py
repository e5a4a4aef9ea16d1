"""Prediction: bins -> what their neighbours don't already say, packed as tightly as their range allows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.compression import container
from fitter.compression.container import Block
from fitter.compression.quantise import differences, local_means, narrowest, spread, sums

IntArray = NDArray[np.int64]

# A byte holds so many digits of each base. A coder that spends at least a bit on each symbol wastes less when
# a symbol is several values.
_DIGITS = {16: 2, 6: 3, 4: 4, 3: 5, 2: 8}
# More values than this outside the digits' range and the list of them costs more than it saves.
_MOST_ESCAPES = 0.01
_TRIAL_LEVEL = 1


def encode(k: int, bins: IntArray, shape: tuple[int, ...]) -> tuple[list[Block], dict[str, Any]]:
    """Blocks of channel ``k`` and how to read them: the smallest of several predictions and packings.

    The bins as they are, differences and deviations from local means along each axis: how smooth and how
    noisy a table is decides, so they are all tried.
    """
    trials: list[tuple[IntArray, IntArray, dict[str, Any]]] = [(bins, bins[:0], {"by": "none", "axis": 0})]
    for axis in range(len(shape)):
        if shape[axis] > 1:
            trials.append((differences(bins, shape, axis), bins[:0], {"by": "difference", "axis": axis}))
            means = local_means(bins, shape, axis)
            side = np.diff(means, prepend=0)
            trials.append((bins - spread(means, shape, axis), side, {"by": "mean", "axis": axis}))
    best: tuple[int, Callable[[int], list[Block]], dict[str, Any]] | None = None
    for residual, side, how in trials:
        for base in [0, *_bases(residual)]:

            def packed(
                level: int, residual: IntArray = residual, side: IntArray = side, base: int = base
            ) -> list[Block]:
                return _pack(k, residual, side, base, level)

            size = sum(len(block.data) for block in packed(_TRIAL_LEVEL))
            if best is None or size < best[0]:
                best = size, packed, {**how, "base": base, "low": _low(residual, base) if base else 0}
    assert best is not None
    return best[1](container.LEVEL), best[2]


def decode(
    k: int, array: Callable[[str], NDArray[Any]], shape: tuple[int, ...], how: dict[str, Any]
) -> IntArray:
    """The bins (N,) of channel ``k``; ``array`` gives a block's content by name."""
    residual = array(f"bins {k}").astype(np.int64)
    if how["base"]:
        base, places = how["base"], base_powers(how["base"])
        residual = (residual[:, None] // places % base).reshape(-1)[: int(np.prod(shape))] + how["low"]
        residual[array(f"escape index {k}")] = array(f"escape value {k}")
    if how["by"] == "difference":
        return sums(residual, shape, how["axis"])
    if how["by"] == "mean":
        means = np.cumsum(array(f"means {k}"), dtype=np.int64)
        return residual + spread(means, shape, how["axis"])
    return residual


def base_powers(base: int) -> IntArray:
    """Place values of the digits in one byte."""
    return base ** np.arange(_DIGITS[base], dtype=np.int64)


def _low(residual: IntArray, base: int) -> int:
    """Smallest of the ``base`` consecutive numbers that hold most of the residual."""
    values, counts = np.unique(residual, return_counts=True)
    total = np.append(0, np.cumsum(counts))
    inside = total[np.searchsorted(values, values + base)] - total[:-1]
    return int(values[np.argmax(inside)])


def _bases(residual: IntArray) -> list[int]:
    """The bases worth trying: few escapes."""
    found: list[int] = []
    for base in _DIGITS:
        low = _low(residual, base)
        escapes = np.count_nonzero((residual < low) | (residual >= low + base))
        if escapes <= _MOST_ESCAPES * residual.size:
            found.append(base)
    return found


def _pack(k: int, residual: IntArray, side: IntArray, base: int, level: int) -> list[Block]:
    blocks: list[Block] = []
    if base:
        low, places = _low(residual, base), base_powers(base)
        digit = residual - low
        escape = np.flatnonzero((digit < 0) | (digit >= base))
        digit[escape] = 0
        padded = np.pad(digit, (0, -digit.size % len(places)))
        packed = (padded.reshape(-1, len(places)) @ places).astype(np.uint8)
        blocks.append(container.pack(f"bins {k}", packed, level))
        blocks.append(container.pack(f"escape index {k}", escape, level))
        blocks.append(container.pack(f"escape value {k}", narrowest(residual[escape]), level))
    else:
        blocks.append(container.pack(f"bins {k}", narrowest(residual), level))
    if side.size:
        blocks.append(container.pack(f"means {k}", narrowest(side), level))
    return blocks
