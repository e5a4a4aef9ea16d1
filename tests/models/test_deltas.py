"""Ideal components: mirrors and smooth interfaces, which are directions with a weight and never a number."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitter import SpecError, models
from tests.models.statistics import finite

MIRRORS = ("specular", "specular:schlick", "specular:dielectric", "specular:conductor")

#: Unpolarised F at 0, 30, 45, 60, 75, 85 degrees, from printed tables.
PRINTED = {
    1.5: (0.040000, 0.041523, 0.050240, 0.089187, 0.253061, 0.612800),
    1.33: (0.020059, 0.021112, 0.027521, 0.059126, 0.211427, 0.582728),
}
ANGLES = (0.0, 30.0, 45.0, 60.0, 75.0, 85.0)


def incidence(degrees: float, phi: float = 0.7, side: float = 1.0) -> np.ndarray:
    t = np.deg2rad(degrees)
    return np.array([np.sin(t) * np.cos(phi), np.sin(t) * np.sin(phi), side * np.cos(t)])


@pytest.mark.parametrize("name", [*MIRRORS, "smooth_dielectric"])
def test_has_no_value_and_no_density(name):
    model = models.create(name)
    wi = incidence(40.0)
    mirror = wi * [-1, -1, 1]
    assert not np.asarray(model.evaluate(wi, mirror)).any()
    assert not np.asarray(model.pdf(wi, mirror)).any()
    assert model.evaluate(np.stack([wi, wi, wi]), mirror).shape == (3, 1)


@pytest.mark.parametrize("name", MIRRORS)
def test_mirror_draws_one_direction_with_its_albedo(name):
    model = models.create(name, ks=[0.2, 0.5, 0.9])
    wi = incidence(55.0)
    samples = model.sample(wi, 100, seed=2)
    assert samples.is_delta.all()
    assert samples.valid.all()
    assert not samples.pdf.any()
    np.testing.assert_array_equal(samples.wo, np.broadcast_to(wi * [-1, -1, 1], (100, 3)))
    albedo = np.asarray(model.albedo(wi))
    np.testing.assert_allclose(samples.weight, np.broadcast_to(albedo, (100, 3)), rtol=1e-14)
    np.testing.assert_allclose(albedo / albedo[0], [1.0, 2.5, 4.5], rtol=1e-14)


def test_mirror_albedo_is_the_fresnel_term():
    wi = incidence(60.0)
    schlick = 0.04 + 0.96 * 0.5**5
    assert float(models.create("specular", ks=0.8).albedo(wi)[0]) == pytest.approx(0.8, rel=1e-14)
    found = models.create("specular:schlick", ks=0.5, f0=0.04).albedo(wi)
    assert float(found[0]) == pytest.approx(0.5 * schlick, rel=1e-13)
    # n = 0.2 + 3i at 60 degrees, and n = 1.5 + 7i, one channel each.
    metal = models.create("specular:conductor", ks=1.0, eta=[0.2, 1.5], kappa=[3.0, 7.0])
    np.testing.assert_allclose(metal.albedo(wi), [0.918411, 0.872571], atol=5e-7)


@pytest.mark.parametrize("eta", PRINTED)
def test_interface_reflects_the_printed_digits(eta):
    model = models.create("smooth_dielectric", eta=eta)
    wi = np.stack([incidence(angle) for angle in ANGLES])
    np.testing.assert_allclose(np.asarray(model.albedo(wi))[:, 0], PRINTED[eta], atol=5.1e-7)


@pytest.mark.parametrize("eta", [0.4, 0.75, 1.0, 1.0 + 1e-9, 1.33, 2.5])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_interface_loses_nothing(eta, side):
    model = models.create("smooth_dielectric", eta=eta)
    wi = np.stack([incidence(angle, side=side) for angle in (0.0, 20.0, 41.0, 60.0, 89.9999)])
    total = np.asarray(model.albedo(wi) + model.transmittance(wi))
    np.testing.assert_allclose(total, 1.0, rtol=1e-14)
    samples = model.sample(wi[1], 2000, seed=1)
    np.testing.assert_allclose(samples.weight, 1.0, rtol=1e-14)
    assert samples.is_delta.all()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_refraction_obeys_snell_and_runs_both_ways(side):
    model = models.create("smooth_dielectric", eta=1.5)
    wi = incidence(30.0, side=side)
    samples = model.sample(wi, 1000, seed=3)
    through = samples.wo[samples.wo[:, 2] * side < 0][0]
    ratio = 1 / 1.5 if side > 0 else 1.5
    np.testing.assert_allclose(through[:2], -wi[:2] * ratio, rtol=1e-14)
    assert np.linalg.norm(through) == pytest.approx(1.0, rel=1e-14)
    # The way back passes the same share of power.
    np.testing.assert_allclose(model.transmittance(through), model.transmittance(wi), rtol=1e-13)


@pytest.mark.parametrize(("eta", "side"), [(1.5, -1.0), (0.5, 1.0)])
def test_total_reflection(eta, side):
    model = models.create("smooth_dielectric", ks=0.7, eta=eta)
    wi = incidence(60.0, side=side)
    np.testing.assert_array_equal(model.albedo(wi), [0.7])
    np.testing.assert_array_equal(model.transmittance(wi), [0.0])
    samples = model.sample(wi, 1000, seed=5)
    assert (samples.wo[:, 2] * side > 0).all()


def test_dispersion_gives_each_channel_its_direction():
    model = models.create("smooth_dielectric", eta=[1.50, 1.52, 1.56])
    wi = incidence(50.0)
    samples = model.sample(wi, 20_000, seed=7)
    through = samples.wo[:, 2] < 0
    for channel, eta in enumerate((1.50, 1.52, 1.56)):
        alone = through & (samples.weight[:, channel] > 0)
        np.testing.assert_allclose(samples.wo[alone, :2] * -eta - wi[:2], 0.0, atol=1e-14)
        assert not samples.weight[alone][:, [c for c in range(3) if c != channel]].any()
    error = samples.weight.std(axis=0) / np.sqrt(len(samples))
    whole = np.asarray(model.albedo(wi) + model.transmittance(wi))
    np.testing.assert_array_less(np.abs(samples.weight.mean(axis=0) - whole), 4.5 * error)


@pytest.mark.parametrize("name", [*MIRRORS, "smooth_dielectric"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_weights_are_differentiable_everywhere(name, dtype):
    model = models.create(name)
    critical = np.arcsin(1 / 1.5)
    hard = [
        1e-6,
        1e-3,
        np.pi / 4,
        critical - 1e-9,
        critical,
        critical + 1e-9,
        np.pi / 2 - 1e-6,
        np.pi / 2,
        0.0,
    ]
    theta = jnp.asarray(hard, dtype)
    side = jnp.asarray([1.0, -1.0], dtype)[:, None]
    x, y, z = jnp.sin(theta) + 0 * side, 0 * side * theta, jnp.cos(theta) * side
    values = {k: v.astype(dtype) for k, v in model.values.items()}

    def weights(args):
        values, x, y, z = args
        found = model.deltas(model.spec, values, x, y, z)
        return sum(jnp.sum(d.weight) + jnp.sum(d.x + d.y + d.z) + jnp.sum(d.share) for d in found)

    total, slope = jax.jit(jax.value_and_grad(weights))((values, x, y, z))
    assert total.dtype == dtype
    assert np.isfinite(total)
    assert finite(slope)


@pytest.mark.parametrize("name", ["specular:dielectric", "smooth_dielectric"])
def test_weight_slopes_match_differences(name):
    model = models.create(name)
    wi = incidence(35.0)

    @jax.jit
    def reflected(eta):
        other = eqx.tree_at(lambda m: m.values["eta"], model, eta)
        return jnp.sum(other.deltas(other.spec, other.values, *jnp.asarray(wi))[0].weight)

    step = 1e-5
    eta = jnp.asarray(1.5)
    difference = (reflected(eta + step) - reflected(eta - step)) / (2 * step)
    np.testing.assert_allclose(jax.jit(jax.grad(reflected))(eta), difference, rtol=1e-7)


def test_mixes_with_lobes():
    model = models.create("sum(specular:schlick, lambert)", a_ks=0.9, a_f0=0.3, b_kd=0.4)
    wi = incidence(30.0)
    samples = model.sample(wi, 200_000, seed=4)
    error = samples.weight.std(axis=0) / np.sqrt(len(samples))
    np.testing.assert_array_less(
        np.abs(samples.weight.mean(axis=0) - np.asarray(model.albedo(wi))), 4.5 * error
    )
    ideal = samples.is_delta.mean()
    # Both parts take what they carry: the density of the other is 1 less the ideal share.
    mu, w = np.polynomial.legendre.leggauss(64)
    wo = np.stack([np.sqrt(1 - (0.5 * mu + 0.5) ** 2), 0 * mu, 0.5 * mu + 0.5], axis=-1)
    assert float(np.pi * (np.asarray(model.pdf(wi, wo)) * w).sum()) == pytest.approx(1 - ideal, abs=5e-3)


def test_only_what_transmits_takes_light_from_below():
    below = incidence(30.0, side=-1.0)
    with pytest.raises(SpecError, match="below the horizon"):
        models.create("specular").sample(below, 10, seed=0)
    assert models.create("smooth_dielectric").sample(below, 10, seed=0).valid.all()
