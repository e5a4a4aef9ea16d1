"""Which samples have a geometry that an earlier one has: exact, and in the time of one sort."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fitter.parts import in_parts

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]
KeyArray = NDArray[np.uint64]
_Key = TypeVar("_Key", np.uint32, np.uint64)

#: Fewer numbers than this one core sorts as fast as several.
_MANY = 1 << 20
#: Halves are looked up by so many values of their lowest bits.
_MARKS = 1 << 20

#: Components are told apart at this step: gonioreflectometers repeat to about 1e-4 rad.
STEP = 1e-6

# A unit vector's components are at most 1 000 001 steps; above lie NaN and the infinities. 3 x 21 bits.
_NAN, _INFINITE, _LEVELS = 1_000_010, 1_000_011, 1 << 21


def repeated(wi: FloatArray, wo: FloatArray) -> BoolArray:
    """(N,) True for every pair of unit vectors ``wi``, ``wo`` (N, 3) that an earlier one is to ``STEP``."""
    found = np.zeros(len(wi), bool)
    mixed = np.empty(len(wi), np.uint64)

    def mix(part: slice) -> None:
        mixed[part] = _mixed(_packed(wi[part]), _packed(wo[part]))

    in_parts(mix, len(mixed))
    several = _several(mixed)
    if not several.size:
        return found

    def look(part: slice) -> None:
        place = np.minimum(np.searchsorted(several, mixed[part]), several.size - 1)
        found[part] = several[place] == mixed[part]

    in_parts(look, len(mixed))
    # Rows that differ may mix to one number: those that do are compared in full.
    rows = np.flatnonzero(found)
    found[:] = False
    first, second = _packed(wi[rows]), _packed(wo[rows])
    order = np.lexsort((second, first))  # stable: the earliest of each kind stays in front
    rows, first, second = rows[order], first[order], second[order]
    same = (first[1:] == first[:-1]) & (second[1:] == second[:-1])
    found[rows[1:][same]] = True
    return found


def _several(mixed: KeyArray) -> KeyArray:
    """The numbers that occur more than once, in order.

    Of many numbers only the upper halves are sorted, by the highest bits' value, so that cores share the
    work; the few numbers that have such a half in common, or may, are sorted whole.
    """
    if len(mixed) < _MANY:
        return _doubled(np.sort(mixed))
    half = (mixed >> np.uint64(32)).astype(np.uint32)
    highest = (half >> np.uint32(30)).astype(np.uint8)
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        parts = list(pool.map(lambda k: _doubled(np.sort(half[highest == k])), range(4)))
    low = np.uint32(_MARKS - 1)
    marked = np.zeros(_MARKS, bool)
    marked[np.concatenate(parts) & low] = True
    common = np.empty(len(half), bool)

    def look(part: slice) -> None:
        common[part] = marked[half[part] & low]

    in_parts(look, len(half))
    return _doubled(np.sort(mixed[common]))


def _doubled(ordered: NDArray[_Key]) -> NDArray[_Key]:
    return ordered[1:][ordered[1:] == ordered[:-1]]


def _mixed(first: KeyArray, second: KeyArray) -> KeyArray:
    """One number for both, nearly always another for another pair: multiples of large odd numbers."""
    return first * np.uint64(0x9E3779B97F4A7C15) + second * np.uint64(0xC2B2AE3D27D4EB4F)


def _packed(w: FloatArray) -> KeyArray:
    """(N,) the three components of each row in steps, as one number."""
    keys = np.zeros(len(w), np.uint64)
    for k in range(3):
        step = np.rint(w[:, k] / STEP)
        step[np.isnan(step)] = _NAN
        keys *= np.uint64(_LEVELS)
        keys += (np.clip(step, -_INFINITE, _INFINITE) + _INFINITE).astype(np.uint64)
    return keys


class RepeatEstimate:
    """How many samples repeat an earlier geometry, from a share of the geometries.

    Which geometries are looked at is told by their mixed keys: all samples of one are, or none, so that its
    repeats are counted exactly. The share is halved when more than ``most`` samples are kept; until then the
    number is exact.
    """

    def __init__(self, most: int = 1 << 20) -> None:
        self._most = most
        self._bits = 0
        self._keys = np.zeros((2, 0), np.uint64)

    def add(self, wi: FloatArray, wo: FloatArray) -> None:
        """Take note of the pairs (n, 3)."""
        keys = np.empty((2, len(wi)), np.uint64)

        def pack(part: slice) -> None:
            keys[0, part], keys[1, part] = _packed(wi[part]), _packed(wo[part])

        in_parts(pack, len(wi))
        self._keys = np.concatenate([self._keys, self._few(keys)], axis=1)
        while self._keys.shape[1] > self._most:
            self._bits += 1
            self._keys = self._few(self._keys)

    def _few(self, keys: KeyArray) -> KeyArray:
        # The high bits: the low ones of a product depend on few of its factors' bits.
        if not self._bits:
            return keys
        return keys[:, _mixed(keys[0], keys[1]) >> np.uint64(64 - self._bits) == 0]

    @property
    def exact(self) -> bool:
        """Whether every sample was counted."""
        return not self._bits

    @property
    def looked_at(self) -> int:
        """Samples that were."""
        return self._keys.shape[1]

    @property
    def number(self) -> int:
        """Samples of all that have a geometry which another one had before."""
        order = np.lexsort(self._keys)
        same = (self._keys[:, order[1:]] == self._keys[:, order[:-1]]).all(axis=0)
        return int(np.count_nonzero(same)) << self._bits
