"""What of a table is there twice: mirrored halves and repeated rows of its axes, which need not be stored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

#: Mirrored nodes may be this far apart, in steps; the few that are further have corrections of their own.
_APART = 0.25
#: The largest share of such nodes that mirroring is worth.
_MOST_APART = 0.02


@dataclass(frozen=True)
class Folds:
    """For each axis the stored row that each of its rows is: (n,) of numbers below ``shape``.

    mirrored : the axes whose second half is the first one's mirror image.
    """

    rows: tuple[IntArray, ...]
    mirrored: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Of what is stored."""
        return tuple(int(rows.max()) + 1 for rows in self.rows)

    @property
    def full(self) -> tuple[int, ...]:
        """Of the table."""
        return tuple(len(rows) for rows in self.rows)

    @property
    def plain(self) -> bool:
        """Whether nothing is there twice."""
        return self.shape == self.full

    def stored(self, index: NDArray[np.integer[Any]]) -> tuple[IntArray, ...]:
        """Rows of the stored array, one (n,) for each axis, of the table's samples ``index`` (n,)."""
        where = np.unravel_index(index, self.full)
        return tuple(rows[i] for rows, i in zip(self.rows, where, strict=True))

    def spread(self, stored: NDArray[Any]) -> NDArray[Any]:
        """(*full, ...) of (*shape, ...)."""
        for axis, rows in enumerate(self.rows):
            if len(rows) != stored.shape[axis]:
                stored = np.take(stored, rows, axis=axis)
        return stored

    def document(self) -> dict[str, Any]:
        return {
            "mirrored": list(self.mirrored),
            "rows": [
                None if np.array_equal(rows, np.arange(len(rows))) else rows.tolist() for rows in self.rows
            ],
        }

    @staticmethod
    def from_document(document: dict[str, Any], full: Sequence[int]) -> Folds:
        rows = tuple(
            np.arange(n) if stated is None else np.array(stated, np.intp)
            for n, stated in zip(full, document["rows"], strict=True)
        )
        return Folds(rows, tuple(document["mirrored"]))


def fold(steps: FloatArray, *, exact: bool) -> tuple[FloatArray, Folds]:
    """``steps`` (C, *shape), contiguous, without what is there twice, and how to unfold it.

    Mirrored nodes become the mean of both, which is within the bound of either; with ``exact`` only what is
    equal bit by bit counts. Nodes that are no numbers have to be the same ones.
    """
    every: list[IntArray] = []
    mirrored: list[int] = []
    for axis in range(1, steps.ndim):
        n = steps.shape[axis]
        half = (n + 1) // 2
        rows: IntArray = np.arange(n)
        if n > 1 and (found := _mirrored(steps, axis, exact)) is not None:
            steps = np.ascontiguousarray(np.take(found, range(half), axis=axis))
            rows = np.minimum(rows, n - 1 - rows)
            mirrored.append(axis - 1)
        fresh = _fresh(steps, axis)
        if not fresh.all():
            steps = np.ascontiguousarray(np.compress(fresh, steps, axis=axis))
            rows = (np.cumsum(fresh) - 1)[rows]
        every.append(rows)
    return steps, Folds(tuple(every), tuple(mirrored))


def _mirrored(steps: FloatArray, axis: int, exact: bool) -> FloatArray | None:
    """The mean of the array and its mirror image where that is within the bound, None if it is no image."""
    n = steps.shape[axis]
    outer = min(n // 2, 2)
    ends = np.take(steps, [*range(outer), *range(n - outer, n)], axis=axis)
    # Most tables are no images at their outermost rows already.
    if _share_apart(ends, axis, exact) > 0.5 or _share_apart(steps, axis, exact) > _MOST_APART:
        return None
    image = np.flip(steps, axis)
    with np.errstate(invalid="ignore"):
        near = np.abs(steps - image) <= 1.0
    return np.where(near, 0.5 * (steps + np.where(near, image, 0.0)), steps)


def _share_apart(steps: FloatArray, axis: int, exact: bool) -> float:
    """The share of nodes that are not their mirror images; all, where one of two is no number."""
    image = np.ascontiguousarray(np.flip(steps, axis))
    same = steps.view(np.int64) == image.view(np.int64)
    finite = np.isfinite(steps) & np.isfinite(image)
    if exact or not (same | finite).all():
        return 0.0 if same.all() else 1.0
    with np.errstate(invalid="ignore"):
        apart = ~(np.abs(steps - image) <= _APART) & ~same
    return np.count_nonzero(apart) / steps.size


def _fresh(steps: FloatArray, axis: int) -> NDArray[np.bool_]:
    """(n,) whether each row of the axis differs, bit by bit, from the one before."""
    bits = np.moveaxis(np.ascontiguousarray(steps).view(np.int64), axis, 0)
    found = np.ones(len(bits), bool)
    for row in range(1, len(bits)):
        found[row] = not np.array_equal(bits[row], bits[row - 1])
    return found
