"""Measured: the samples that are checked, and where the sample nearest to a pair of directions is."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from fitter import directions
from fitter.masking import FILL, HORIZON, MARKED
from fitter.table import Table

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]

#: Of a grid so many cells are looked at where directions are needed, drawn with the seed.
MOST_CELLS = 200_000
#: Of a table with many channels, so many are looked at where every sample is (evenly chosen).
MOST_CHANNELS = 8
#: sin(theta) up to which a direction is the normal: an azimuth there means nothing.
AT_NORMAL = 1e-3
#: Incidences closer than this (radians) are one.
SAME_INCIDENCE = 1e-3
#: An incidence of fewer scattered directions is no scan.
FEWEST_DIRECTIONS = 5
_CHUNK = 1 << 18


@dataclass(frozen=True)
class Measured:
    """What a table measured: finite values above the horizon. Negative and repeated samples count, too.

    keep : (N,) those samples of the table. rows : (n,) the ones whose directions are looked at: all of a
    scattered table, of a grid at most ``MOST_CELLS``. wi, wo : (n, 3); value : (n, C) 1/sr.
    """

    table: Table
    seed: int
    keep: BoolArray
    rows: IndexArray
    wi: FloatArray
    wo: FloatArray
    value: FloatArray

    @staticmethod
    def of(table: Table, seed: int, *, usable: bool = False) -> Measured:
        """Of the measured samples, or with ``usable`` of those only that the table does not mask."""
        keep = table.mask if usable else _measured(table)
        rows = np.flatnonzero(keep)
        if table.grid is not None and len(rows) > MOST_CELLS:
            drawn = np.random.default_rng(seed).choice(len(rows), MOST_CELLS, replace=False)
            rows = rows[np.sort(drawn)]
        wi, wo = table.directions(rows)
        return Measured(table, seed, keep, rows, wi, wo, table.value[rows])

    @property
    def isotropic(self) -> bool:
        return self.table.symmetry == "isotropic"

    @property
    def complete(self) -> bool:
        """Whether every measured sample is among ``rows``."""
        return len(self.rows) == int(self.keep.sum())

    @cached_property
    def level(self) -> FloatArray:
        """(n,) mean of the channels, 1/sr."""
        return np.asarray(self.value.mean(axis=1))

    @cached_property
    def typical(self) -> FloatArray:
        """(C,) median of the absolute values, 1/sr: the scale of each channel."""
        return np.asarray(np.median(np.abs(self.value), axis=0))

    @cached_property
    def channels(self) -> IndexArray:
        """The channels that are looked at where each sample costs time."""
        count = self.value.shape[1]
        return np.unique(np.linspace(0, count - 1, min(count, MOST_CHANNELS)).round().astype(np.intp))

    @cached_property
    def turned(self) -> tuple[FloatArray, FloatArray]:
        """wi and wo in the frame that :func:`turned` describes for isotropic tables, else as they are."""
        return turned(self.wi, self.wo) if self.isotropic else (self.wi, self.wo)

    @cached_property
    def features(self) -> FloatArray:
        """(n, 6) the pair as one point; isotropic pairs that are the same up to a turn coincide."""
        return features(self.wi, self.wo, isotropic=self.isotropic)

    @cached_property
    def scans(self) -> list[IndexArray]:
        """Positions in ``rows`` of the samples of each incidence of a scattered table, the fullest first.

        Incidences of few directions beside full ones (a stray sample, a monitor) are left out.
        """
        wi, _ = self.turned
        theta, phi = directions.spherical_from_vector(wi)
        order = np.argsort(theta, kind="stable")
        ordered = theta[order]
        label = np.zeros(len(theta), np.int64)
        start, ring = 0, 0
        while start < len(order):
            end = int(np.searchsorted(ordered, ordered[start] + SAME_INCIDENCE, "right"))
            label[order[start:end]] = ring
            start, ring = end, ring + 1
        if not self.isotropic:
            arc = np.where(np.sin(theta) > AT_NORMAL, np.mod(phi + 1e-4, 2 * np.pi) - 1e-4, 0.0)
            label = label * 10_000 + np.round(arc / SAME_INCIDENCE).astype(np.int64)
        by_label = np.argsort(label, kind="stable")
        _, first, count = np.unique(label[by_label], return_index=True, return_counts=True)
        full = np.flatnonzero(count >= max(FEWEST_DIRECTIONS, 0.05 * count.max()))
        full = full[np.argsort(-count[full], kind="stable")]
        return [by_label[first[k] : first[k] + count[k]] for k in full]

    def draw(self, most: int) -> IndexArray:
        """At most ``most`` of ``rows``, as positions in it, drawn with the seed."""
        n = len(self.rows)
        if n <= most:
            return np.arange(n)
        return np.sort(np.random.default_rng(self.seed + 1).choice(n, most, replace=False))

    @cached_property
    def tree(self) -> KDTree:
        return KDTree(self.features)

    def nearest(
        self, wi: FloatArray, wo: FloatArray, *, isotropic: bool | None = None
    ) -> tuple[IndexArray, FloatArray]:
        """The measured sample nearest to each pair: its row in the table, and the distance (radians).

        The distance is that of both directions together; infinite where the grid has no measured cell.
        ``isotropic`` False tells apart pairs that differ by a turn about the normal.
        """
        alike = self.isotropic if isotropic is None else isotropic
        wanted = features(wi, wo, isotropic=alike)
        if self.table.grid is None:
            own = alike == self.isotropic
            tree = self.tree if own else KDTree(features(self.wi, self.wo, isotropic=alike))
            distance, position = tree.query(wanted)
            return self.rows[np.asarray(position, np.intp)], np.asarray(distance)
        row = self._cell(wi, wo)
        found = features(*self.table.directions(row), isotropic=alike)
        distance = np.linalg.norm(found - wanted, axis=1)
        return row, np.where(self.keep[row], distance, np.inf)

    def _cell(self, wi: FloatArray, wo: FloatArray) -> IndexArray:
        """The node of the grid nearest to each pair along every axis, as a row of the table."""
        grid = self.table.grid
        assert grid is not None
        index: list[IndexArray] = []
        for (name, axis), x in zip(grid.axes.items(), grid.locate(wi, wo), strict=True):
            at = np.clip(np.searchsorted(axis, x), 1, max(len(axis) - 1, 1))
            low, high = at - 1, np.minimum(at, len(axis) - 1)
            nearest = np.where(x - axis[low] <= axis[high] - x, low, high)
            period = grid.periodic.get(name)
            if period is not None:
                wraps = axis[0] + period - x < x - axis[-1]
                nearest = np.where(wraps, 0, nearest)
            index.append(nearest)
        return np.ravel_multi_index(tuple(index), grid.shape).astype(np.intp)


def _measured(table: Table) -> BoolArray:
    """(N,) usable samples, and with them those left out only as negative or repeated."""
    keep = table.mask.copy()
    out = ~keep & np.isfinite(table.value).all(axis=1)
    if table.metadata.masked.get(MARKED) or (table.fills is None and table.metadata.masked.get(FILL)):
        return keep  # which of them the source meant is not recorded
    out &= (table.value < 0).any(axis=1) | table.repeats
    if table.fills is not None:
        out &= ~table.fills
    rows = np.flatnonzero(out)
    for start in range(0, len(rows), _CHUNK):
        part = rows[start : start + _CHUNK]
        wi, wo = table.directions(part)
        keep[part] = (wi[:, 2] > HORIZON) & (wo[:, 2] >= HORIZON)
    return keep


def turned(wi: FloatArray, wo: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Both (n, 3) turned about the normal until wi has azimuth 0, and wo where wi is the normal."""
    lead = np.where((np.hypot(wi[:, 0], wi[:, 1]) > AT_NORMAL)[:, None], wi, wo)
    length = np.hypot(lead[:, 0], lead[:, 1])
    safe = np.where(length > 0, length, 1.0)
    c = np.where(length > 0, lead[:, 0] / safe, 1.0)
    s = np.where(length > 0, lead[:, 1] / safe, 0.0)
    return directions.turned(wi, c, -s), directions.turned(wo, c, -s)


def features(wi: FloatArray, wo: FloatArray, *, isotropic: bool) -> FloatArray:
    """(n, 6) pairs as points whose distances are angles, where small.

    An isotropic surface does not change when it is turned about its normal or mirrored in the plane of
    incidence: such pairs become one point.
    """
    if isotropic:
        wi, wo = turned(wi, wo)
        wo = np.stack([wo[:, 0], np.abs(wo[:, 1]), wo[:, 2]], axis=1)
    return np.concatenate([wi, wo], axis=1)
