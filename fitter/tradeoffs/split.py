"""Which samples judge: whole blocks of incidences, held out of every fit.

Neighbouring samples share their errors and their shape, so that a random tenth of them would be foreseen by
what lies beside it. An incidence that no fit saw is what a user asks a model for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.table import Table

FloatArray = NDArray[np.float64]
#: Bands of incidence where a table has many, and those that are held out.
BANDS = 10
HELD_OUT = (3, 7)
#: Samples that judge at most; a random choice of them where there are more.
MOST = 20_000


@dataclass(frozen=True)
class Split:
    """fitted : the table without the held-out samples. wi, wo : (m, 3), value : (m, C), those that judge.

    incidences_deg : the ranges of theta_i held out.
    """

    fitted: Table
    wi: FloatArray
    wo: FloatArray
    value: FloatArray
    held_out: int
    incidences_deg: tuple[tuple[float, float], ...]


def split(table: Table, seed: int) -> Split | None:
    """The split of a table; None where it has too few incidences to do without one."""
    index = np.flatnonzero(table.mask)
    wi, wo = table.directions(index)
    theta, _ = directions.spherical_from_vector(wi)
    held = _held_out(theta)
    if held is None or held.all() or not held.any():
        return None
    mask = table.mask.copy()
    mask[index[held]] = False
    scattered = table.grid is None
    fitted = Table(
        wi=table.wi if scattered else None, wo=table.wo if scattered else None, grid=table.grid,
        value=table.value, sigma=table.sigma, channels=table.channels, mask=mask, symmetry=table.symmetry,
        metadata=table.metadata, negatives="keep", duplicates="keep",
    )  # fmt: skip
    where = np.flatnonzero(held)
    judging = where
    if len(where) > MOST:
        judging = np.sort(np.random.default_rng(seed).choice(where, MOST, replace=False))
    return Split(
        fitted, wi[judging], wo[judging], table.value[index[judging]], len(where), _ranges(theta, held)
    )  # fmt: skip


def _held_out(theta: FloatArray) -> NDArray[np.bool_] | None:
    """(n,) which samples are held out; never the first or the last incidence: that would be extrapolation."""
    key = np.rint(np.rad2deg(theta) * 10).astype(np.int64)
    found, counts = np.unique(key, return_counts=True)
    if len(found) < 3:
        return None
    if len(found) <= 2 * BANDS:
        picked = found[1:-1][:: max(2, len(found) // 2)] if len(found) > 4 else found[[len(found) // 2]]
        return np.isin(key, picked)
    # Bands of equal numbers of samples.
    band = (BANDS * (np.cumsum(counts) - 1) // counts.sum()).astype(int)
    return np.isin(key, found[np.isin(band, HELD_OUT)])


def _ranges(theta: FloatArray, held: NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """The held-out ranges of incidence, in degrees."""
    degrees = np.rint(np.rad2deg(theta) * 10) / 10
    ranges: list[tuple[float, float]] = []
    outside = np.unique(degrees[~held])
    for value in np.unique(degrees[held]).tolist():
        if ranges and not ((outside > ranges[-1][1]) & (outside < value)).any():
            ranges[-1] = (ranges[-1][0], value)
        else:
            ranges.append((value, value))
    return tuple(ranges)
