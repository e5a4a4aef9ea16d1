"""Ashikhmin-Shirley: the paper's expression, the limit of its exponent at h = n, bounded weights."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitter import models
from tests.models.statistics import finite, hemisphere


def paper(wi, wo, rd, rs, nu, nv, psi):
    h = wi + wo
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    hx, hy = np.cos(psi) * h[:, 0] + np.sin(psi) * h[:, 1], np.cos(psi) * h[:, 1] - np.sin(psi) * h[:, 0]
    c = (h * wi).sum(axis=-1)
    e = (nu * hx**2 + nv * hy**2) / (1 - h[:, 2] ** 2)
    fresnel = rs + (1 - rs) * (1 - c) ** 5
    specular = np.sqrt((nu + 1) * (nv + 1)) / (8 * np.pi) * h[:, 2] ** e * fresnel
    filled = (1 - (1 - wi[:, 2] / 2) ** 5) * (1 - (1 - wo[:, 2] / 2) ** 5)
    diffuse = 28 * rd / (23 * np.pi) * (1 - rs) * filled
    return diffuse + specular / (c * np.maximum(wi[:, 2], wo[:, 2]))


def test_is_the_paper_s_expression():
    wi, wo = hemisphere(0, 500), hemisphere(1, 500)
    values = {"rd": 0.4, "rs": 0.2, "nu": 30.0, "nv": 400.0, "psi": 0.7}
    found = np.asarray(models.create("ashikhmin_shirley", **values).evaluate(wi, wo))[:, 0]
    np.testing.assert_allclose(found, paper(wi, wo, **values), rtol=1e-10)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("nu", "nv"), [(0.0, 0.0), (10.0, 1e6), (1e6, 1e6)])
def test_half_vector_at_the_normal_has_a_value_and_slopes(nu: float, nv: float, dtype: type):
    """The exponent is 0/0 there."""
    rs = 0.3
    model = models.create("ashikhmin_shirley", rd=0.0, rs=rs, nu=nu, nv=nv, psi=0.3)
    model = jax.tree.map(lambda leaf: leaf.astype(dtype), model)
    mu = 0.5
    s = math.sqrt(1 - mu * mu)
    wi, wo = jnp.asarray([s, 0.0, mu], dtype), jnp.asarray([-s, 0.0, mu], dtype)
    total = lambda args: jnp.sum(args[0].evaluate(args[1], args[2]))  # noqa: E731
    value, slopes = jax.value_and_grad(total)((model, wi, wo))
    fresnel = rs + (1 - rs) * (1 - mu) ** 5
    expected = math.sqrt((nu + 1) * (nv + 1)) / (8 * math.pi) * fresnel / mu**2
    assert float(value) == pytest.approx(expected, rel=1e-6 if dtype == np.float32 else 1e-14)
    assert finite(slopes)


@pytest.mark.parametrize("theta", [0.0, 45.0, 85.0])
def test_weights_are_bounded(theta: float):
    """The specular part by F over its share of the draws, as the paper says."""
    model = models.create("ashikhmin_shirley", rd=0.3, rs=0.5, nu=5.0, nv=800.0)
    t = math.radians(theta)
    samples = model.sample([math.sin(t), 0.0, math.cos(t)], 50_000, seed=2)
    assert float(samples.weight.max()) <= 3.0
    error = samples.weight.std() / math.sqrt(len(samples.weight))
    albedo = float(model.albedo([math.sin(t), 0.0, math.cos(t)])[0])
    assert float(samples.weight.mean()) == pytest.approx(albedo, abs=5 * error)


def test_parameters_come_back_from_the_coefficients():
    model = models.create("ashikhmin_shirley", rd=[0.0, 0.4, 0.0], rs=[0.0, 0.3, 1.0])
    kind = models.family_of(model.spec)
    back = kind.linear_from(
        model.spec, kind.coefficients(model.spec, model.linear, model.nonlinear), model.nonlinear
    )
    for name, value in model.linear.items():
        np.testing.assert_allclose(np.asarray(back[name]), np.asarray(value), rtol=1e-15)
