"""Tables with known truth, made without the project's models where the model itself is in question."""

from __future__ import annotations

import numpy as np
import pytest

import fitter
from fitter import directions, models


def scattered(
    model: models.ReflectanceModel, seed: int, n: int = 2000, noise: float = 0.01, sigma: bool = False,
    azimuths: bool = False,
) -> fitter.Table:  # fmt: skip
    """Half of the samples near the mirror direction, half over the hemisphere; relative noise.

    The light comes from azimuth 0, or from all ``azimuths``.
    """
    rng = np.random.default_rng(seed)
    theta = rng.uniform(0.0, 1.3, n)
    phi_i = rng.uniform(0, 2 * np.pi, n) if azimuths else np.zeros(n)
    wi = directions.vector_from_spherical(theta, phi_i)
    mu, phi = rng.uniform(0.05, 1.0, n), rng.uniform(0, 2 * np.pi, n)
    s = np.sqrt(1 - mu * mu)
    wo = np.stack([s * np.cos(phi), s * np.sin(phi), mu], axis=1)
    near = wi[: n // 2] * [-1, -1, 1] + 0.2 * rng.standard_normal((n // 2, 3))
    near[:, 2] = np.abs(near[:, 2]) + 0.01
    wo[: n // 2] = near / np.linalg.norm(near, axis=1, keepdims=True)
    value = np.asarray(model.evaluate(wi, wo))
    u = noise * value
    measured = value + u * rng.standard_normal(value.shape)
    return fitter.Table(wi=wi, wo=wo, value=measured, sigma=u if sigma else None, negatives="keep")


TRUTHS = {
    "ward": {"kd": [0.1, 0.2, 0.3], "ks": [0.05, 0.06, 0.07], "alpha": 0.15},
    "ward:bounded": {"kd": [0.1, 0.2, 0.3], "ks": [0.05, 0.06, 0.07], "alpha": 0.3},
    "torrance_sparrow": {"kd": [0.1, 0.2, 0.3], "ks": [0.5, 0.6, 0.7], "f0": [0.1, 0.2, 0.3], "alpha": 0.2},
    "torrance_sparrow:ggx:smith": {"kd": 0.2, "ks": 0.9, "f0": 0.05, "alpha": 0.1},
    "lafortune": {"kd": [0.1, 0.2, 0.3], "ks": 0.2, "gamma": [0.75, 0.8, 0.85], "n": [20.0, 30.0, 40.0]},
    "lafortune:2": {
        "kd": 0.2, "ks_1": 0.3, "ks_2": 0.1, "gamma_1": -0.7, "n_1": 5.0, "gamma_2": 0.8, "n_2": 60.0,
    },
    "oren_nayar": {"rho": [0.3, 0.5, 0.7], "sigma": 0.5},
}  # fmt: skip


@pytest.fixture(params=TRUTHS)
def truth(request: pytest.FixtureRequest) -> models.ReflectanceModel:
    return models.create(request.param, **TRUTHS[request.param])
