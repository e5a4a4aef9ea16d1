"""The usable samples of a table as blocks of component arrays, whole or a weighted subset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.errors import FitError, SpecError
from fitter.fitting import metrics
from fitter.spec import Metric, Select
from fitter.table import Table

FloatArray = NDArray[np.float64]
#: Samples a block holds. One length for all, so that one program serves every table.
BLOCK = 65_536
#: Values beyond this, either way, are refused.
LARGEST = 1e60


def padded(samples: int) -> int:
    """What a subset of so many samples is padded to: a power of two, so that few lengths are compiled for."""
    return max(1024, 1 << (samples - 1).bit_length())


@dataclass(frozen=True)
class Block:
    """Samples padded to BLOCK; padding has weight 0.

    pair : (6, B) components of wi and wo. y, weight : (B, C), and goal, the metric's target of y.
    count : samples that are not padding.
    """

    pair: FloatArray
    y: FloatArray
    goal: FloatArray
    weight: FloatArray
    count: int


@dataclass(frozen=True)
class Usable:
    """What a fit uses of a table: arrays over its n usable, selected samples.

    pair : (6, n). value, weight : (n, C), weight w s of the metric. floor : (C,) of the metric.
    metric : whose weights they are. channels : positions in the table.
    left_out : counts by reason of usable samples not used.
    """

    metric: Metric
    pair: FloatArray
    value: FloatArray
    sigma: FloatArray | None
    weight: FloatArray
    floor: FloatArray
    channels: tuple[int, ...]
    left_out: dict[str, int]

    def __len__(self) -> int:
        return self.pair.shape[1]

    def part(
        self,
        channels: Sequence[int],
        rows: slice | NDArray[np.intp],
        size: int,
        scale: FloatArray | None = None,
    ) -> Block:
        """The samples ``rows`` of the channels (positions among the selected), padded to ``size``.

        ``scale`` multiplies the squared residuals of the samples of a weighted subset.
        """
        picked = list(channels)
        # Basic slices of whole columns are views; a list of channels would copy the table.
        columns: slice | list[int] = slice(None) if picked == list(range(self.value.shape[1])) else picked
        weight = self.weight[rows][:, columns]
        if scale is not None:
            weight = weight * metrics.scaling(self.metric, scale)[:, None]
        value = self.value[rows][:, columns]
        return Block(
            pair=_padded(self.pair[:, rows].T, size, edge=True).T,
            y=_padded(value, size),
            goal=_padded(metrics.target(self.metric, value, weight, self.floor[picked]), size),
            weight=_padded(weight, size),
            count=len(weight),
        )

    def blocks(self, channels: Sequence[int]) -> list[Block]:
        """All samples of the channels."""
        return [
            self.part(channels, slice(start, min(start + BLOCK, len(self))), BLOCK)
            for start in range(0, len(self), BLOCK)
        ]

    def subset(self, size: int, seed: int) -> tuple[NDArray[np.intp], FloatArray]:
        """Indices and weights of a systematic sample, half uniform, half by weighted squared value.

        Systematic sampling with probability proportional to size: a sample taken k times with
        inclusion probability m p stands for k/(m p) samples.
        """
        n = len(self)
        if n <= size:
            return np.arange(n), np.ones(n)
        energy = np.square(self.weight * self.value).sum(axis=1)
        # No sample counts for more than 100 times its share: glints must not fill the subset.
        energy = np.minimum(energy, 100 * energy.mean())
        p = 0.5 / n + 0.5 * energy / max(energy.sum(), 1e-300)
        p /= p.sum()
        offset = np.random.default_rng(seed).random()
        picked = np.searchsorted(np.cumsum(p), (np.arange(size) + offset) / size).clip(0, n - 1)
        index, times = np.unique(picked, return_counts=True)
        return index, times / (size * p[index])


def usable(table: Table, metric: Metric, select: Select, *, anisotropic: bool = False) -> Usable:
    """The samples of ``table`` that a fit under ``metric`` uses. Raises SpecError or FitError.

    ``anisotropic`` : of the model. The directions of an isotropic table are one representative each of all
    azimuths; such a model then gets them turned about the normal, evenly, or it would read meaning into the
    azimuth that the table happens to be written in.
    """
    names = [c.name for c in table.channels]
    for name in select.channels or ():
        if name not in names:
            raise SpecError(
                f"the table has no channel {name!r}", code="unknown-channel", parameter="select.channels",
                remedy=f"its channels are {', '.join(names)}",
            )  # fmt: skip
    channels = tuple(names.index(n) for n in select.channels) if select.channels else tuple(range(len(names)))
    index = np.flatnonzero(table.mask)
    wi, wo = table.directions(index)
    left_out: dict[str, int] = {}
    keep = np.ones(len(index), bool)
    for name, w, limit in (
        ("theta_i", wi, select.theta_i_max_deg),
        ("theta_o", wo, select.theta_o_max_deg),
    ):
        if limit is not None:
            inside = w[:, 2] >= np.cos(np.deg2rad(limit)) - 1e-12
            left_out[f"{name} beyond {limit:g} deg"] = int((keep & ~inside).sum())
            keep &= inside
    whole = len(channels) == len(names)
    value = table.value[index] if whole else table.value[index][:, list(channels)]
    sigma = None
    if table.sigma is not None:
        sigma = table.sigma[index] if whole else table.sigma[index][:, list(channels)]
    floor = np.array([_scale(column) for column in value.T]) * metrics.LOG_FLOOR
    if metric == "log":
        defined = (value > -floor).all(axis=1)
        left_out["no logarithm"] = int((keep & ~defined).sum())
        keep &= defined
    if not keep.all():
        wi, wo, value = wi[keep], wo[keep], value[keep]
        sigma = None if sigma is None else sigma[keep]
    if len(value) == 0:
        raise FitError(
            "no usable sample is left to fit", code="nothing-to-fit",
            cause=", ".join(f"{n} {why}" for why, n in left_out.items()) or "all samples are masked",
            remedy="widen the selection, or choose a metric that the values allow",
        )  # fmt: skip
    if not np.any(value):
        raise FitError(
            "all values are zero", code="nothing-to-fit", cause="a table of fill values",
            remedy="check the value columns",
        )  # fmt: skip
    if anisotropic and table.symmetry == "isotropic":
        wi, wo = _turned(wi, wo)
    weight = metrics.base_weights(metric, value, sigma, wi[:, 2])
    # Sums of fourth powers have to stay numbers.
    largest = max(float(np.abs(value).max()), float(np.abs(weight * value).max()))
    if not 1.0 / LARGEST < largest < LARGEST or float(np.abs(weight).max()) > LARGEST:
        raise FitError(
            f"values, or values over their uncertainty, as large as {largest:.3g} can't be fitted",
            code="values-out-of-range", cause="a wrong unit, a fill value, or a sigma that is all but zero",
            remedy=f"give values between {1 / LARGEST:g} and {LARGEST:g}, or mask the absurd ones",
        )  # fmt: skip
    return Usable(
        metric=metric,
        pair=np.concatenate([wi.T, wo.T]),
        value=value,
        sigma=sigma,
        weight=weight,
        floor=floor,
        channels=channels,
        left_out={why: n for why, n in left_out.items() if n},
    )


def _turned(wi: FloatArray, wo: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pairs (n, 3) turned about the normal, each by the golden section of a turn more than the one before."""
    angle = 2 * np.pi * np.mod(np.arange(len(wi)) * (0.5 * (np.sqrt(5.0) - 1.0)), 1.0)
    c, s = np.cos(angle), np.sin(angle)
    return directions.turned(wi, c, s), directions.turned(wo, c, s)


def _scale(column: FloatArray) -> float:
    """A typical magnitude: the median |value|, or the mean where most are zero."""
    magnitude = np.abs(column)
    return float(np.median(magnitude)) or float(magnitude.mean()) or 1.0


def _padded(array: FloatArray, size: int, edge: bool = False) -> FloatArray:
    """(size, m) with rows of zeros, or of the last row, behind those of ``array``."""
    missing = size - len(array)
    if not missing:
        return array
    return np.pad(array, ((0, missing), (0, 0)), mode="edge" if edge else "constant")
