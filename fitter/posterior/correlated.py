"""Residuals as a field that is correlated over directions: how strongly, over what angle, and what it means.

The correlation is read off the products of pairs of standardised residuals by the distance of their
directions: (1 - nugget) times Matern's with smoothness 3/2 (M. Stein, "Interpolation of Spatial Data", 1999).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.spatial import KDTree

from fitter.fitting.blocks import Block
from fitter.fitting.layout import Layout
from fitter.fitting.sums import sample_scores
from fitter.quality.measured import features
from fitter.spec import Metric

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]
#: Samples that pairs are formed of, at most.
PAIRED = 1_000
#: Nearest neighbours whose residuals tell how large they are here.
NEIGHBOURS = 24
#: Ranges (radians, chords of directions) that are tried.
RANGES = np.geomspace(0.02, 1.5, 24)
CLASSES = 24


@dataclass(frozen=True)
class Correlation:
    """share : of the residual variance that is correlated, 1 - nugget. reach : the Matern range, radians."""

    share: float
    reach: float

    def at(self, distance: FloatArray) -> FloatArray:
        """The correlation of two different samples at a distance."""
        return self.share * matern(distance / self.reach)


@dataclass(frozen=True)
class Field:
    """outer : (P, P) expected outer product of the sum of scores. effective_samples : per channel."""

    outer: FloatArray
    effective_samples: list[float]


def correlated_outer(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, block: Block, *, isotropic: bool
) -> Field:
    """What the sum of the samples' scores at p would vary by if the residuals were drawn again, correlated as
    they are. Channels are taken to move together."""
    n = block.count
    every = np.arange(n) if n <= PAIRED else np.linspace(0, n - 1, PAIRED).astype(np.intp)
    value, slopes = sample_scores(layout, metric, floor, p, block)  # (C, n), (P, C, n)
    at = features(block.pair[:3, :n].T, block.pair[3:, :n].T, isotropic=isotropic)[every]
    value, slopes = value[:, every], slopes[:, :, every]
    distance = distances(at, at)
    size = np.stack([local_size(at, own) for own in value])
    each = [correlation(own / scale, distance) for own, scale in zip(value, size, strict=True)]
    correlations = np.stack([one.at(distance) for one in each])
    for one in correlations:
        np.fill_diagonal(one, 1.0)
    times = n / len(every)
    # The diagonal counts samples, the rest pairs of them.
    mean = times**2 * correlations.mean(axis=0)
    np.fill_diagonal(mean, times)
    rows = np.einsum("pcn,cn->pn", slopes, size)
    m = len(every)
    worth = [n / (1.0 + (n - 1) * (one.sum() - m) / max(m * (m - 1), 1)) for one in correlations]
    return Field(rows @ mean @ rows.T, [float(w) for w in worth])


def distances(a: FloatArray, b: FloatArray) -> FloatArray:
    """(n, m) distances of points (n, d) and (m, d)."""
    return np.sqrt(np.square(a[:, None] - b[None]).sum(axis=2))


def local_size(at: FloatArray, residual: FloatArray) -> FloatArray:
    """(n,) root mean square of the residuals (n,) of the nearest neighbours at points (n, d)."""
    near = min(NEIGHBOURS, len(at))
    _, index = KDTree(at).query(at, near)
    found = np.sqrt(np.mean(np.square(residual[np.reshape(index, (len(at), near))]), axis=1))
    return np.maximum(found, 1e-3 * np.sqrt(np.mean(np.square(residual))) + 1e-300)


def correlation(z: FloatArray, distance: FloatArray) -> Correlation:
    """The correlation of standardised residuals (n,) with distances (n, n), by least squares over classes of
    pairs."""
    i, j = np.triu_indices(len(z), 1)
    if len(i) < CLASSES:
        return Correlation(0.0, float(RANGES[0]))
    d, product = distance[i, j], z[i] * z[j] / max(float(np.mean(z * z)), 1e-300)
    # By logarithm of the distance: what is near decides, and there are few such pairs.
    order = np.argsort(d, kind="stable")
    ends = np.unique((np.geomspace(1.0, len(d), CLASSES + 1)).astype(np.intp))
    classes = [order[a:b] for a, b in pairwise(ends) if b - a >= 10]
    middle = np.array([d[part].mean() for part in classes])
    mean = np.array([product[part].mean() for part in classes])
    weight = np.sqrt(np.minimum([len(part) for part in classes], 30.0 * len(z)))
    best, chosen = np.inf, Correlation(0.0, float(RANGES[0]))
    for reach in RANGES:
        share, rest = nnls((matern(middle / reach) * weight)[:, None], mean * weight)
        if rest < best and share[0] > 0:
            best, chosen = rest, Correlation(min(1.0, float(share[0])), float(reach))
    return chosen


def matern(x: FloatArray) -> FloatArray:
    """Matern's correlation with smoothness 3/2 at distances x, in units of the range."""
    scaled = np.sqrt(3.0) * x
    return (1.0 + scaled) * np.exp(-scaled)
