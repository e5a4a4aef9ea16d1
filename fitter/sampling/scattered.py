"""The interpolant of a scattered table: triangulated scans, shifted between incidences.

At a measured incidence f_r is piecewise linear on the Delaunay triangulation of the scattered directions in
the projected disk. Between incidences the scans around wi are shifted in the disk so that their features
fall together, and blended linearly, so that a peak moves instead of being doubled. Scatter depends on
direction cosines mostly through the distance from the specular direction (J. E. Harvey and R. V. Shack 1978,
"Aberrations of diffracted wave fields"); the peak of a retro-reflector moves the other way; a diffuse
surface's values, and the forward peak at grazing angles, stay where they are. Which of the three holds
between neighbouring scans is decided by them: the one with which they predict each other best.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitter import directions
from fitter.errors import TableError
from fitter.sampling.envelope import Envelope, JointEnvelope, Method
from fitter.sampling.interpolant import in_chunks, pairs
from fitter.sampling.scans import PLANE, Scan, group, triangulate

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]

# Incidences closer than this on the disk are one scan: gonioreflectometers repeat to about 1e-4.
_SAME_SCAN = 5e-4
_CHUNK = 1 << 17


@dataclass(frozen=True)
class ScatteredInterpolant:
    """scans : those that can be interpolated, or all where most samples are in scans that can't."""

    scans: tuple[Scan, ...]
    isotropic: bool

    def motion(self, bracket: int) -> int:
        """How features follow wi on the disk between the scans of a bracket.

        -1 with the specular direction, 1 with wi itself (retro-reflection), 0 not at all: whichever lets
        the bracket's scans predict each other best (least sum of absolute differences).
        """
        if bracket not in self._motions:
            self._motions[bracket] = self._best_motion(self.brackets[bracket])
        return self._motions[bracket]

    @cached_property
    def _motions(self) -> dict[int, int]:
        return {}

    @property
    def brackets(self) -> NDArray[np.intp]:
        """(B, 2 or 3) indices of the scans that incidences between them are blended from."""
        if self._mesh is not None:
            return self._mesh.simplices.astype(np.intp)
        first = np.arange(max(len(self.scans) - 1, 1))
        return np.stack([first, np.minimum(first + 1, len(self.scans) - 1)], axis=1)

    def _best_motion(self, bracket: NDArray[np.intp]) -> int:
        missed: dict[int, float] = dict.fromkeys((-1, 0, 1), 0.0)
        for scan, other in permutations((self.scans[k] for k in bracket), 2):
            step = other.incidence - scan.incidence
            found = {m: scan.evaluate(other.points - m * step) for m in missed}
            common = np.logical_and.reduce([inside for _, inside in found.values()])
            for m, (value, _) in found.items():
                missed[m] += float(np.abs(value - other.value)[common].sum())
        return min(missed, key=lambda m: missed[m])

    def shift(self, wi: FloatArray, scan: Scan, bracket: IndexArray) -> FloatArray:
        """(M, 2) by how much ``scan`` is shifted on the disk for incidences wi (M, 2); 0 where they agree."""
        step = wi - scan.incidence
        away = np.hypot(step[:, 0], step[:, 1]) > _SAME_SCAN
        shift = np.zeros_like(step)
        for b in np.unique(bracket[away]):
            mine = away & (bracket == b)
            shift[mine] = self.motion(int(b)) * step[mine]
        return shift

    @classmethod
    def build(
        cls, wi: FloatArray, wo: FloatArray, value: FloatArray, *, isotropic: bool
    ) -> ScatteredInterpolant:
        """From usable samples: wi, wo (N, 3), value (N, C).

        Isotropic tables are turned so that wi has azimuth 0 and, where only one side of the plane of
        incidence was measured, mirrored to the other: an isotropic surface is mirror-symmetric.
        """
        if isotropic:
            wi, wo = _turned(wi, wo)
        labels = group(wi[:, :2], _SAME_SCAN)
        scans: list[Scan] = []
        for label in range(int(labels.max()) + 1):
            mine = labels == label
            points, values = wo[mine, :2], value[mine]
            if isotropic and not ((points[:, 1] > PLANE).any() and (points[:, 1] < -PLANE).any()):
                points = np.concatenate([points, points * np.array([1.0, -1.0])])
                values = np.concatenate([values, values])
            scans.append(Scan.build(wi[mine, :2].mean(axis=0), points, values))
        # What most samples belong to decides; a stray direction beside full scans is no scan of its own.
        for kind in ("area", "line"):
            chosen = [scan for scan in scans if scan.kind == kind]
            if 2 * sum(len(scan.points) for scan in chosen) >= sum(len(scan.points) for scan in scans):
                scans = chosen
                break
        if isotropic:
            scans.sort(key=lambda scan: float(scan.incidence[0]))
        return cls(tuple(scans), isotropic)

    def __getstate__(self) -> dict[str, Any]:
        return {"scans": self.scans, "isotropic": self.isotropic}

    @property
    def in_plane(self) -> bool:
        return all(scan.kind == "line" for scan in self.scans)

    @cached_property
    def _incidences(self) -> FloatArray:
        return np.stack([scan.incidence for scan in self.scans])

    @cached_property
    def _mesh(self) -> Any:
        return None if self.isotropic else triangulate(self._incidences)

    def around(self, wi: FloatArray) -> tuple[IndexArray, FloatArray, IndexArray, BoolArray]:
        """``(scan indices (M, 3), weights (M, 3), bracket (M,), measured (M,))`` of incidences (M, 3).

        Isotropic: the two neighbours, linear in theta_i. Anisotropic: the three incidences whose triangle on
        the disk holds wi. Outside the measured incidences: the nearest scan alone, measured False.
        """
        index = np.zeros((len(wi), 3), np.intp)
        weight = np.zeros((len(wi), 3))
        bracket = np.zeros(len(wi), np.intp)
        if self.isotropic:
            theta = np.arctan2(wi[:, 0], wi[:, 2])
            nodes = np.arcsin(np.clip(self._incidences[:, 0], 0.0, 1.0))
            above = np.clip(np.searchsorted(nodes, theta), 1, max(len(nodes) - 1, 1))
            low, high = above - 1, np.minimum(above, len(nodes) - 1)
            bracket = low
            width = np.where(nodes[high] > nodes[low], nodes[high] - nodes[low], np.inf)
            t = np.clip((theta - nodes[low]) / width, 0.0, 1.0)
            index[:, 0], index[:, 1] = low, high
            weight[:, 0], weight[:, 1] = 1.0 - t, t
            measured = (theta >= nodes[0] - _SAME_SCAN) & (theta <= nodes[-1] + _SAME_SCAN)
        elif self._mesh is not None:
            triangle = self._mesh.find_simplex(wi[:, :2], tol=1e-9)
            affine = self._mesh.transform[triangle]
            first = np.einsum("mij,mj->mi", affine[:, :2], wi[:, :2] - affine[:, 2])
            measured = (triangle >= 0) & np.isfinite(first).all(axis=1)
            index = self._mesh.simplices[triangle].astype(np.intp)
            bracket = np.maximum(triangle, 0)
            share = np.concatenate([first, 1.0 - first.sum(axis=1, keepdims=True)], axis=1)
            weight = np.clip(np.where(measured[:, None], share, 0.0), 0.0, 1.0)
        else:
            measured = np.zeros(len(wi), bool)
        self._snap(wi, index, weight, measured)
        return index, weight / weight.sum(axis=1, keepdims=True), bracket, measured

    def _snap(self, wi: FloatArray, index: IndexArray, weight: FloatArray, measured: BoolArray) -> None:
        """At a measured incidence that scan alone; outside the measured ones the nearest, as it is."""
        x = wi[:, :1] - self._incidences[None, :, 0]
        y = wi[:, 1:2] - self._incidences[None, :, 1]
        distance = np.hypot(x, y)
        nearest = np.argmin(distance, axis=1)
        at = distance[np.arange(len(wi)), nearest] <= _SAME_SCAN
        measured |= at
        alone = at | ~measured
        index[alone, 0] = nearest[alone]
        weight[alone] = [1.0, 0.0, 0.0]

    def evaluate(self, wi: ArrayLike, wo: ArrayLike) -> tuple[FloatArray, BoolArray]:
        """``(values, extrapolated)``, (M, C) in 1/sr and (M,), of direction pairs (M, 3) or (3,)."""
        return in_chunks(self._evaluate, wi, wo, self.scans[0].value.shape[1], _CHUNK)

    def _evaluate(self, wi: FloatArray, wo: FloatArray) -> tuple[FloatArray, BoolArray]:
        if self.isotropic:
            wi, wo = _turned(wi, wo)
        index, weight, bracket, measured = self.around(wi)
        total = np.zeros((len(wi), self.scans[0].value.shape[1]))
        extrapolated = ~measured | (wi[:, 2] <= 0) | (wo[:, 2] <= 0)
        for k in range(index.shape[1]):
            used = weight[:, k] > 0
            for which in np.unique(index[used, k]):
                scan = self.scans[which]
                mine = np.flatnonzero(used & (index[:, k] == which))
                shift = self.shift(wi[mine, :2], scan, bracket[mine])
                found, inside = scan.evaluate(wo[mine, :2] - shift)
                total[mine] += weight[mine, k, None] * found
                extrapolated[mine] |= ~inside
        return total, extrapolated

    def slice(self, wi: ArrayLike) -> ScatteredSlice:
        """The interpolant at the one incidence ``wi`` (3,)."""
        w = pairs(wi, wi)[0][:1]
        rotation = float(directions.spherical_from_vector(w)[1][0]) if self.isotropic else 0.0
        if self.isotropic:
            w, _ = _turned(w, w)
        index, weight, bracket, measured = self.around(w)
        parts = tuple(
            Part(float(a), self.scans[k], self.shift(w[:, :2], self.scans[k], bracket)[0])
            for k, a in zip(index[0], weight[0], strict=True)
            if a > 0
        )
        return ScatteredSlice(parts, rotation, not bool(measured[0]) or bool(w[0, 2] <= 0))

    def joint(
        self, weights: FloatArray, acceptance: float, cells: int, method: Method | None
    ) -> JointEnvelope:
        """What pairs (wi, wo) are drawn from."""
        from fitter.sampling.joint import of_scattered

        return of_scattered(self, weights, acceptance, cells, method or "inversion")


@dataclass(frozen=True)
class Part:
    """One scan of a slice: its weight, and by how much it is shifted on the disk."""

    weight: float
    scan: Scan
    shift: FloatArray


@dataclass(frozen=True)
class ScatteredSlice:
    """One incidence: a blend of shifted scans, defined where all of them are."""

    parts: tuple[Part, ...]
    rotation: float
    extrapolated: bool
    preferred: Method = "inversion"

    def envelope(self, weights: FloatArray, acceptance: float, cells: int, method: Method) -> Envelope:
        from fitter.sampling.triangles import TriangleEnvelope

        if any(part.scan.kind != "area" for part in self.parts):
            raise TableError(
                "the scattered directions of this table don't cover a region that could be drawn from",
                code="table-few-directions", cause="too few directions per incidence to span triangles",
                remedy="fit a model and draw from that",
            )  # fmt: skip
        return TriangleEnvelope(self, weights, acceptance, cells, method)


def _turned(wi: FloatArray, wo: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Both turned about the normal until wi has azimuth 0; left alone at normal incidence."""
    length = np.hypot(wi[:, 0], wi[:, 1])
    safe = np.where(length > 0, length, 1.0)
    c = np.where(length > 0, wi[:, 0] / safe, 1.0)
    s = np.where(length > 0, wi[:, 1] / safe, 0.0)
    return directions.turned(wi, c, -s), directions.turned(wo, c, -s)
