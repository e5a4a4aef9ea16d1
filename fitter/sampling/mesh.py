"""Piecewise linear functions on triangles of the plane; several of them as one on a common mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]

# Pieces smaller than this share of the unit disk are rounding.
_SMALLEST = 1e-16
# Polygon pairs that are clipped at a time.
_CHUNK = 1 << 16


@dataclass(frozen=True)
class Mesh:
    """corners : (T, 3, 2) of triangles that don't overlap; values : (T, 3, K) of K linear functions there."""

    corners: FloatArray
    values: FloatArray

    @property
    def areas(self) -> FloatArray:
        """(T,)."""
        a, b = self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0]
        return 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])

    def integrals(self) -> FloatArray:
        """(T, K) of the functions over each triangle."""
        return self.areas[:, None] * self.values.mean(axis=1)


def overlay(first: Mesh, second: Mesh) -> Mesh:
    """The sum of the functions of both where both are defined, linear on every triangle of the result."""
    one, other = _overlapping(first.corners, second.corners)
    parts: list[tuple[FloatArray, FloatArray]] = []
    for start in range(0, len(one), _CHUNK):
        i, j = one[start : start + _CHUNK], other[start : start + _CHUNK]
        polygon, count = _intersections(first.corners[i], second.corners[j])
        some = count >= 3
        i, j, polygon, count = i[some], j[some], polygon[some], count[some]
        values = _linear(first, i, polygon) + _linear(second, j, polygon)
        for k in range(1, polygon.shape[1] - 1):  # a fan of triangles around the first corner
            has = count > k + 1
            parts.append((polygon[has][:, [0, k, k + 1]], values[has][:, [0, k, k + 1]]))
    if not parts:
        return Mesh(np.zeros((0, 3, 2)), np.zeros((0, 3, first.values.shape[2])))
    mesh = Mesh(*(np.concatenate(kind) for kind in zip(*parts, strict=True)))
    keep = mesh.areas > _SMALLEST
    return Mesh(mesh.corners[keep], mesh.values[keep])


def halved(mesh: Mesh, which: BoolArray) -> Mesh:
    """``mesh`` with the triangles ``which`` cut in two, each across its longest side."""
    corners, values = mesh.corners[which], mesh.values[which]
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    turn = (np.argmax(sides, axis=1)[:, None] + np.arange(3)) % 3  # the longest side from the first corner
    rows = np.arange(len(corners))[:, None]
    corners, values = corners[rows, turn], values[rows, turn]
    middle, between = corners[:, :2].mean(axis=1), values[:, :2].mean(axis=1)
    fresh = [np.stack([middle, corners[:, k], corners[:, 2]], axis=1) for k in (0, 1)]
    found = [np.stack([between, values[:, k], values[:, 2]], axis=1) for k in (0, 1)]
    return Mesh(np.concatenate([mesh.corners[~which], *fresh]), np.concatenate([mesh.values[~which], *found]))


def _linear(mesh: Mesh, which: IndexArray, points: FloatArray) -> FloatArray:
    """(P, V, K) of the functions of triangles ``which`` (P,) at points (P, V, 2)."""
    a = mesh.corners[which, 0]
    u, v = mesh.corners[which, 1] - a, mesh.corners[which, 2] - a
    p = points - a[:, None]
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    s = np.clip((p[..., 0] * v[:, None, 1] - p[..., 1] * v[:, None, 0]) / area[:, None], 0.0, 1.0)
    t = np.clip((u[:, None, 0] * p[..., 1] - u[:, None, 1] * p[..., 0]) / area[:, None], 0.0, 1.0)
    t = np.minimum(t, 1.0 - s)
    # A mean of the corners' values: never outside their range, whatever the rounding.
    f = mesh.values[which]
    return (
        (1 - s - t)[..., None] * f[:, None, 0] + s[..., None] * f[:, None, 1] + t[..., None] * f[:, None, 2]
    )


def _overlapping(first: FloatArray, second: FloatArray) -> tuple[IndexArray, IndexArray]:
    """Pairs of triangles whose bounding boxes meet, each once."""
    if not len(first) or not len(second):
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    boxes = [(c.min(axis=1), c.max(axis=1)) for c in (first, second)]
    low = np.minimum(boxes[0][0].min(axis=0), boxes[1][0].min(axis=0))
    high = np.maximum(boxes[0][1].max(axis=0), boxes[1][1].max(axis=0))
    bins = int(np.clip(np.sqrt(max(len(first), len(second))), 1, 512))
    size = np.maximum(high - low, 1e-12) / bins
    entries = [_binned(*box, low, size, bins) for box in boxes]
    (triangle, key), (other, other_key) = entries
    order = np.argsort(other_key, kind="stable")
    other, other_key = other[order], other_key[order]
    start = np.searchsorted(other_key, key, side="left")
    count = np.searchsorted(other_key, key, side="right") - start
    one = np.repeat(triangle, count)
    where = np.repeat(key, count)
    two = other[
        np.repeat(start - np.concatenate([[0], np.cumsum(count)[:-1]]), count) + np.arange(count.sum())
    ]
    corner = np.maximum(boxes[0][0][one], boxes[1][0][two])
    meet = (corner <= np.minimum(boxes[0][1][one], boxes[1][1][two])).all(axis=1)
    # Of all bins that both are in, the one that holds the lower left corner of what they share counts.
    place = np.clip(((corner - low) / size).astype(np.intp), 0, bins - 1)
    meet &= place[:, 0] * bins + place[:, 1] == where
    return one[meet], two[meet]


def _binned(
    low: FloatArray, high: FloatArray, start: FloatArray, size: FloatArray, bins: int
) -> tuple[IndexArray, IndexArray]:
    """``(triangle, bin)`` for every square bin that a bounding box touches."""
    first = np.clip(((low - start) / size).astype(np.intp), 0, bins - 1)
    last = np.clip(((high - start) / size).astype(np.intp), 0, bins - 1)
    wide = last - first + 1
    count = wide.prod(axis=1)
    triangle = np.repeat(np.arange(len(low)), count)
    k = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    x, y = np.divmod(k, wide[triangle, 1])
    return triangle, (first[triangle, 0] + x) * bins + first[triangle, 1] + y


def _intersections(subject: FloatArray, clip: FloatArray) -> tuple[FloatArray, IndexArray]:
    """``(polygons (P, V, 2), corners of each (P,))``: triangles cut by triangles, Sutherland-Hodgman."""
    u, v = clip[:, 1] - clip[:, 0], clip[:, 2] - clip[:, 0]
    turned = (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) < 0
    clip = np.where(turned[:, None, None], clip[:, ::-1], clip)
    polygon = subject
    count = np.full(len(subject), 3, np.intp)
    for k in range(3):
        a, b = clip[:, k], clip[:, (k + 1) % 3]
        polygon, count = _cut(polygon, count, a, b - a)
    return polygon, count


def _cut(
    polygon: FloatArray, count: IndexArray, a: FloatArray, along: FloatArray
) -> tuple[FloatArray, IndexArray]:
    """What of polygons (P, V, 2) with ``count`` corners each lies left of lines through ``a`` (P, 2)."""
    rows, most = len(polygon), polygon.shape[1]
    step = polygon - a[:, None]
    left = along[:, None, 0] * step[..., 1] - along[:, None, 1] * step[..., 0]
    slot = np.arange(most)
    exists = slot < count[:, None]
    following = np.where(slot + 1 < count[:, None], slot + 1, 0)
    row = np.arange(rows)[:, None]
    next_left, next_point = left[row, following], polygon[row, following]
    inside, next_inside = left >= 0, next_left >= 0
    change = left - next_left
    share = left / np.where(change != 0, change, 1.0)
    crossing = polygon + share[..., None] * (next_point - polygon)
    # Every side gives its first corner if that is inside, then where it crosses the line.
    points = np.stack([polygon, crossing], axis=2).reshape(rows, 2 * most, 2)
    kept = np.stack([exists & inside, exists & (inside != next_inside)], axis=2).reshape(rows, 2 * most)
    order = np.argsort(~kept, axis=1, kind="stable")[:, : most + 1]
    # Rounding may add a corner to a sliver; more than one a cut is never area.
    return points[row, order], np.minimum(kept.sum(axis=1), most + 1)
