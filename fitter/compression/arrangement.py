"""How a table's samples are arranged for compression: their logical shape, and the tiles it is cut into."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from fitter.compression.tile import Box
from fitter.table import Table

FloatArray = NDArray[np.float64]

#: Samples of a tile at most: enough to learn from, few enough to be unpacked for the sake of one of them.
TILE = 1 << 17
#: Rows of scattered samples count as neighbours where they are this much closer than any two are.
_CLOSER = 0.5
_LOOKED_AT = 2048


def shape_of(table: Table) -> tuple[int, ...]:
    """A grid's own; of scattered samples, incidences x rows x columns as far as their order shows it."""
    if table.grid is not None:
        return table.grid.shape
    n = len(table)
    starts = np.flatnonzero((table.wi[1:] != table.wi[:-1]).any(axis=1)) + 1
    ends = np.concatenate([starts, [n]])
    scan = int(ends[0])
    if n % scan or not np.array_equal(ends, np.arange(scan, n + 1, scan)):
        return (n,)
    scans = n // scan
    width = _width(table.wo.reshape(scans, scan, 3))
    return tuple(k for k in (scans, scan // width, width) if k > 1) or (n,)


def _width(wo: FloatArray) -> int:
    """The length of the rows that each scan (S, n, 3) consists of; n where it is one row."""
    n = wo.shape[1]
    rng = np.random.default_rng(0)
    scan, first, other = (rng.integers(0, k, _LOOKED_AT) for k in (len(wo), n, n))
    far = float(np.nanmean(_distance(wo[scan, first], wo[scan, other])))
    best = n, _CLOSER * far
    for width in range(4, n // 2 + 1):
        if n % width == 0:
            below = first % (n - width)
            apart = float(np.nanmean(_distance(wo[scan, below], wo[scan, below + width])))
            if apart < best[1]:
                best = width, apart
    return best[0]


def _distance(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.sqrt(np.square(one - other).sum(axis=-1))


def boxes(shape: tuple[int, ...], most: int) -> list[Box]:
    """Tiles of at most about ``most`` nodes: the longest axis is cut once more until they are that small."""
    parts = [1] * len(shape)
    while np.prod([-(-n // p) for n, p in zip(shape, parts, strict=True)]) > most:
        longest = int(np.argmax([n / p for n, p in zip(shape, parts, strict=True)]))
        parts[longest] += 1
    cuts = [np.linspace(0, n, p + 1).astype(int) for n, p in zip(shape, parts, strict=True)]
    return [
        Box(
            tuple(int(cut[k]) for cut, k in zip(cuts, place, strict=True)),
            tuple(int(cut[k + 1]) for cut, k in zip(cuts, place, strict=True)),
        )
        for place in product(*(range(p) for p in parts))
    ]
