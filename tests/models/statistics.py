"""Draws and statistics that the suite and the long study share."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from fitter import models


def hemisphere(seed: int, count: int, lowest: float = 0.02) -> np.ndarray:
    """Unit vectors (count, 3) of the upper hemisphere, cosines even from ``lowest`` to 1."""
    rng = np.random.default_rng(seed)
    mu, phi = rng.uniform(lowest, 1.0, count), rng.uniform(0, 2 * np.pi, count)
    s = np.sqrt(1 - mu * mu)
    return np.stack([s * np.cos(phi), s * np.sin(phi), mu], axis=1)


def finite(tree: Any) -> bool:
    """Whether every leaf of a value with its gradients is."""
    return all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(tree))


def chi_square_p(counts: np.ndarray, expected: np.ndarray) -> float:
    """Probability of deviations this large; bins that expect fewer than 5 are pooled."""
    order = np.argsort(expected)
    counts, expected = counts[order], expected[order]
    pooled = max(int(np.searchsorted(np.cumsum(expected), 5.0)) + 1, int(np.searchsorted(expected, 5.0)))
    counts = np.append(counts[pooled:], counts[:pooled].sum())
    expected = np.append(expected[pooled:], expected[:pooled].sum())
    if len(counts) < 2:
        return 1.0 if abs(counts.sum() - expected.sum()) < 1 else 0.0
    return float(stats.chi2.sf(np.sum((counts - expected) ** 2 / expected), len(counts) - 1))


def ideal_share(model: models.ReflectanceModel, wi: np.ndarray) -> float:
    """Probability that a draw is one of an ideal component."""
    found, shares, deltas = model.mixture(*jnp.asarray(wi))
    assert len(shares) == len(found) + len(deltas)
    assert abs(float(sum(shares)) - 1.0) < 1e-12
    if not found:
        return 1.0
    return min(float(sum(shares[len(found) :])), 1.0) if deltas else 0.0
