"""What the raw table predicts of itself: the error that a model has to beat to be worth having.

A table that is used as it is stands for its interpolant. Held out like a model's samples, a block of it is
predicted from the other blocks; a grid, whose nodes lie too close together for that to be fair, from every
other node along one axis, the axis that does worst. Both ask more of the interpolant than its use will.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter.errors import TableError
from fitter.grid import Grid
from fitter.quality import noise
from fitter.quality.measured import Measured
from fitter.sampling.grid import GridInterpolant
from fitter.sampling.scattered import ScatteredInterpolant
from fitter.selection.compare import score
from fitter.selection.data import Data
from fitter.table import Table

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

#: More scattered samples than this are not triangulated again for each block.
MOST_SCATTERED = 200_000
#: A fold with fewer predicted samples, and an axis with fewer nodes, is not judged by; nor is a table with
#: fewer such folds.
FEWEST_SAMPLES, FEWEST_NODES, FEWEST_FOLDS = 5, 5, 3
_PREDICTED = 4_096


@dataclass(frozen=True)
class RawPrediction:
    """Samples ``rows`` (m,) (positions among the usable ones) predicted by the table itself, (m, C) 1/sr;
    ``words`` : from what."""

    rows: IndexArray
    value: FloatArray
    words: str

    def errors(self, data: Data) -> FloatArray:
        """(K,) root mean square residual in the metric, of each fold; NaN where it has no sample."""
        return data.errors(self.rows, data.residuals(self.rows, self.value))

    def folds(self, data: Data) -> IndexArray:
        """The folds with samples enough to be judged by."""
        counts = np.bincount(data.blocks.fold[self.rows], minlength=data.blocks.folds)
        return np.flatnonzero(counts >= FEWEST_SAMPLES)

    def error(self, data: Data) -> float:
        """The geometric mean of the errors of those folds."""
        return score(self.errors(data)[self.folds(data)])


def raw_prediction(data: Data) -> RawPrediction | str:
    """The prediction of the table by itself, or why there is none."""
    if data.blocks.kind is None:
        return "no scan can be held out"
    found = _grid(data) if data.table.grid is not None else _scattered(data)
    if isinstance(found, str) or _enough(found, data):
        return found
    return "the table's interpolant reaches too few of the held-out samples"


def repeatability(table: Table, seed: int) -> float | None:
    """Relative standard deviation of repeated geometries, None where too few were measured twice."""
    found = noise.scatter(Measured.of(table, seed))
    if found is None or found.degrees < noise.FEWEST_DEGREES or not np.isfinite(found.relative):
        return None
    return found.relative


def _scattered(data: Data) -> RawPrediction | str:
    if len(data.used) > MOST_SCATTERED:
        return f"{len(data.used)} scattered samples are too many to be interpolated again for each block"
    isotropic = data.table.symmetry == "isotropic"
    rows: list[IndexArray] = []
    values: list[FloatArray] = []
    block = data.blocks.block
    for b in range(data.blocks.count):
        wanted = data.rows[block[data.rows] == b]
        wi, wo = data.directions(np.flatnonzero(block != b))
        try:
            made = ScatteredInterpolant.build(wi, wo, data.used.value[block != b], isotropic=isotropic)
            value, extrapolated = made.evaluate(*data.directions(wanted))
        except TableError as error:
            return f"the table can't be interpolated: {error.message}"
        rows.append(wanted[~extrapolated])
        values.append(value[~extrapolated])
    return RawPrediction(np.concatenate(rows), np.concatenate(values), "each block from the others")


def _grid(data: Data) -> RawPrediction | str:
    grid = data.table.grid
    assert grid is not None
    some = np.arange(len(data.used))
    if len(some) > 8 * _PREDICTED:
        some = np.sort(np.random.default_rng(data.seed).choice(len(some), 8 * _PREDICTED, replace=False))
    wi, wo = data.directions(some)
    columns = list(data.used.channels)
    shape = (*grid.shape, len(data.table.channels))
    value, mask = data.table.value.reshape(shape), data.table.mask.reshape(grid.shape)
    worst: RawPrediction | None = None
    for k, ((name, axis), x) in enumerate(zip(grid.axes.items(), grid.locate(wi, wo), strict=True)):
        if len(axis) < FEWEST_NODES:
            continue
        above = np.clip(np.searchsorted(axis, x), 1, len(axis) - 1)
        node = np.where(x - axis[above - 1] <= axis[above] - x, above - 1, above)
        wanted = np.flatnonzero(node % 2 == 1)
        wanted = wanted[:: max(1, len(wanted) // _PREDICTED)]
        every = tuple(slice(None, None, 2) if j == k else slice(None) for j in range(len(grid.shape)))
        axes = {**grid.axes, name: axis[::2]}
        coarse = GridInterpolant(
            Grid(grid.system, axes, grid.periodic), value[every][..., columns].reshape(-1, len(columns)),
            mask[every].reshape(-1),
        )  # fmt: skip
        predicted, extrapolated = coarse.evaluate(wi[wanted], wo[wanted])
        words = f"every other node of {name} from its neighbours"
        found = RawPrediction(some[wanted[~extrapolated]], predicted[~extrapolated], words)
        if _enough(found, data) and (worst is None or found.error(data) > worst.error(data)):
            worst = found
    return worst or "no axis of the grid has enough nodes"


def _enough(found: RawPrediction, data: Data) -> bool:
    return len(found.folds(data)) >= FEWEST_FOLDS
