"""Modified Phong and Blinn-Phong: unit albedo about the normal, and extreme exponents."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitter import models
from tests.models.statistics import finite

NORMAL = [0.0, 0.0, 1.0]


@pytest.mark.parametrize("family", ["phong", "blinn_phong"])
@pytest.mark.parametrize("n", [0.0, 0.5, 1.0, 10.0, 300.0])
def test_albedo_about_the_normal_is_ks_and_less_elsewhere(family: str, n: float):
    model = models.create(f"{family}:no_diffuse", ks=1.0, n=n)
    # For n near 0 Phong's lobe has an edge of infinite slope, for n = 0 a jump: not at normal incidence.
    assert float(model.albedo(NORMAL)[0]) == pytest.approx(1.0, abs=1e-9)
    for theta in (0.5, 1.0, 1.4):
        assert float(model.albedo([math.sin(theta), 0.0, math.cos(theta)])[0]) <= 1.0 + 1e-6


def test_phong_is_lafortune_s_mirror_lobe():
    wi, wo = np.array([0.48, 0.36, 0.8]), np.array([[-0.6, 0.0, 0.8], [-0.48, -0.36, 0.8], [0.6, 0.0, 0.8]])
    for n in (0.7, 40.0, 1e6):
        phong = models.create("phong", kd=0.1, ks=0.4, n=n)
        lobe = models.create("lafortune", kd=0.1, ks=0.4, n=n, gamma=math.pi / 4)
        np.testing.assert_allclose(
            np.asarray(phong.evaluate(wi, wo)), np.asarray(lobe.evaluate(wi, wo)), rtol=1e-15 * 20 * (n + 10)
        )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_blinn_phong_keeps_the_digits_of_half_vectors_near_the_normal(dtype: type):
    """cos theta_h is 1 - 5e-9 here, which float32 rounds to 1: 0.5 % of the value."""
    n, tilt = 1e6, 1e-4
    model = models.create("blinn_phong:no_diffuse", ks=1.0, n=n)
    wi, wo = np.array([math.sin(2 * tilt), 0.0, math.cos(2 * tilt)], dtype), np.array(NORMAL, dtype)
    expected = (n + 2) * (n + 4) / (8 * math.pi * n) * math.exp(n * math.log(math.cos(tilt)))
    assert float(model.evaluate(wi, wo)[0]) == pytest.approx(
        expected, rel=1e-6 if dtype == np.float32 else 1e-9
    )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("family", ["phong", "blinn_phong"])
@pytest.mark.parametrize("n", [0.0, 0.3, 1e6])
def test_slopes_are_finite(family: str, n: float, dtype: type):
    model = models.create(family, n=n)
    model = jax.tree.map(lambda leaf: leaf.astype(dtype), model)
    grazing = [1.0, 0.0, 1e-6]
    for wi, wo in (
        (NORMAL, NORMAL),
        (NORMAL, grazing),
        (grazing, grazing),
        (grazing, [-1.0, 0.0, 1e-6]),
        (grazing, [1.0, 0.0, -0.5]),
    ):
        total = lambda args: jnp.sum(args[0].evaluate(args[1], args[2]))  # noqa: E731
        found = jax.value_and_grad(total)((model, jnp.asarray(wi, dtype), jnp.asarray(wo, dtype)))
        assert finite(found)
