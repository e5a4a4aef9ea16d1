"""Noise: from repeated geometries, and from how smooth neighbouring samples are.

Both are relative standard deviations (k = 1). Repeated geometries give the repeatability itself. Smoothness
gives an upper bound: curvature of the reflectance is counted as noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from fitter.quality.finding import Finding, counted, graded, not_judged, percent
from fitter.quality.measured import Measured, features
from fitter.repeats import STEP

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

#: Degrees of freedom from which on a pooled standard deviation is worth stating.
FEWEST_DEGREES = 5
#: Relative repeatability from which on it is said, and from which on it is a warning.
NOISY, VERY_NOISY = 0.05, 0.20
#: Scatter over stated sigma that contradicts the statement.
SIGMA_OFF = 2.0
#: MAD of a normal distribution in units of its standard deviation.
MAD = 0.6744897501960817
#: A group's mean below this part of the channel's median is too near zero for a relative deviation.
_NEAR_ZERO = 0.05
_NEIGHBOURS = 12
_TARGETS = 20_000
#: A neighbour's weights beyond this sum of squares extrapolate: they say more of themselves than of noise.
_LEVERAGE = 1.5


@dataclass(frozen=True)
class Noise:
    """Standard deviation (k = 1) of one sample: ``relative`` of its value, and ``floor`` (1/sr) near zero."""

    relative: float
    floor: float

    def deviation(self, value: FloatArray) -> FloatArray:
        """Standard deviation (1/sr) of samples with these values."""
        return np.hypot(self.relative * value, self.floor)


@dataclass(frozen=True)
class Smoothness:
    """Residuals from what neighbouring samples predict, scaled to the noise of one sample.

    position : (m,) in ``Measured.rows``; residual : (m, c) 1/sr; level : (m, c) the prediction's size.
    relative : (c,) robust relative standard deviation, floor : (c,) 1/sr the same of the lowest quarter.
    """

    position: IndexArray
    residual: FloatArray
    level: FloatArray

    @property
    def ratio(self) -> FloatArray:
        """(m, c) relative residuals, NaN where the level is 0."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            found = self.residual / self.level
        return np.where(np.isfinite(found), found, np.nan)

    @property
    def relative(self) -> float:
        return robust(self.ratio)

    @property
    def floor(self) -> float:
        """Standard deviation (1/sr) among the lowest quarter of the levels."""
        level = self.level.mean(axis=1)
        return robust(self.residual[level <= np.quantile(level, 0.25)]) if len(level) else float("nan")


def robust(residual: FloatArray) -> float:
    """Standard deviation from the median absolute value; NaN where there is none."""
    found = np.abs(residual[np.isfinite(residual)])
    return float(np.median(found)) / MAD if len(found) else float("nan")


def smoothness(measured: Measured, *, apart: bool = False) -> Smoothness | None:
    """Residual of samples from a plane through their nearest neighbours, None for too few samples.

    The plane is fitted by least squares in direction space, in as many dimensions as the neighbours span.
    Of a grid the neighbours are its next nodes along each axis, and the axis that predicts best is taken.
    apart : samples that differ by a turn of the surface are no neighbours, though it be taken for isotropic.
    """
    if measured.table.grid is not None:
        return _along_axes(measured)
    n = len(measured.rows)
    if n < _NEIGHBOURS + 2:
        return None
    position = measured.draw(_TARGETS)
    points = features(measured.wi, measured.wo, isotropic=False) if apart else measured.features
    at = points[position]
    _, found = (KDTree(points) if apart else measured.tree).query(at, k=_NEIGHBOURS + 1)
    near = np.asarray(found, np.intp)
    # The sample itself is among its neighbours, not always first: repeated geometries tie with it.
    own = near == position[:, None]
    own[~own.any(axis=1), -1] = True
    near = near[~own].reshape(len(position), _NEIGHBOURS)
    offset = points[near] - at[:, None, :]
    scale = np.sqrt((offset**2).sum(axis=2).max(axis=1))
    design = np.concatenate(
        [np.ones((*near.shape, 1)), offset / np.where(scale > 0, scale, 1.0)[:, None, None]], axis=2
    )
    weight = np.linalg.pinv(design, rcond=0.02)[:, 0, :]
    leverage = (weight**2).sum(axis=1)
    values = measured.value[:, measured.channels]
    residual = values[position] - np.einsum("mk,mkc->mc", weight, values[near])
    residual /= np.sqrt(1.0 + leverage)[:, None]
    level = np.abs(values[near].mean(axis=1))
    good = leverage < _LEVERAGE
    return Smoothness(position[good], residual[good], level[good]) if good.any() else None


def _along_axes(measured: Measured) -> Smoothness | None:
    """The same on a grid: nodes against the line through the next ones, along the smoothest axis."""
    grid = measured.table.grid
    assert grid is not None
    where = np.unravel_index(measured.rows, grid.shape)
    best: Smoothness | None = None
    for k, axis in enumerate(grid.axes.values()):
        inside = (where[k] > 0) & (where[k] < len(axis) - 1)
        position = np.flatnonzero(inside)
        if not len(position):
            continue
        here = [index[position] for index in where]
        rows: list[IndexArray] = []
        for step in (-1, 1):
            beside = [index + step if j == k else index for j, index in enumerate(here)]
            rows.append(np.ravel_multi_index(tuple(beside), grid.shape).astype(np.intp))
        good = measured.keep[rows[0]] & measured.keep[rows[1]]
        position, before, after, node = position[good], rows[0][good], rows[1][good], here[k][good]
        if not len(position):
            continue
        t = ((axis[node] - axis[node - 1]) / (axis[node + 1] - axis[node - 1]))[:, None]
        value = measured.table.value
        columns = measured.channels[None, :]
        low, high = value[before[:, None], columns], value[after[:, None], columns]
        residual = measured.value[position][:, measured.channels] - ((1 - t) * low + t * high)
        residual /= np.sqrt(1 + t**2 + (1 - t) ** 2)
        found = Smoothness(position, residual, np.abs(0.5 * (low + high)))
        if best is None or robust(found.ratio) < robust(best.ratio):
            best = found
    return best


@dataclass(frozen=True)
class Scatter:
    """Repeated geometries: pooled relative standard deviation, its degrees of freedom, and over sigma."""

    groups: int
    degrees: int
    relative: float
    by_channel: FloatArray
    over_sigma: float | None

    @property
    def enough(self) -> bool:
        """Whether the geometries are enough to state the repeatability."""
        return self.degrees >= FEWEST_DEGREES and bool(np.isfinite(self.relative))


def scatter(measured: Measured) -> Scatter | None:
    """Pooled over all geometries that were measured more than once, None where there are none."""
    if not measured.table.repeats.any():
        return None
    pair = np.concatenate([measured.wi, measured.wo], axis=1)
    key = np.round(pair / STEP).astype(np.int64)
    _, inverse, count = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.reshape(-1)
    many = count[inverse] > 1
    if not many.any():
        return None
    _, label = np.unique(inverse[many], return_inverse=True)
    label = label.reshape(-1)
    size = np.bincount(label).astype(np.float64)
    value = measured.value[many]
    mean = np.stack([np.bincount(label, column) / size for column in value.T], axis=1)
    away = value - mean[label]
    large = np.abs(mean) > _NEAR_ZERO * measured.typical
    square = np.where(large[label], (away / np.where(mean == 0, 1.0, mean)[label]) ** 2, 0.0).sum(axis=0)
    degrees = np.where(large, (size - 1)[:, None], 0.0).sum(axis=0)
    by_channel = np.sqrt(square / np.where(degrees > 0, degrees, np.nan))
    total = float(degrees.sum())
    pooled = float(np.sqrt(square.sum() / total)) if total > 0 else float("nan")
    sigma = measured.table.sigma
    over = None
    if sigma is not None:
        stated = sigma[measured.rows[many]]
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = away / stated * np.sqrt(size / (size - 1))[label][:, None]
        ratio = ratio[np.isfinite(ratio)]
        over = float(np.sqrt(np.mean(ratio**2))) if len(ratio) else None
    return Scatter(len(size), int((size - 1).sum()), pooled, by_channel, over)


def estimate(repeated: Scatter | None, neighbours: Smoothness | None) -> Noise | None:
    """Noise of one sample: from repeated geometries, else the bound from smoothness; None for neither."""
    floor = float("nan") if neighbours is None else neighbours.floor
    relative = float("nan") if neighbours is None else neighbours.relative
    if repeated is not None and repeated.enough:
        relative = repeated.relative
    if not np.isfinite(relative):
        return None
    return Noise(relative, floor if np.isfinite(floor) else 0.0)


def repeatability(found: Scatter | None) -> Finding:
    """The finding about repeated geometries."""
    name = "repeatability"
    if found is None:
        return not_judged(name, "No geometry was measured twice: the repeatability is not known.", groups=0)
    numbers = {
        "groups": found.groups, "degrees_of_freedom": found.degrees, "relative_sd": found.relative,
        "relative_sd_uncertainty": found.relative / np.sqrt(2 * max(found.degrees, 1)),
        "relative_sd_by_channel": found.by_channel, "scatter_over_sigma": found.over_sigma,
    }  # fmt: skip
    repeated = counted(found.groups, "geometry was", "geometries were")
    if not found.enough:
        return not_judged(
            name, f"{repeated} measured more than once: too few to state the repeatability.", **numbers
        )
    verdict = graded(found.relative, NOISY, VERY_NOISY)
    sentence = (
        f"{repeated} measured more than once; they repeat to {percent(found.relative)} (pooled relative "
        f"standard deviation, {found.degrees:,} degrees of freedom)"
    )
    if found.over_sigma is not None:
        off = found.over_sigma > SIGMA_OFF or found.over_sigma < 1 / SIGMA_OFF
        verdict = "notice" if off and verdict == "ok" else verdict
        sentence += f", which is {found.over_sigma:.2g} times the stated sigma"
    return Finding(name, verdict, sentence + ".", numbers)


def smooth(found: Smoothness | None) -> Finding:
    """The finding about local smoothness."""
    name = "smoothness"
    relative = float("nan") if found is None else found.relative
    if found is None or not np.isfinite(relative):
        return not_judged(name, "The samples are too few to tell noise from shape.", relative_sd_at_most=None)
    numbers = {
        "relative_sd_at_most": relative, "floor_sd_at_most_per_sr": found.floor,
        "samples": len(found.position),
    }  # fmt: skip
    verdict = graded(relative, VERY_NOISY, np.inf)
    sentence = (
        f"The noise of one sample is typically at most {percent(relative)}, judged by its neighbours; where "
        "the reflectance curves between samples this overstates it."
    )
    return Finding(name, verdict, sentence, numbers)
