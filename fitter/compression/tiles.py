"""Tiles: a compressed table's values, of which only the parts that are asked for are unpacked."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fitter.compression import coding
from fitter.compression.coding import Scale, Tile
from fitter.compression.container import Block, damaged
from fitter.compression.folds import Folds
from fitter.parts import in_parts

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

#: Bytes of unpacked tiles that are kept; those asked for longest ago go first.
KEPT = 1 << 26


@dataclass(frozen=True)
class Tiles:
    """The values (N, C) in the blocks "values 0", "values 1", ...; ``lost`` says what is wrong with others.

    ``tiles[index]`` and ``tiles.shape`` are those of the array.
    """

    blocks: Mapping[str, Block]
    lost: Mapping[str, str]
    scale: Scale
    folds: Folds
    _kept: OrderedDict[str, Tile] = field(default_factory=OrderedDict[str, Tile], repr=False, compare=False)

    @property
    def shape(self) -> tuple[int, int]:
        return int(np.prod(self.folds.full)), len(self.scale.floor)

    @property
    def names(self) -> list[str]:
        """Of the blocks that can be read."""
        return [name for name in self.blocks if name.startswith("values ")]

    @property
    def count(self) -> int:
        """Of all blocks, damaged ones included."""
        return len(self.names) + sum(name.startswith("values ") for name in self.lost)

    def __getitem__(self, index: IntArray) -> FloatArray:
        return self.values(index)

    def values(self, index: IntArray) -> FloatArray:
        """(n, C) of the samples ``index`` (n,). Raises TableError where one is in a damaged block."""
        flat = np.ravel_multi_index(self.folds.stored(index), self.folds.shape)
        where = np.unravel_index(flat, self.folds.shape)
        channels = self.shape[1]
        found = np.empty((len(index), channels))
        missing = np.ones(len(index), bool)
        for name in self.names:
            box = coding.place(self.blocks[name], self.folds)
            inside = missing.copy()
            for i, start, stop in zip(where, box.start, box.stop, strict=True):
                inside &= (i >= start) & (i < stop)
            rows = np.flatnonzero(inside)
            if not len(rows):
                continue
            missing[rows] = False
            tile = self.tile(name)
            node = tuple(i[rows] - start for i, start in zip(where, box.start, strict=True))
            found[rows] = tile.value[node]
            if len(tile.fixed):
                element = index[rows][:, None] * channels + np.arange(channels)
                place = np.searchsorted(tile.fixed, element).clip(0, len(tile.fixed) - 1)
                found[rows] = np.where(tile.fixed[place] == element, tile.replaced[place], found[rows])
        if missing.any():
            name = next((name for name in self.lost if name.startswith("values ")), "values")
            message = self.lost.get(name, "no block holds some of the samples")
            raise damaged(f"{message}, and sample {int(index[missing][0])} is in it", None, name)
        return found

    def all(self) -> tuple[FloatArray, BoolArray]:
        """(N, C) all values, NaN in damaged blocks, and (N,) where that is."""
        samples, channels = self.shape
        names = self.names
        if self.count == len(names) == 1 and self._is_all(self.blocks[names[0]]):
            kept = self._kept.get(names[0])
            tile = kept or coding.decode(self.blocks[names[0]], self.scale, self.folds)
            value = self.folds.spread(tile.value).reshape(samples, channels)
            value = value if kept is None else value.copy()
            value.reshape(-1)[tile.fixed] = tile.replaced
            return value, np.zeros(samples, bool)
        stored = np.full((*self.folds.shape, channels), np.nan)
        lost = np.ones(self.folds.shape, bool)
        fixed: list[tuple[IntArray, FloatArray]] = []

        def unpack(part: slice) -> None:
            for name in names[part]:
                tile = self._kept.get(name) or coding.decode(self.blocks[name], self.scale, self.folds)
                stored[tile.box.slices] = tile.value
                lost[tile.box.slices] = False
                fixed.append((tile.fixed, tile.replaced))

        in_parts(unpack, len(names), rows=1, many=2)
        value = self.folds.spread(stored).reshape(samples, channels)
        for place, replaced in fixed:
            value.reshape(-1)[place] = replaced
        return value, self.folds.spread(lost).reshape(samples)

    def _is_all(self, block: Block) -> bool:
        """Whether a block's tile is all that is stored."""
        return coding.place(block, self.folds).shape == tuple(self.folds.shape)

    def tile(self, name: str) -> Tile:
        """The tile of a block, unpacked now or before."""
        tile = self._kept.pop(name, None) or coding.decode(self.blocks[name], self.scale, self.folds)
        self._kept[name] = tile
        while len(self._kept) > 1 and sum(kept.nbytes for kept in self._kept.values()) > KEPT:
            self._kept.popitem(last=False)
        return tile
