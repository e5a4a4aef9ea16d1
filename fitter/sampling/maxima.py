"""Largest values over ranges of a table in constant time (sparse tables: maxima over 2^k neighbours), and
over rectangles of bilinear images."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fitter.sampling.axes import Axis, Span

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

# Windows longer than 2^5 nodes are as loose as the whole axis, and cost memory.
_LEVELS = 6


class BoxMaximum:
    """Maximum of a table (R, S) over index boxes: any box is covered by four of 2^a x 2^b cells."""

    def __init__(self, table: FloatArray) -> None:
        rows, columns = table.shape
        levels = (int(np.log2(rows)) + 1, int(np.log2(columns)) + 1)
        self._sparse = np.zeros((*levels, rows, columns))
        self._sparse[0, 0] = table
        for a in range(levels[0]):
            if a > 0:
                half = 1 << (a - 1)
                lower = self._sparse[a - 1, 0]
                self._sparse[a, 0] = lower
                self._sparse[a, 0, : rows - half] = np.maximum(lower[: rows - half], lower[half:])
            for b in range(1, levels[1]):
                half = 1 << (b - 1)
                left = self._sparse[a, b - 1]
                joined = np.maximum(left[:, : columns - half], left[:, half:])
                self._sparse[a, b] = left
                self._sparse[a, b, :, : columns - half] = joined

    def __call__(self, i0: IndexArray, i1: IndexArray, j0: IndexArray, j1: IndexArray) -> FloatArray:
        """(K,) maxima over rows i0..i1 and columns j0..j1, both included."""
        a = np.log2(i1 - i0 + 1).astype(np.intp)
        b = np.log2(j1 - j0 + 1).astype(np.intp)
        i2, j2 = i1 - (1 << a) + 1, j1 - (1 << b) + 1
        s = self._sparse
        return np.maximum(
            np.maximum(s[a, b, i0, j0], s[a, b, i2, j0]), np.maximum(s[a, b, i0, j2], s[a, b, i2, j2])
        )


class WindowMaximum:
    """Maximum of a table (R, S, P) over intervals of its last, periodic axis, at one (row, column)."""

    def __init__(self, table: FloatArray, nodes: FloatArray, period: float | None) -> None:
        self._whole = table.max(axis=2)
        self._count = len(nodes)
        self._around: FloatArray | None = None
        self._levels: list[NDArray[np.float32]] = []
        if period is not None and len(nodes) > 2:
            self._around = np.concatenate([nodes - period, nodes, nodes + period])
            level = _rounded_up(table)
            while len(self._levels) < _LEVELS and (1 << len(self._levels)) < self._count:
                self._levels.append(level)
                level = np.maximum(level, np.roll(level, -(1 << (len(self._levels) - 1)), axis=2))

    def between(self, low: FloatArray, high: FloatArray) -> Callable[[IndexArray, IndexArray], FloatArray]:
        """A function of (rows, columns), each (K,): maxima over the nodes in and next to [low, high]."""
        if self._around is None:
            return lambda row, column: self._whole[row, column]
        reach = 2 * (self._around[-1] - self._around[0])
        first = np.searchsorted(self._around, np.maximum(low, -reach), side="right") - 1
        last = np.searchsorted(self._around, np.minimum(high, reach), side="left")
        length = last - first + 1
        use = (first >= 0) & (last < len(self._around)) & (length < min(1 << len(self._levels), self._count))
        level = np.log2(np.where(use, length, 1)).astype(np.intp)
        start = first % self._count
        stop = (last - (1 << level) + 1) % self._count

        def largest(row: IndexArray, column: IndexArray) -> FloatArray:
            found = self._whole[row, column]
            for k, table in enumerate(self._levels):
                mine = np.flatnonzero(use & (level == k))
                i, j = row[mine], column[mine]
                found[mine] = np.maximum(table[i, j, start[mine]], table[i, j, stop[mine]])
            return found

        return largest


class BilinearMaximum:
    """Largest values of bilinear images (H, W), or (K, H, W), over rectangles of the unit square."""

    def __init__(self, image: FloatArray) -> None:
        self._images = image.reshape(-1, *image.shape[-2:])
        self._x, self._y = (
            Axis(name, np.linspace(0, 1, n), None) for name, n in zip("xy", image.shape[:-3:-1], strict=True)
        )
        # Of several images, where a rectangle is large, each one's largest value will do.
        self._boxes = BoxMaximum(image) if image.ndim == 2 else None
        self._largest = self._images.max(axis=(1, 2))

    def __call__(
        self, x0: FloatArray, x1: FloatArray, y0: FloatArray, y1: FloatArray, which: IndexArray | int = 0
    ) -> FloatArray:
        """(K,), of the images ``which``. Within one cell of the image a bilinear function is largest at a
        corner of a rectangle; with at most one line of nodes inside in each direction, where sides and lines
        cross; else the largest node stands for it.
        """
        x, y = Span(self._x, x0, x1), Span(self._y, y0, y1)
        if self._boxes is not None:
            most = self._boxes(y.first, y.last, x.first, x.last)
        else:
            most = self._largest[which]
        small = np.flatnonzero(x.few & y.few)
        x, y = x.take(small), y.take(small)
        which = which if isinstance(which, int) else which[small]
        within = np.full(len(small), -np.inf)
        nodes = [[self._images[which, j, i] for i in x.nodes] for j in y.nodes]
        for b in y.fractions:
            row = [sum(w * nodes[j][i] for j, w in enumerate(b)) for i in range(3)]
            for a in x.fractions:
                within = np.maximum(within, sum(w * row[i] for i, w in enumerate(a)))
        most[small] = within
        return most


def _rounded_up(table: FloatArray) -> NDArray[np.float32]:
    """The next float32 above: half the memory, still a bound."""
    with np.errstate(over="ignore"):
        return np.nextafter(table.astype(np.float32), np.float32(np.inf))
