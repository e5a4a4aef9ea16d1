"""Fresnel terms against their definitions: what an error in one of several factors would hide."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from scipy import integrate

from fitter.models import fresnel
from fitter.models.pair import Half, Pair
from tests.models.statistics import hemisphere


def _facets() -> tuple[Pair, Half, np.ndarray]:
    """Pairs of directions, and the cosine between each and its half vector."""
    wi, wo = hemisphere(1, 500, 0.01), hemisphere(2, 500, 0.01)
    p = Pair.split(wi, wo)
    return p, Half.of(p), np.sqrt((1.0 + np.sum(wi * wo, axis=1)) / 2.0)


def test_schlick_s_power_and_its_rest_add_up_to_one():
    p, h, cosine = _facets()
    rising = np.asarray(fresnel.schlick_weighted(jnp.ones(()), p, h))
    np.testing.assert_allclose(rising, (1.0 - cosine) ** 5, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(np.asarray(fresnel.schlick_rest(p, h)), 1.0 - (1.0 - cosine) ** 5, rtol=1e-12)


def test_schlick_average_is_the_cosine_average():
    for f0 in (0.0, 0.04, 0.9, 1.0):
        found, _ = integrate.quad(lambda c, f0=f0: 2 * c * (f0 + (1 - f0) * (1 - c) ** 5), 0.0, 1.0)
        np.testing.assert_allclose(float(fresnel.schlick_average(jnp.asarray(f0))), found, rtol=1e-12)
