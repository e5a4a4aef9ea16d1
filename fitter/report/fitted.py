"""The samples a fit was made to, seen by the report: selection, channels, a seeded subsample."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fitter.compression import CompressedTable
from fitter.metadata import Channel
from fitter.report.plane import spread
from fitter.table import Table

if TYPE_CHECKING:
    from fitter.fitting.result import FitResult
    from fitter.posterior.result import Posterior

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

#: Figures show at most so many channels: the first, the last, and evenly spaced ones between them.
MOST_CHANNELS = 4
#: Samples that residual statistics use at most, and points that a figure shows at most.
MOST_SAMPLES = 20_000
MOST_POINTS = 2_500


@dataclass(frozen=True)
class Fitted:
    """A table and a fit of it, with the fit's selection of samples and channels.

    columns : position in the table of each of the model's C channels.
    """

    table: Table
    fit: FitResult
    columns: tuple[int, ...]

    @staticmethod
    def of(table: Table | CompressedTable, fit: FitResult) -> Fitted:
        """Match channels by name. Raises SpecError where the fit has channels that the table has not."""
        whole = table.decompress() if isinstance(table, CompressedTable) else table
        return Fitted(whole, fit, fit.columns_of(whole))

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The table's channels in the order of the model's."""
        return tuple(self.table.channels[c] for c in self.columns)

    @cached_property
    def estimates(self) -> dict[str, float]:
        """The value of every parameter, fixed ones too, by flat label."""
        found: dict[str, float] = {}
        for name, e in self.fit.parameters.items():
            channels = self.fit.model.channels if e.value.ndim else (None,)
            found |= {
                label_of(name, c): float(v) for c, v in zip(channels, np.atleast_1d(e.value), strict=True)
            }
        return found

    @cached_property
    def shown(self) -> tuple[int, ...]:
        """Positions, among the model's channels, of those that figures show."""
        return spread(len(self.columns), MOST_CHANNELS)

    @cached_property
    def index(self) -> IndexArray:
        """Rows of the table that are usable and selected by the fit's specification."""
        index = np.flatnonzero(self.table.mask)
        select = self.fit.spec.select
        limits = (select.theta_i_max_deg, select.theta_o_max_deg)
        if limits == (None, None):
            return index
        for limit, w in zip(limits, self.table.directions(index), strict=True):
            if limit is not None:
                # A row left out by one limit keeps its place until both are known.
                index = np.where(w[:, 2] >= np.cos(np.deg2rad(limit)) - 1e-12, index, -1)
        return index[index >= 0]

    def values(self, index: IndexArray) -> FloatArray:
        """(n, C) measured values of rows ``index``, 1/sr, in the order of the model's channels."""
        return self.table.value[index][:, list(self.columns)]

    def sigma(self, index: IndexArray) -> FloatArray | None:
        """(n, C) stated standard uncertainties, 1/sr, or None."""
        return None if self.table.sigma is None else self.table.sigma[index][:, list(self.columns)]

    def subsample(self, size: int, seed: int) -> IndexArray:
        """At most ``size`` of :attr:`index`, drawn without replacement with ``seed``, in order."""
        return thin(self.index, size, seed)


def thin(index: IndexArray, size: int, seed: int) -> IndexArray:
    """At most ``size`` entries of ``index``, drawn without replacement, in order."""
    if len(index) <= size:
        return index
    return np.sort(np.random.default_rng(seed).choice(index, size, replace=False))


def restricted(posterior: Posterior, channels: tuple[str, ...]) -> Posterior:
    """The posterior of these channels only: a prediction then costs no more than what is shown."""
    template = posterior.template
    if channels == template.channels:
        return posterior
    where = [template.channels.index(name) for name in channels]
    values = {name: v[np.array(where)] if v.ndim else v for name, v in template.values.items()}
    keep = [k for k, label in enumerate(posterior.labels) if _channel(label) in (None, *channels)]
    return replace(
        posterior,
        template=type(template)(spec=template.spec, channels=channels, values=values),
        labels=tuple(posterior.labels[k] for k in keep),
        draws=posterior.draws[:, keep],
    )


def label_of(name: str, channel: str | None) -> str:
    """The flat label of a parameter: "alpha" shared, "ks[G]" per channel."""
    return name if channel is None else f"{name}[{channel}]"


def display(label: str, channels: tuple[str, ...]) -> str:
    """The label for people: without the channel where there is only one."""
    return label.partition("[")[0] if len(channels) == 1 else label


def _channel(label: str) -> str | None:
    _, bracket, rest = label.partition("[")
    return rest.removesuffix("]") if bracket else None
