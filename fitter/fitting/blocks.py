"""Blocks: samples as component arrays of one length, each made when it is asked for.

Nothing is expanded beforehand, so that a fit needs little memory beside the table, whatever its size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias, overload, runtime_checkable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
#: Samples a block holds. One length for all, so that one program serves every table.
BLOCK = 65_536


def padded(samples: int) -> int:
    """What a subset of so many samples is padded to: a power of two, so that few lengths are compiled for."""
    return max(1024, 1 << (samples - 1).bit_length())


@dataclass(frozen=True)
class Block:
    """Samples padded to one length; padding, and what of a grid is not usable, has weight 0.

    Channels come first: three to a row are no length for the processor's vectors.

    pair : (6, B) components of wi and wo. y : (C, B) values.
    weight : (C, B), or (1, B) where the channels have the same.
    count : samples that are not padding.
    """

    pair: FloatArray
    y: FloatArray
    weight: FloatArray
    count: int


@runtime_checkable
class Streamed(Protocol):
    """Blocks that are made anew on every pass and can't be had one by one. samples : in all of them."""

    @property
    def samples(self) -> int: ...
    def __iter__(self) -> Iterator[Block]: ...


Blocks: TypeAlias = Sequence[Block] | Streamed


@dataclass(frozen=True)
class BlocksMade(Sequence[Block]):
    """Blocks of ``each`` of ``places``, the last of what is left: ``make`` makes that of a slice of them.

    samples : in all of them.
    """

    make: Callable[[slice], Block]
    places: int
    each: int
    samples: int

    def __len__(self) -> int:
        return -(-self.places // self.each)

    @overload
    def __getitem__(self, index: int) -> Block: ...
    @overload
    def __getitem__(self, index: slice) -> list[Block]: ...
    def __getitem__(self, index: int | slice) -> Block | list[Block]:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        start = index % len(self) * self.each
        return self.make(slice(start, min(start + self.each, self.places)))

    def __iter__(self) -> Iterator[Block]:
        return (self[k] for k in range(len(self)))


def count(blocks: Blocks) -> int:
    """The samples of blocks, usable ones where that is known without making them."""
    return blocks.samples if isinstance(blocks, Streamed) else sum(block.count for block in blocks)
