"""Metallic-roughness: its two ends are models of their own, its mirror end stays finite."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitter import SpecError, models
from tests.models.statistics import finite, hemisphere

WI, WO = hemisphere(0, 300), hemisphere(1, 300)
COLOR = [1.0, 0.76, 0.33]


def lobe(roughness: float, f0) -> np.ndarray:
    same = models.create("torrance_sparrow:ggx:smith:no_diffuse", ks=[1.0] * 3, f0=f0, alpha=roughness**2)
    return np.asarray(same.evaluate(WI, WO))


@pytest.mark.parametrize("roughness", [0.05, 0.4, 1.0])
def test_a_metal_is_ggx_with_its_colour_as_reflectance(roughness: float):
    metal = models.create("metallic_roughness", base_color=COLOR, metallic=1.0, roughness=roughness)
    np.testing.assert_allclose(np.asarray(metal.evaluate(WI, WO)), lobe(roughness, COLOR), rtol=1e-12)


@pytest.mark.parametrize("roughness", [0.05, 0.4, 1.0])
def test_a_dielectric_is_ggx_of_4_percent_over_lambert(roughness: float):
    plastic = models.create("metallic_roughness", base_color=COLOR, metallic=0.0, roughness=roughness)
    c = np.sqrt(((WI + WO) ** 2).sum(axis=1, keepdims=True)) / 2
    fresnel = 0.04 + 0.96 * (1 - c) ** 5
    expected = lobe(roughness, [0.04] * 3) + (1 - fresnel) * np.array(COLOR) / np.pi
    np.testing.assert_allclose(np.asarray(plastic.evaluate(WI, WO)), expected, rtol=1e-12)


def white(metallic: float, roughness: float, mu: float) -> float:
    model = models.create("metallic_roughness", base_color=1.0, metallic=metallic, roughness=roughness)
    return float(model.albedo([math.sqrt(1 - mu * mu), 0.0, mu])[0])


@pytest.mark.parametrize("roughness", [0.1, 0.3, 1.0])
def test_a_metal_gains_no_energy(roughness: float):
    for mu in (1.0, 0.5, 0.1, 0.01, 1e-3):
        assert white(1.0, roughness, mu) <= 1.0 + 1e-6


@pytest.mark.parametrize(("roughness", "albedo"), [(1.0, 1.018), (0.6, 1.101), (0.1, 1.765), (0.0, 1.922)])
def test_a_dielectric_gains_energy_at_grazing_as_stated(roughness: float, albedo: float):
    """The diffuse term is not dimmed by what a smooth surface reflects there."""
    assert white(0.0, roughness, 1e-3) == pytest.approx(albedo, abs=1e-3)
    assert white(0.0, roughness, 1.0) <= 1.0 + 1e-6


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("roughness", [0.0, 1e-3, 0.01, 1.0])
def test_the_mirror_end_is_finite(roughness: float, dtype: type):
    model = models.create("metallic_roughness", roughness=roughness, metallic=0.5)
    model = jax.tree.map(lambda leaf: leaf.astype(dtype), model)
    total = lambda args: jnp.sum(args[0].evaluate(args[1], args[2]))  # noqa: E731
    up, low, away = [0.0, 0.0, 1.0], [1.0, 0.0, 1e-6], [-1.0, 0.0, 1e-6]
    for wi, wo in ((up, up), (up, low), (low, low), (low, away)):
        found = jax.value_and_grad(total)((model, jnp.asarray(wi, dtype), jnp.asarray(wo, dtype)))
        assert finite(found)


@pytest.mark.parametrize("metallic", [0.0, 0.3, 1.0])
def test_base_color_comes_back_from_the_coefficients(metallic: float):
    model = models.create("metallic_roughness", base_color=[0.0, 0.4, 1.0], metallic=metallic)
    kind = models.family_of(model.spec)
    coefficients = kind.coefficients(model.spec, model.linear, model.nonlinear)
    back = kind.linear_from(model.spec, coefficients, model.nonlinear)
    np.testing.assert_allclose(np.asarray(back["base_color"]), [0.0, 0.4, 1.0], atol=1e-15)


def test_printed_reflectances_above_one_are_not_taken_silently():
    with pytest.raises(SpecError, match=r"base_color = .*1\.022.* outside \[0, 1\]"):
        models.create("metallic_roughness", base_color=[1.022, 0.782, 0.344], metallic=1.0)
