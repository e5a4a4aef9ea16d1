"""Do draws follow the density a model states, and does the density integrate to what can be drawn?"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaincc
from numpy.typing import NDArray

from fitter.models.base import ReflectanceModel

Floats = NDArray[Any]

INCIDENCES_DEG = (0.0, 40.0, 80.0)
#: Draws of each incidence, and the fewer of a dear model.
DRAWS, DEAR_DRAWS = 65_536, 8192
#: Cells of the sphere or hemisphere, and Gauss nodes along each side of one.
POLAR, AZIMUTHAL, NODES = 12, 16, 20
#: Chance of a false alarm of all chi-square tests of one model (Sidak's correction shares it).
SIGNIFICANCE = 1e-3


def sampling(model: ReflectanceModel, dear: bool) -> Iterator[tuple[str, float, float | None, str, bool]]:
    """Figures (name, value, bound, where, whether the bound is a lower one)."""
    integral, chance, weight = (0.0, ""), (1.0, ""), (0.0, "")
    tests, count = 0, DEAR_DRAWS if dear else DRAWS
    for dtype in (np.float64, np.float32):
        for degrees in INCIDENCES_DEG:
            where = f"{degrees:g} deg, {np.dtype(dtype).name}"
            theta = math.radians(degrees)
            wi = np.array([math.sin(theta), 0.0, math.cos(theta)], dtype)
            draws = model.sample(wi, count, seed=17)
            weight = max(weight, (float(draws.weight.max()), where))
            kept = draws.valid & ~draws.is_delta
            if draws.is_delta.all():
                continue
            expected = count * _cells(model, wi)
            drawn = float(kept.mean())
            # Beside rounding, how far a share of that many draws strays: four standard deviations.
            allowed = 1e-4 + 4 * math.sqrt(drawn * (1 - drawn) / count)
            integral = max(integral, (float(abs(expected.sum() / count - drawn)) / allowed, where))
            found = _counts(model, draws.wo[kept])
            chance = min(chance, (_chance(found, expected), where))
            tests += 1
    if tests:
        yield "pdf integral", integral[0], 1.0, f"{integral[1]}, over 1e-4 + 4 sigma", False
        bound = 1 - (1 - SIGNIFICANCE) ** (1 / tests)
        yield "chi-square p", chance[0], bound, chance[1], True
    yield "largest weight", weight[0], None, weight[1], False


def _edges(model: ReflectanceModel) -> tuple[Floats, Floats]:
    """Cell borders in the polar angle and the azimuth."""
    halves = 2 if type(model).transmits(model.spec) else 1
    return np.linspace(0.0, halves * math.pi / 2, halves * POLAR + 1), np.linspace(
        -math.pi, math.pi, AZIMUTHAL + 1
    )


def _cells(model: ReflectanceModel, wi: Floats) -> Floats:
    """The integral of the density over each cell (POLAR, AZIMUTHAL)."""
    x, w = np.polynomial.legendre.leggauss(NODES)
    (theta, w_theta), (phi, w_phi) = (_spread(edges, x, w) for edges in _edges(model))
    s, c = np.sin(theta)[:, None], np.cos(theta)[:, None]
    wo = np.stack([s * np.cos(phi), s * np.sin(phi), np.broadcast_to(c, (len(theta), len(phi)))], axis=-1)
    density = np.asarray(model.pdf(wi.astype(float), wo)) * (s * w_theta[:, None] * w_phi)
    return density.reshape(-1, NODES, AZIMUTHAL, NODES).sum(axis=(1, 3))


def _spread(edges: Floats, x: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Nodes and weights of a rule on [-1, 1] in every interval between edges."""
    half = 0.5 * np.diff(edges)[:, None]
    return (edges[:-1, None] + half * (1.0 + x)).reshape(-1), (half * w).reshape(-1)


def _counts(model: ReflectanceModel, wo: Floats) -> Floats:
    theta = np.arctan2(np.hypot(wo[:, 0], wo[:, 1]), wo[:, 2])
    return np.histogram2d(theta, np.arctan2(wo[:, 1], wo[:, 0]), _edges(model))[0]


def _chance(found: Floats, expected: Floats) -> float:
    """p of the chi-square test; cells that expect fewer than 5 draws are put together."""
    few = expected < 5
    seen = np.append(found[~few], found[few].sum())
    wanted = np.append(expected[~few], expected[few].sum())
    if wanted[-1] < 5:
        # Too little to test by itself: it must be about as rare as it claims.
        if seen[-1] > 5 + 5 * math.sqrt(wanted[-1] + 1):
            return 0.0
        seen, wanted = seen[:-1], wanted[:-1]
    chi2 = float(((seen - wanted) ** 2 / wanted).sum())
    return float(gammaincc(0.5 * len(seen), jnp.asarray(0.5 * chi2)))
