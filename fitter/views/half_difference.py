"""The image of a whole table over Rusinkiewicz's half and difference angles (S. Rusinkiewicz 1998)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.quality.measured import Measured
from fitter.table import Table

FloatArray = NDArray[np.float64]

#: Cells along each axis of the image of a table that is not on a grid in these angles: fewest and most.
FEWEST, MOST = 12, 90
#: Samples that a cell holds on average, where there are that many.
PER_CELL = 4


@dataclass(frozen=True)
class HalfDifference:
    """Mean f_r over phi_d.

    theta_h_deg : (m,), theta_d_deg : (k,) nodes of the table's grid, or middles of cells, even in
    sqrt(theta_h) and in theta_d. values : (k, m, C) in 1/sr, NaN where nothing usable was measured.
    samples : (k, m) how many stand behind each. looked_at : how many in all.
    """

    theta_h_deg: FloatArray
    theta_d_deg: FloatArray
    values: FloatArray
    samples: NDArray[np.int64]
    looked_at: int


def half_difference(table: Table, usable: Measured) -> HalfDifference:
    """The image of a table; ``usable`` are its usable samples, of a large grid those that were drawn."""
    grid = table.grid
    if grid is not None and grid.system == "half_difference":
        return _of_grid(table)
    angles = directions.half_difference_from_vectors(usable.wi, usable.wo)
    theta_h, _, theta_d, _ = (np.rad2deg(angle) for angle in angles)
    per_axis = int(np.clip(np.sqrt(len(theta_h) / PER_CELL), FEWEST, MOST))
    column = np.minimum((np.sqrt(theta_h / 90.0) * per_axis).astype(np.intp), per_axis - 1)
    row = np.minimum((theta_d / 90.0 * per_axis).astype(np.intp), per_axis - 1)
    cell, size = row * per_axis + column, per_axis**2
    count = np.bincount(cell, minlength=size)
    total = np.stack([np.bincount(cell, part, size) for part in usable.value.T], axis=1).astype(np.float64)
    middle = (np.arange(per_axis) + 0.5) / per_axis
    shape = per_axis, per_axis
    return HalfDifference(
        90.0 * middle**2, 90.0 * middle, _mean(total, count).reshape(*shape, -1), count.reshape(shape),
        len(theta_h),
    )  # fmt: skip


def _of_grid(table: Table) -> HalfDifference:
    assert table.grid is not None
    theta_h, theta_d, _ = (np.rad2deg(axis) for axis in table.grid.axes.values())
    shape = table.grid.shape
    mask = table.mask.reshape(shape)
    count = np.asarray(mask.sum(axis=2))
    channels = table.value.reshape(*shape, -1)
    total = np.stack(
        [np.where(mask, channels[..., c], 0.0).sum(axis=2) for c in range(channels.shape[-1])], axis=-1
    )
    values = _mean(total.reshape(-1, total.shape[-1]), count.reshape(-1)).reshape(total.shape)
    return HalfDifference(theta_h, theta_d, values.swapaxes(0, 1), count.T, int(count.sum()))


def _mean(total: FloatArray, count: NDArray[np.int64]) -> FloatArray:
    """(n, C) sums over (n,) counts, NaN where there is nothing."""
    return np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], np.nan)
