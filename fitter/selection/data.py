"""Data: what a comparison of models sees of a table, and the error of a prediction of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitter.fitting import metrics
from fitter.fitting.samples import Usable
from fitter.fitting.usable import usable
from fitter.selection.blocks import Blocks, blocks
from fitter.spec import Metric, SelectionSpec
from fitter.table import Table

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]

#: Samples that are compared on; of more, each block gives its share.
MOST = 6_144
#: Errors below this part of the values are rounding: two models that exact are equal.
EXACT = 1e-9


@dataclass(frozen=True)
class Data:
    """A table as it is compared on.

    used : all usable, selected samples. blocks : of those. rows : (m,) positions among them that models are
    fitted to and judged on.
    """

    table: Table
    metric: Metric
    used: Usable
    blocks: Blocks
    rows: IndexArray
    seed: int

    @staticmethod
    def of(table: Table, spec: SelectionSpec) -> Data:
        """Raises SpecError or FitError where nothing can be fitted."""
        metric = spec.metric or metrics.default(table.sigma is not None)
        used = usable(table, metric, spec.select)
        isotropic = table.symmetry == "isotropic"
        dealt = blocks(used.pair[:3].T, used.pair[3:].T, spec.folds, isotropic=isotropic)
        return Data(table, metric, used, dealt, _drawn(dealt.block, MOST, spec.seed), spec.seed)

    @property
    def whole(self) -> bool:
        """Whether the comparison is made on all samples."""
        return len(self.rows) == len(self.used)

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(self.table.channels[c].name for c in self.used.channels)

    @property
    def fold(self) -> IndexArray:
        """(m,) fold of each compared sample."""
        return self.blocks.fold[self.rows]

    def directions(self, rows: IndexArray) -> tuple[FloatArray, FloatArray]:
        """wi and wo, (n, 3) each, of samples ``rows``."""
        return self.used.pair[:3, rows].T, self.used.pair[3:, rows].T

    def part(self, rows: IndexArray) -> Table:
        """A table of samples ``rows`` alone, of the fitted channels."""
        wi, wo = self.directions(rows)
        sigma = self.used.sigma
        return Table(
            wi=wi, wo=wo, value=self.used.value[rows], sigma=None if sigma is None else sigma[rows],
            channels=[self.table.channels[c] for c in self.used.channels], symmetry=self.table.symmetry,
            metadata=self.table.metadata, negatives="keep", duplicates="keep",
        )  # fmt: skip

    def residuals(self, rows: IndexArray, predicted: FloatArray) -> FloatArray:
        """(n, C) residuals, in the metric, of predictions (n, C) of samples ``rows``."""
        value, weight, floor = self.used.value[rows], self.used.weight[rows], self.used.floor
        arrays = (jnp.asarray(array) for array in (predicted, value, weight, floor))
        return np.asarray(metrics.residual(self.metric, *arrays).value)

    def errors(self, rows: IndexArray, residuals: FloatArray) -> FloatArray:
        """(K,) root mean square of residuals (n, C) of samples ``rows`` in each fold."""
        folds = max(self.blocks.folds, 1)
        fold = self.blocks.fold[rows]
        count = np.bincount(fold, minlength=folds) * residuals.shape[1]
        total = np.bincount(fold, np.square(residuals).sum(axis=1), minlength=folds)
        with np.errstate(invalid="ignore"):
            return np.maximum(np.sqrt(total / count), self.exact)

    def relative(self, rows: IndexArray, predicted: FloatArray) -> float:
        """Median of |f - y|/(|y| + 1 % of the channel's median |y|)."""
        value = self.used.value[rows]
        near_zero = 0.01 / metrics.LOG_FLOOR * self.used.floor
        return float(np.median(np.abs(predicted - value) / (np.abs(value) + near_zero)))

    @cached_property
    def exact(self) -> float:
        value, weight, floor = self.used.value[self.rows], self.used.weight[self.rows], self.used.floor
        arrays = (jnp.asarray(array) for array in (value, weight, floor))
        goal = np.asarray(metrics.target(self.metric, *arrays))
        return max(EXACT * float(np.sqrt(np.mean(np.square(goal)))), 1e-300)

    def noise(self, rows: IndexArray, relative: float | None) -> FloatArray | None:
        """(n, C) standard deviations, in the metric, of the values of samples ``rows``: from the table's
        sigma, else from a ``relative`` one, else None."""
        value = self.used.value[rows]
        if self.used.sigma is not None:
            deviation = self.used.sigma[rows]
        elif relative is not None:
            deviation = relative * np.abs(value)
        else:
            return None
        weight = self.used.weight[rows]
        return deviation * np.asarray(
            metrics.linearised_weight(self.metric, value, weight, self.used.floor)
        )


def held_out(data: Data, fold: int) -> tuple[IndexArray, IndexArray]:
    """Samples that are fitted to and samples that are predicted, as positions among the usable ones."""
    mine = data.fold == fold
    return data.rows[~mine], data.rows[mine]


def _drawn(block: IndexArray, most: int, seed: int) -> IndexArray:
    """At most about ``most`` positions, from each block its share, in order."""
    if len(block) <= most:
        return np.arange(len(block))
    rng = np.random.default_rng(seed)
    chosen: Sequence[IndexArray] = [
        rng.choice(mine, max(1, round(most * len(mine) / len(block))), replace=False)
        for mine in (np.flatnonzero(block == b) for b in range(int(block.max()) + 1))
    ]
    return np.sort(np.concatenate(chosen))
