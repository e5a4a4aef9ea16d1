"""Bilinear images on the unit square, and the warp whose density such an image is.

An image (H, W) has its samples at the corners of equal cells: x in [0, 1] along the last axis, y along the
one before. The warp takes the uniform square to a density in two steps: y by its marginal distribution,
then x by the conditional one at that y. Both densities are piecewise linear, so both distributions are
piecewise quadratic and are inverted exactly (J. Dupuy, W. Jakob 2018, section 4).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

#: So many points are mapped at a time.
_POINTS = 256

#: What a value is blended from: images by number, (M,), and their weights, (M,).
Blend = Sequence[tuple[IndexArray, FloatArray]]


@dataclass(frozen=True)
class Corner:
    """The lower corner of the cell that each of M points lies in, and where in the cell, in [0, 1]."""

    i: IndexArray
    j: IndexArray
    x: FloatArray
    y: FloatArray

    @classmethod
    def of(cls, shape: tuple[int, ...], x: FloatArray, y: FloatArray) -> Corner:
        """Of points (M,) each on an image of ``shape`` (..., H, W)."""
        at = x * (shape[-1] - 1), y * (shape[-2] - 1)
        i = np.clip(at[0].astype(np.intp), 0, shape[-1] - 2)
        j = np.clip(at[1].astype(np.intp), 0, shape[-2] - 2)
        return cls(i, j, at[0] - i, at[1] - j)


def lookup(image: NDArray[np.floating], x: FloatArray, y: FloatArray) -> FloatArray:
    """The bilinear image (H, W) at points (M,)."""
    return looked_up(image, Corner.of(image.shape, x, y))


def looked_up(image: NDArray[np.floating], at: Corner) -> FloatArray:
    """The bilinear image (H, W) at points (M,)."""
    width = image.shape[-1]
    flat, index = image.reshape(-1), at.j * width + at.i
    low = flat.take(index).astype(np.float64, copy=False)
    low += at.x * (flat.take(index + 1) - low)
    index += width
    high = flat.take(index).astype(np.float64, copy=False)
    high += at.x * (flat.take(index + 1) - high)
    high -= low
    high *= at.y
    high += low
    return high


def lookup_blend(images: NDArray[np.floating], blend: Blend, x: FloatArray, y: FloatArray) -> FloatArray:
    """Blended values (M, C) of images (K, C, H, W) at points (M,)."""
    at = Corner.of(images.shape, x, y)
    total = np.zeros((len(x), images.shape[1]))
    for node, weight in blend:
        for j, wy in ((at.j, 1 - at.y), (at.j + 1, at.y)):
            for i, wx in ((at.i, 1 - at.x), (at.i + 1, at.x)):
                total += (weight * wy * wx)[:, None] * images[node, :, j, i]
    return total


class Warp:
    """The warps of K densities, each of which is scaled to unit integral.

    Raises ValueError for a density that has no finite, positive integral, which it numbers from 0.
    """

    def __init__(self, density: NDArray[np.floating]) -> None:
        self.shape = density.shape[1:]
        self._density = np.empty(density.shape)
        self._along_x = np.empty(density.shape)
        # One density at a time: what is computed on the way would be several times the file's size.
        for k, one in enumerate(density):
            values = np.asarray(one, np.float64)
            with np.errstate(over="ignore", invalid="ignore"):
                total = _cumulated(_cumulated(values)[:, -1])[-1]
            if not (np.isfinite(total) and total > 0):
                raise ValueError(f"density {k} has no finite, positive integral")
            self._density[k] = values / total
            self._along_x[k] = _cumulated(self._density[k])
        self._along_y = _cumulated(self._along_x[..., -1])

    def blended(self, share: Sequence[tuple[int, float]]) -> Warp:
        """The one warp of the densities by number, blended with these weights."""
        found = copy(self)
        for name in ("_density", "_along_x", "_along_y"):
            whole: FloatArray = getattr(self, name)
            setattr(found, name, np.sum([weight * whole[node] for node, weight in share], axis=0)[None])
        return found

    @property
    def packed(self) -> tuple[FloatArray, FloatArray, int]:
        """The first density for kernels: beside each of its values the integral along the row up to there,
        flat; the integral of each row and that over the rows up to there, flat; W."""
        along = self._along_x[0]
        values = np.stack([self._density[0], along], axis=2)
        rows = np.stack([along[:, -1], self._along_y[0]], axis=1)
        return values.reshape(-1), rows.reshape(-1), self.shape[1]

    def inverse(self, blend: Blend, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where in the uniform square the points (M,) come from, for densities blended as ``blend`` says."""

        def read(values: FloatArray, index: IndexArray) -> FloatArray:
            flat = values.reshape(len(values), -1)
            total = np.zeros(len(index))
            for node, weight in blend:
                total += weight * flat[node, index]
            return total

        return self._inverse(read, Corner.of(self.shape, x, y))

    def inverse_of_one(self, at: Corner) -> tuple[FloatArray, FloatArray]:
        """:meth:`inverse` for the first density, of points (M,) on its image."""
        return self._inverse(lambda values, index: values[0].reshape(-1).take(index), at)

    def _inverse(
        self, read: Callable[[FloatArray, IndexArray], FloatArray], at: Corner
    ) -> tuple[FloatArray, FloatArray]:
        height, width = self.shape

        def part(j: IndexArray) -> tuple[FloatArray, FloatArray]:
            """The integral over a row up to x, and over the whole row."""
            index = j * width + at.i
            left, right = read(self._density, index), read(self._density, index + 1)
            inside = (left + 0.5 * (right - left) * at.x) * at.x * (1 / (width - 1))
            return read(self._along_x, index) + inside, read(self._along_x[..., -1], j)

        (low, low_row), (high, high_row) = part(at.j), part(at.j + 1)
        below = (low_row + 0.5 * (high_row - low_row) * at.y) * at.y * (1 / (height - 1))
        t = read(self._along_y, at.j) + below
        mix = _mix(low_row, high_row, at.y)
        row = (1 - mix) * low_row + mix * high_row
        # Rows without density have no conditional distribution: nothing is ever mapped there.
        s = np.where(row > 0, (1 - mix) * low + mix * high, 0.0) / np.where(row > 0, row, 1.0)
        return np.clip(s, 0.0, 1.0), np.clip(t, 0.0, 1.0)

    def forward(self, node: int, s: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The points (M,) that points (s, t) of the uniform square are mapped to by one of the densities.

        Where the distribution stands still, s or t = 1 is mapped to where it first gets to 1.
        """
        found = np.empty((2, len(s)))
        # Each point takes two rows of the images on the way.
        for start in range(0, len(s), _POINTS):
            part = slice(start, start + _POINTS)
            found[:, part] = self._forward(node, s[part], t[part])
        return found[0], found[1]

    def _forward(self, node: int, s: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        height, width = self.shape
        rows = self._along_x[node, :, -1]
        along = self._along_y[node]
        level = np.asarray(t * along[-1], np.float64)
        j = _cell(np.broadcast_to(along, (len(t), height)), level, t >= 1)
        y = _within(along[j], rows[j], rows[j + 1], level, height)
        mix = _mix(rows[j], rows[j + 1], y)[:, None]
        distribution = (1 - mix) * self._along_x[node, j] + mix * self._along_x[node, j + 1]
        density = (1 - mix) * self._density[node, j] + mix * self._density[node, j + 1]
        k = np.arange(len(s))
        wanted = np.asarray(s * distribution[:, -1], np.float64)
        i = _cell(distribution, wanted, s >= 1)
        x = _within(distribution[k, i], density[k, i], density[k, i + 1], wanted, width)
        return (i + x) / (width - 1), (j + y) / (height - 1)


def _cumulated(values: FloatArray) -> FloatArray:
    """Integral of the piecewise linear function along the last axis from 0 up to each node."""
    steps = 0.5 * (values[..., 1:] + values[..., :-1]) / (values.shape[-1] - 1)
    return np.concatenate([np.zeros((*values.shape[:-1], 1)), np.cumsum(steps, axis=-1)], axis=-1)


def _mix(low: FloatArray, high: FloatArray, y: FloatArray) -> FloatArray:
    """The share of the upper row in the conditional distribution at y, whose rows have these integrals.

    On a row without density it is what it is just beside it: that of the other row.
    """
    return np.where((1 - y) * low + y * high > 0, y, 0.5)


def _cell(distribution: FloatArray, wanted: FloatArray, first: NDArray[np.bool_]) -> IndexArray:
    """The cell (M,) in which each distribution (M, n) takes the wanted value: the last one, or the first."""
    reached = (distribution <= wanted[:, None]).sum(axis=1)
    before = (distribution < wanted[:, None]).sum(axis=1)
    cell = np.where(first, before, reached) - 1
    return np.clip(cell, 0, distribution.shape[1] - 2).astype(np.intp)


def _within(start: FloatArray, a: FloatArray, b: FloatArray, wanted: FloatArray, nodes: int) -> FloatArray:
    """Where in its cell the integral of the density from a to b makes up what is wanted, in [0, 1].

    The root of a x + (b - a) x^2 / 2 = r in the form 2 r / (a + sqrt(a^2 + 2 (b - a) r)), which does not
    cancel where b is close to a.
    """
    rest = (wanted - start) * (nodes - 1)
    below = a + np.sqrt(np.maximum(a * a + 2 * (b - a) * rest, 0.0))
    return np.clip(2 * rest / np.where(below > 0, below, 1.0), 0.0, 1.0)
