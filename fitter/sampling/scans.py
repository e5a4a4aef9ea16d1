"""Scans: the samples of one incidence as a piecewise linear function on the projected disk."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, Delaunay, KDTree, QhullError

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]

#: Samples closer than this on the disk are one sample, their values averaged.
SAME_POINT = 1e-6
#: Half width, on the disk, of what counts as the plane of incidence.
PLANE = 1e-3
#: Fewer directions than this (mirror images included) say nothing about what lies between them.
FEWEST = 8
# A point this close outside a triangle is in it: measured points on the hull must not fall out.
_EDGE = 1e-9


@dataclass(frozen=True)
class Scan:
    """One incidence.

    incidence : (2,) x and y of wi; points : (n, 2) x and y of wo; value : (n, C) f_r in 1/sr.
    kind : "area" (can be triangulated), "line" (in the plane of incidence only) or "points" (too few).
    """

    incidence: FloatArray
    points: FloatArray
    value: FloatArray
    kind: Literal["area", "line", "points"]

    @classmethod
    def build(cls, incidence: FloatArray, points: FloatArray, value: FloatArray) -> Scan:
        """Of samples as measured: repeated directions averaged, the kind found out."""
        key = np.round(points / SAME_POINT).astype(np.int64)
        _, first, group = np.unique(key, axis=0, return_index=True, return_inverse=True)
        count = np.bincount(group.reshape(-1), minlength=len(first)).astype(np.float64)
        mean = np.stack(
            [np.bincount(group.reshape(-1), column, len(first)) / count for column in value.T], axis=1
        )
        scan = cls(incidence, points[first], mean, "points")
        across = scan.points @ np.array([-scan.axis[1], scan.axis[0]])
        if len(first) > 1 and float(np.abs(across).max()) < PLANE:
            return cls(incidence, scan.points, mean, "line")
        if len(first) >= FEWEST:
            centred = scan.points - scan.points.mean(axis=0)
            if np.linalg.svd(centred, compute_uv=False)[-1] > 1e-6:
                return cls(incidence, scan.points, mean, "area")
        return scan

    def __getstate__(self) -> dict[str, Any]:
        # Triangulations can't be pickled; they are built again where they are needed.
        return {name: vars(self)[name] for name in ("incidence", "points", "value", "kind")}

    @property
    def axis(self) -> FloatArray:
        """(2,) unit vector of the plane of incidence on the disk; +x at normal incidence."""
        length = float(np.hypot(*self.incidence))
        return self.incidence / length if length > PLANE else np.array([1.0, 0.0])

    @cached_property
    def triangulation(self) -> Delaunay:
        return Delaunay(self.points)

    @cached_property
    def hull(self) -> FloatArray:
        """(H, 2) corners of the convex hull, counter-clockwise."""
        return self.points[ConvexHull(self.points).vertices]

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.points)

    @cached_property
    def _line(self) -> tuple[FloatArray, FloatArray]:
        along = self.points @ self.axis
        order = np.argsort(along)
        return along[order], self.value[order]

    @cached_property
    def clamped(self) -> FloatArray:
        """(n, C) values, those below 0 set to 0."""
        return np.maximum(self.value, 0.0)

    def evaluate(self, points: FloatArray, value: FloatArray | None = None) -> tuple[FloatArray, BoolArray]:
        """``(values (M, C), inside (M,))`` at points (M, 2); outside, the nearest sample's value.

        ``value`` (n, C) replaces the measured values at the samples.
        """
        value = self.value if value is None else value
        if self.kind == "area":
            found, inside = self._on_triangles(points, value)
        elif self.kind == "line":
            along = points @ self.axis
            nodes, _ = self._line
            inside = np.abs(points @ np.array([-self.axis[1], self.axis[0]])) < PLANE
            inside &= (along >= nodes[0] - _EDGE) & (along <= nodes[-1] + _EDGE)
            ordered = value[np.argsort(self.points @ self.axis)]
            found = np.stack([np.interp(along, nodes, column) for column in ordered.T], axis=1)
        else:
            found, inside = np.zeros((len(points), value.shape[1])), np.zeros(len(points), bool)
        if not inside.all():
            distance, nearest = self._tree.query(points[~inside])
            found[~inside] = value[nearest]
            inside[~inside] = distance < SAME_POINT
        return found, inside

    def _on_triangles(self, points: FloatArray, value: FloatArray) -> tuple[FloatArray, BoolArray]:
        mesh = self.triangulation
        # The search for a triangle tries them all for a point outside: keep those from it.
        inside = np.ones(len(points), bool)
        for normal, offset in self._edges:
            inside &= points @ normal <= offset + _EDGE
        mine = np.flatnonzero(inside)
        triangle = mesh.find_simplex(points[mine], tol=_EDGE)
        affine = mesh.transform[triangle]
        first = np.einsum("mij,mj->mi", affine[:, :2], points[mine] - affine[:, 2])
        share = np.concatenate([first, 1.0 - first.sum(axis=1, keepdims=True)], axis=1)
        inside[mine] = (triangle >= 0) & np.isfinite(share).all(axis=1)
        share = np.clip(np.where(inside[mine, None], share, 0.0), 0.0, 1.0)
        found = np.zeros((len(points), value.shape[1]))
        found[mine] = np.einsum("mi,mic->mc", share, value[mesh.simplices[triangle]])
        return found, inside

    @cached_property
    def _edges(self) -> list[tuple[FloatArray, float]]:
        """Outward normal and offset of each edge of the hull: inside is normal . p <= offset."""
        equations = ConvexHull(self.points).equations
        return [(row[:2], -float(row[2])) for row in equations]


def group(points: FloatArray, within: float) -> IndexArray:
    """(n,) labels: each point joins the first group whose founder is no further than ``within``."""
    labels = np.full(len(points), -1, np.intp)
    unique, inverse = np.unique(np.round(points / SAME_POINT), axis=0, return_inverse=True)
    unique = unique * SAME_POINT
    found = np.full(len(unique), -1, np.intp)
    count = 0
    for k in range(len(unique)):
        if found[k] < 0:
            near = (found < 0) & (np.hypot(*(unique - unique[k]).T) <= within)
            found[near] = count
            count += 1
    labels[:] = found[inverse.reshape(-1)]
    return labels


def triangulate(points: FloatArray) -> Delaunay | None:
    """Delaunay triangulation, None where the points are too few or on one line."""
    if len(points) < 3 or np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1] < 1e-6:
        return None
    try:
        return Delaunay(points)
    except QhullError:
        return None
