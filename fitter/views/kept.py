"""Views of a whole table: found once, then kept, since each looks at every sample."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fitter.quality.checks import SEED
from fitter.quality.measured import Measured
from fitter.report.portrait import Cut, covered, cuts
from fitter.table import Table
from fitter.views.half_difference import HalfDifference, half_difference

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Cuts:
    """Measured samples near the plane of incidence; fields as of :class:`fitter.report.portrait.Portrait`."""

    cuts: tuple[Cut, ...]
    plane_deg: float
    azimuth_deg: float | None


@dataclass(frozen=True)
class Coverage:
    """Samples in cells of theta_i (rows) and theta_o (columns).

    theta_i_deg, theta_o_deg : edges of the cells. usable, masked : counts of what was looked at; of a large
    grid that is a part, drawn with a fixed seed.
    """

    theta_i_deg: FloatArray
    theta_o_deg: FloatArray
    usable: NDArray[np.int64]
    masked: NDArray[np.int64]
    looked_at: int


class Views:
    """The views of one table that need all of it. Safe to share between threads."""

    def __init__(self, table: Table) -> None:
        self._table = table
        self._lock = threading.Lock()

    def cuts(self) -> Cuts:
        """In-plane samples at up to six incidences, as they were measured."""
        with self._lock:
            return self._cuts

    def coverage(self) -> Coverage:
        """Which polar angles were measured."""
        with self._lock:
            return self._coverage

    def half_difference(self) -> HalfDifference:
        """The image over half and difference angle."""
        with self._lock:
            return self._half_difference

    def _usable(self) -> Measured:
        """Not kept: of a scattered table that is as large as the table."""
        return Measured.of(self._table, SEED, usable=True)

    @cached_property
    def _cuts(self) -> Cuts:
        return Cuts(*cuts(self._table))

    @cached_property
    def _coverage(self) -> Coverage:
        usable = self._usable()
        (theta_i, theta_o), counts, masked = covered(self._table, usable, SEED)
        return Coverage(theta_i, theta_o, counts, masked, len(usable.rows))

    @cached_property
    def _half_difference(self) -> HalfDifference:
        return half_difference(self._table, self._usable())
