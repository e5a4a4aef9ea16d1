"""Blobs: a mixture of normals fitted to points by expectation and maximisation.

A. Dempster, N. Laird, D. Rubin, "Maximum likelihood from incomplete data via the EM algorithm", Journal of
the Royal Statistical Society B 39, 1977. How many normals: as many as describe points best that they were
not fitted to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
#: Numbers of normals that are tried, as long as more describe points better; each needs this many points per
#: coordinate.
COUNTS, POINTS = (1, 3, 8, 20), 10
ROUNDS = 25
#: Of each variance of all points, added to those of a blob: it can't shrink onto a walker that is stuck.
WIDTH = 1e-4


class Blobs(NamedTuple):
    """weight (K,), mean (K, P) and covariance (K, P, P) of K normals."""

    weight: FloatArray
    mean: FloatArray
    covariance: FloatArray

    def log_parts(self, x: FloatArray) -> FloatArray:
        """(K, N) logarithm of the weighted density of each normal at points x (N, P), up to a constant."""
        root = np.linalg.cholesky(self.covariance)
        z = np.linalg.inv(root) @ (x - self.mean[:, None]).swapaxes(1, 2)
        size = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
        return (np.log(self.weight) - size)[:, None] - 0.5 * np.square(z).sum(axis=1)


def blobs(x: FloatArray, half: NDArray[np.bool_], rng: np.random.Generator) -> Blobs:
    """The mixture that describes points x (N, P) best, judged by points that it has not seen: it is fitted to
    ``half`` (N,) of them. No walker's points are in both halves: it stays where it is for many steps."""
    seen, unseen = x[half], x[~half]
    best, score = COUNTS[0], -np.inf
    for count in COUNTS:
        if count > 1 and len(seen) < POINTS * count * x.shape[1]:
            break
        found = float(np.logaddexp.reduce(_fitted(seen, count, rng).log_parts(unseen)).mean())
        if found <= score:
            break
        best, score = count, found
    return _fitted(x, best, rng)


def _fitted(x: FloatArray, count: int, rng: np.random.Generator) -> Blobs:
    whole = np.atleast_2d(np.cov(x.T))
    least = np.diag(WIDTH * np.diagonal(whole) + 1e-300)
    found = Blobs(
        np.full(count, 1.0 / count), _apart(x / np.sqrt(np.diagonal(whole)), x, count, rng),
        np.repeat((whole + least)[None] / count, count, axis=0),
    )  # fmt: skip
    for _ in range(ROUNDS if count > 1 else 1):
        parts = found.log_parts(x)
        share = np.exp(parts - np.logaddexp.reduce(parts))
        # One that loses its points keeps a trace of all of them.
        share += 1e-6
        size = share.sum(axis=1)
        mean = share @ x / size[:, None]
        off = x - mean[:, None]
        covariance = (share[:, :, None] * off).swapaxes(1, 2) @ off / size[:, None, None]
        found = Blobs(size / size.sum(), mean, covariance + least)
    return found


def _apart(scaled: FloatArray, x: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """(count, P) points that lie apart (k-means++: D. Arthur, S. Vassilvitskii, 2007)."""
    chosen = [int(rng.integers(len(x)))]
    while len(chosen) < count:
        nearest = np.min([np.square(scaled - scaled[k]).sum(axis=1) for k in chosen], axis=0)
        chosen.append(int(rng.choice(len(x), p=nearest / nearest.sum())))
    return x[chosen]
