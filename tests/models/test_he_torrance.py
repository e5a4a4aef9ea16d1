"""He, Torrance, Sillion and Greenberg: the digits of the series, its limits, and where the energy goes."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

from fitter import models
from fitter.models.he_torrance import lambert_w, series
from fitter.models.pair import Pair
from tests.models.fifty_digits import DIGITS
from tests.models.statistics import finite
from tests.models.test_transmission import unit

SERIES = jax.jit(series)
SLOPES = jax.jit(jax.grad(series, argnums=(0, 1, 2)))
MIRROR = {"kd": 0.0, "eta": 0.01, "kappa": 20.0}  # F = 0.9999


def _exact(g: float, sideways: float) -> mp.mpf:
    with mp.workdps(DIGITS):
        a = mp.mpf(sideways)
        peak = float(g * mp.exp(mp.lambertw(2 * a / mp.mpf(g) ** 2).real / 2))
        first, last = max(1, int(peak - 25 * peak**0.5 - 5)), int(peak + 40 * peak**0.5 + 60)
        terms = (
            mp.exp(m * mp.log(g) - g - mp.loggamma(m + 1) - a / m) / m for m in range(first, last)
        )  # fmt: skip
        return mp.fsum(terms)


@pytest.mark.long
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_series_digits(dtype):
    """From nearly smooth to g = 1.5e4, on both sides of where terms are skipped, far down the tails."""
    info = np.finfo(dtype)
    for g in (1e-12, 1e-3, 0.5, 3, 12, 30, 59.9, 60.1, 80, 632, 15_000):
        for sideways in (0, 0.1, 3, 300, 3e4, 4e7):
            turn = np.sqrt(dtype(g))
            exact = _exact(float(turn) ** 2, float(dtype(sideways)))
            found = SERIES(turn, dtype(sideways), dtype(0))
            assert found.dtype == dtype
            assert np.isfinite(np.asarray(SLOPES(turn, dtype(sideways), dtype(0)))).all()
            if exact < 1e8 * info.tiny:
                assert found <= 1.01e8 * info.tiny
                continue
            log = abs(float(mp.log(exact)))
            factor = 4 if dtype == np.float64 else 30
            bound = (1e-12 if dtype == np.float64 else 1e-5) + factor * float(info.eps) * log
            assert abs(mp.mpf(float(found)) / exact - 1) < bound, (g, sideways)


def test_series_slopes():
    for g, sideways in ((0.3, 2.0), (20.0, 5.0), (500.0, 700.0)):
        with mp.workdps(30):
            by_g = float(mp.diff(lambda x: _exact(x, sideways), g))  # noqa: B023
            by_a = float(mp.diff(lambda x: _exact(g, x), sideways))  # noqa: B023
        turn, scale = np.sqrt(g), 1.7
        exact = scale * np.array([2 * turn * by_g, by_a, float(_exact(g, sideways))])
        np.testing.assert_allclose(SLOPES(turn, sideways, np.log(scale)), exact, rtol=1e-9)


def test_small_sums_of_large_factors():
    """The sum alone, 1e-310 and less, is below float64; the value, by 70 digits, is not."""
    values = {
        "kd": 0.0, "sigma": 1.6591715897601826, "tau": 17.220095656173378, "eta": 0.5583794607948712,
        "kappa": 4.735802008335519,
    }  # fmt: skip
    wi = np.array([0.8505327089832323, -0.5259221520876399, 2.988561081379078e-05])
    wo = np.array([0.8544952899553363, -0.5194233043145973, 0.006101670185357848])
    found = models.create("he_torrance", **values).evaluate(wi, wo)
    assert float(np.ravel(found)[0]) == pytest.approx(4.6165912512019598161e-301, rel=1e-10)
    smooth = models.create("he_torrance", **{**values, "sigma": 0.0}).evaluate(wi, wo)
    assert float(np.ravel(smooth)[0]) == 0.0


def test_lambert_w_digits():
    for x in (1e-200, 1e-6, 0.1, 1.0, 2.72, 50.0, 1e8, 1e300):
        assert float(lambert_w(jnp.asarray(np.log(x)))) == pytest.approx(float(mp.lambertw(x)), rel=1e-12)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_slopes_are_finite(dtype):
    cosines, azimuths = (1e-6, 1e-3, 0.7, 1.0), (0.0, 1e-8, 1.0, np.pi - 1e-8, np.pi)
    wi = np.stack([unit(i, 0.0) for i in cosines for _ in cosines for _ in azimuths])
    wo = np.stack([unit(o, phi) for _ in cosines for o in cosines for phi in azimuths])
    model = models.create("he_torrance")

    @jax.jit
    @jax.value_and_grad
    def total(args):
        values, i, o = args
        other = type(model)(spec=model.spec, channels=model.channels, values=values)
        ideal = other.deltas(other.spec, values, i[:, 0], i[:, 1], i[:, 2])[0]
        return jnp.sum(other.value(Pair.split(i, o))) + jnp.sum(ideal.weight)

    for sigma, tau in ((0.0, 3.0), (1e-6, 100.0), (0.1, 0.5), (2.0, 20.0), (10.0, 1e3)):
        values = {**model.values, "sigma": sigma, "tau": tau}
        values = {k: jnp.asarray(v, dtype) for k, v in values.items()}
        found, slope = total((values, jnp.asarray(wi, dtype), jnp.asarray(wo, dtype)))
        assert found.dtype == dtype
        assert np.isfinite(found)
        assert finite(slope)


def test_smooth_surface_is_a_mirror():
    model = models.create("he_torrance", kd=0.0, sigma=0.0, eta=1.5, kappa=0.0)
    mirror = models.create("specular:dielectric", ks=1.0, eta=1.5)
    wi = unit(0.5, 0.3)
    np.testing.assert_allclose(model.albedo(wi), mirror.albedo(wi), rtol=1e-14)
    samples = model.sample(wi, 4096, seed=1)
    np.testing.assert_array_equal(samples.wo[samples.is_delta][0], wi * [-1, -1, 1])
    np.testing.assert_allclose(samples.weight.mean(), mirror.albedo(wi)[0], rtol=1e-10)


@pytest.mark.long
@pytest.mark.parametrize("sigma", [0.02, 0.1, 0.3, 2.0])
def test_energy_moves_from_the_mirror_to_the_lobe(sigma):
    """At normal incidence e^-g of it stays coherent, and of the rest no more is lost than 2e-3."""
    model = models.create("he_torrance", sigma=sigma, tau=max(12.0 * sigma, 5.0), **MIRROR)
    wi = unit(1.0, 0.0)
    (ideal,) = model.deltas(model.spec, model.values, *jnp.asarray(wi))
    fresnel = float(models.create("specular:conductor", ks=1.0, eta=0.01, kappa=20.0).albedo(wi)[0])
    assert float(ideal.weight[0]) == pytest.approx(fresnel * np.exp(-((4 * np.pi * sigma) ** 2)), rel=1e-12)
    assert float(model.albedo(wi)[0]) == pytest.approx(fresnel, rel=2e-3)
    # Down to cos 0.2 the approximations of the paper neither make nor lose more than this.
    assert 0.75 < float(model.albedo(unit(0.2, 0.0))[0]) < 1.03


def test_rough_limit_is_cook_torrance():
    """sigma of many wavelengths: Beckmann facets of alpha = 2 sigma/tau. The series differs by about 1/g."""
    sigma, tau = 10.0, 100.0
    wave = models.create("he_torrance", sigma=sigma, tau=tau, **MIRROR)
    facets = models.create(
        "torrance_sparrow:beckmann:smith_separable:conductor:no_diffuse",
        ks=1.0, alpha=2 * sigma / tau, eta=0.01, kappa=20.0,
    )  # fmt: skip
    for i, o, phi in ((1.0, 0.95, 1.0), (0.8, 0.75, 3.0), (0.6, 0.7, 3.3)):
        wi, wo = unit(i, 0.0), unit(o, phi)
        np.testing.assert_allclose(wave.evaluate(wi, wo), facets.evaluate(wi, wo), rtol=2e-3)


def test_is_reciprocal():
    rng = np.random.default_rng(4)
    wi, wo = (np.stack([unit(*d) for d in rng.uniform([0, 0], [1, 6], (300, 2))]) for _ in range(2))
    model = models.create("he_torrance", sigma=[0.05, 0.2, 0.6], tau=2.0)
    np.testing.assert_allclose(model.evaluate(wi, wo), model.evaluate(wo, wi), rtol=1e-11)


@pytest.mark.long
@pytest.mark.parametrize(("sigma", "tau", "cosine"), [(0.05, 3.0, 0.9), (0.15, 2.0, 0.6), (1.0, 10.0, 0.6)])
def test_weights_estimate_the_albedo(sigma, tau, cosine):
    model = models.create("he_torrance", sigma=sigma, tau=tau, **MIRROR)
    wi = unit(cosine, 0.4)
    samples = model.sample(wi, 400_000, seed=6)
    error = samples.weight.std(axis=0) / np.sqrt(len(samples))
    np.testing.assert_array_less(
        np.abs(samples.weight.mean(axis=0) - np.asarray(model.albedo(wi))), 4.5 * error
    )
    assert samples.weight.max() < 4.0
    single = model.sample(wi.astype(np.float32), 4096, seed=6)
    assert np.isfinite(single.weight).all()
