"""Largest values over ranges of a table in constant time (sparse tables: maxima over 2^k neighbours), and
over rectangles of bilinear images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.sampling.axes import Axis, Span

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

# Windows longer than 2^5 nodes are as loose as the whole axis, and cost memory.
_LEVELS = 6


class BoxMaximum:
    """Maximum of a table (R, S) over index boxes: any box is covered by four of 2^a x 2^b cells.

    sparse : (A, B, R, S) maxima over 2^a x 2^b cells from each on.
    """

    def __init__(self, table: FloatArray) -> None:
        rows, columns = table.shape
        levels = (int(np.log2(rows)) + 1, int(np.log2(columns)) + 1)
        self.sparse = np.zeros((*levels, rows, columns))
        self.sparse[0, 0] = table
        for a in range(levels[0]):
            if a > 0:
                half = 1 << (a - 1)
                lower = self.sparse[a - 1, 0]
                self.sparse[a, 0] = lower
                self.sparse[a, 0, : rows - half] = np.maximum(lower[: rows - half], lower[half:])
            for b in range(1, levels[1]):
                half = 1 << (b - 1)
                left = self.sparse[a, b - 1]
                joined = np.maximum(left[:, : columns - half], left[:, half:])
                self.sparse[a, b] = left
                self.sparse[a, b, :, : columns - half] = joined

    def __call__(self, i0: IndexArray, i1: IndexArray, j0: IndexArray, j1: IndexArray) -> FloatArray:
        """(K,) maxima over rows i0..i1 and columns j0..j1, both included."""
        a = np.log2(i1 - i0 + 1).astype(np.intp)
        b = np.log2(j1 - j0 + 1).astype(np.intp)
        i2, j2 = i1 - (1 << a) + 1, j1 - (1 << b) + 1
        s = self.sparse
        return np.maximum(
            np.maximum(s[a, b, i0, j0], s[a, b, i2, j0]), np.maximum(s[a, b, i0, j2], s[a, b, i2, j2])
        )


class WindowMaximum:
    """Maximum of a table (R, S, P) over intervals of its last, periodic axis, at one (row, column).

    around : (1, 3 P) the nodes, once before and once after; levels : (L, R, S, P) maxima over 2^k nodes from
    each on; whole : (R, S) over all nodes. Without levels the whole axis stands for any interval.
    """

    def __init__(self, table: FloatArray, nodes: FloatArray, period: float | None) -> None:
        self.whole = table.max(axis=2)
        self.count = len(nodes)
        self.around = np.zeros((1, 0))
        levels: list[NDArray[np.float32]] = []
        if period is not None and len(nodes) > 2:
            self.around = np.concatenate([nodes - period, nodes, nodes + period])[None]
            level = _rounded_up(table)
            while len(levels) < _LEVELS and (1 << len(levels)) < self.count:
                levels.append(level)
                level = np.maximum(level, np.roll(level, -(1 << (len(levels) - 1)), axis=2))
        self.levels = np.stack(levels) if levels else np.zeros((0, 1, 1, 1), np.float32)

    def between(self, low: FloatArray, high: FloatArray, row: IndexArray, column: IndexArray) -> FloatArray:
        """(K,) maxima over the nodes in and next to [low, high] at rows and columns, each (K,)."""
        from fitter.kernels.maxima import over_windows

        found = np.empty(len(low))
        over_windows(self.around, self.levels, self.whole, self.count, low, high, row, column, found)
        return found


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


def packed(image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What kernels need for the largest values of an image (H, W) over rectangles of the unit square: nodes
    (2, n) of x and of y, and its maxima over boxes."""
    nodes = np.full((2, max(image.shape)), np.inf)
    for row, n in zip(nodes, image.shape[::-1], strict=True):
        row[:n] = np.linspace(0, 1, n)
    return nodes, BoxMaximum(image).sparse


def _rounded_up(table: FloatArray) -> NDArray[np.float32]:
    """The next float32 above: half the memory, still a bound."""
    with np.errstate(over="ignore"):
        return np.nextafter(table.astype(np.float32), np.float32(np.inf))
