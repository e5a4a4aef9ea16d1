"""A weighted sample of rows that pass by once: as many of each stratum as there is room for."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fitter.table import Table

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

#: Edges of the strata: of the angle between the normal and the half vector, and of the incidence (degrees).
HALF = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
INCIDENCE = (15.0, 45.0, 75.0)
STRATA = (len(HALF) + 1) * (len(INCIDENCE) + 1)


@dataclass
class Reservoir:
    """At most ``room`` rows of every stratum, each set of them equally likely.

    A glossy table has few samples in its highlight and most of what determines roughness there: strata by the
    half angle keep them. Every row gets a random key, and those with the smallest keys of each stratum stay.
    The same rows in the same parts and the same ``seed`` give the same sample.
    """

    room: int
    seed: int
    parts: int = 0
    counts: IntArray = field(default_factory=lambda: np.zeros(STRATA, np.intp))
    rows: FloatArray | None = None  # (n, 2 + k): key, stratum, and what is kept of a row

    def add(self, table: Table) -> None:
        """Take note of the usable samples of ``table``."""
        usable = np.flatnonzero(table.mask)
        wi, wo = table.directions(usable)
        stratum = strata(wi, wo)
        self.counts += np.bincount(stratum, minlength=STRATA)
        key = np.random.default_rng([self.seed, self.parts]).random(len(usable))
        self.parts += 1
        # Rows that can't be among the smallest keys of their stratum are not even gathered.
        few = key <= self._limits()[stratum]
        picked = usable[few]
        columns = [wi[few], wo[few], table.value[picked]]
        columns += [] if table.sigma is None else [table.sigma[picked]]
        new: FloatArray = np.column_stack([key[few], stratum[few].astype(np.float64), *columns])
        rows = new if self.rows is None else np.concatenate([self.rows, new])
        order = np.lexsort((rows[:, 0], rows[:, 1]))
        place = np.arange(len(rows)) - np.searchsorted(rows[order, 1], rows[order, 1])
        self.rows = rows[order[place < self.room]]

    def _limits(self) -> FloatArray:
        """(STRATA,) the largest key that a full stratum holds; infinite where there is room."""
        limits = np.full(STRATA, np.inf)
        if self.rows is not None:
            stratum = self.rows[:, 1].astype(np.intp)
            full = np.bincount(stratum, minlength=STRATA) >= self.room
            largest = np.zeros(STRATA)
            np.maximum.at(largest, stratum, self.rows[:, 0])
            limits[full] = largest[full]
        return limits

    @property
    def weight(self) -> FloatArray:
        """(n,) how many usable samples each row stands for; they add up to all."""
        if self.rows is None:
            return np.zeros(0)
        stratum = self.rows[:, 1].astype(np.intp)
        return (self.counts / np.maximum(np.bincount(stratum, minlength=STRATA), 1))[stratum]


def strata(wi: FloatArray, wo: FloatArray) -> IntArray:
    """(n,) the stratum of each pair (n, 3)."""
    half = wi + wo
    cosine = half[:, 2] / np.maximum(np.sqrt(np.einsum("ij,ij->i", half, half)), 1e-300)
    by_half = np.searchsorted(-np.cos(np.deg2rad(HALF)), -cosine)
    return by_half * (len(INCIDENCE) + 1) + np.searchsorted(-np.cos(np.deg2rad(INCIDENCE)), -wi[:, 2])
