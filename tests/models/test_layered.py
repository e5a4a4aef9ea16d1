"""A rough coat over another model: its digits, its limits, and how much energy it makes up."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

from fitter import SpecError, models
from fitter.models import ndf
from fitter.models.layered import Coat
from fitter.models.pair import Pair
from tests.models.fifty_digits import excess
from tests.models.statistics import finite
from tests.models.test_transmission import distribution, smith_lambda, unit

#: By how much a white base under a clear coat exceeds 1 at most: found over eta 1.02 to 2.5, alpha 1e-3 to 2.
LARGEST_ALBEDO = 1.98


def _reference(kind: str, *x: mp.mpf) -> mp.mpf:
    """Over a Lambertian base of albedo 0.3."""
    (*wi, ox, oy, oz, eta, alpha, tau) = x
    wo = [ox, oy, oz]
    half = [a + b for a, b in zip(wi, wo, strict=True)]
    c = mp.sqrt(sum(v * v for v in half)) / 2
    r = mp.sqrt(eta**2 - 1 + c * c)
    p, m = (r + c) / (2 * eta * c), (eta**2 - 1) / (2 * eta * c * (r + c))
    inside = [p * wi[2] + m * wo[2], m * wi[2] + p * wo[2]]
    ct = r / eta
    f = (((c - eta * ct) / (c + eta * ct)) ** 2 + ((eta * c - ct) / (eta * c + ct)) ** 2) / 2
    t = 2 * eta * c * ct * (1 / (c + eta * ct) ** 2 + 1 / (eta * c + ct) ** 2)
    hidden = smith_lambda(kind, alpha, *wi) + smith_lambda(kind, alpha, *wo)
    g = 1 / (1 + hidden)
    top = f * distribution(kind, alpha, *half) * g / (4 * wi[2] * wo[2])
    absorbed = mp.exp(-tau * (1 / inside[0] + 1 / inside[1]))
    return top + t * mp.mpf(0.3) / mp.pi * absorbed * ((1 - g) + t * g)


def _cases(rng: np.random.Generator, count: int) -> np.ndarray:
    rows = []
    for _ in range(count):
        eta, tau = rng.choice([1.0, 1.001, 1.33, 1.5, 2.5]), rng.choice([0.0, 0.1, 3.0])
        alpha = 10 ** rng.uniform(-4, 0.3)
        mu, phi = rng.choice([1e-6, 1e-3, 1.0, rng.uniform()]), rng.choice([0.0, np.pi, 1.0])
        other = rng.choice([1e-6, 1e-3, 1.0, rng.uniform()])
        wo = (
            unit(other, phi + np.pi),
            unit(other, phi),
            unit(other, rng.uniform(0, 6)),
            unit(min(1.0, mu * (1 + alpha)), phi + np.pi + alpha),
        )[rng.integers(4)]
        rows.append([*unit(mu, phi), *wo, eta, alpha, tau])
    return np.array(rows)


@pytest.mark.parametrize("kind", ["ggx", "beckmann"])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_fifty_digits(kind, dtype):
    cases = _cases(np.random.default_rng(11), 60).astype(dtype)
    found = []
    for row in cases:
        model = models.create(
            f"layered:{kind}(lambert)", base_kd=0.3, eta=float(row[6]), alpha=float(row[7]), tau=float(row[8])
        )
        found.append(model.evaluate(jnp.asarray(row[:3]), jnp.asarray(row[3:6]))[0])
    over = excess(lambda *x: _reference(kind, *x), list(cases.T), np.array(found), dtype)
    assert over.max() < 1


@pytest.mark.parametrize(
    ("name", "dtype"),
    [
        ("layered(lambert)", np.float32), ("layered:beckmann(oren_nayar:full)", np.float64),
        ("layered(ward)", np.float32), ("layered(ward)", np.float64),
    ],
)  # fmt: skip
def test_slopes_are_finite(name, dtype):
    """In all parameters and directions, over grazing, normal, mirror, retro and opposed directions."""
    cosines, azimuths = (1e-6, 1e-3, 0.7, 1.0), (0.0, 1e-8, 1.0, np.pi - 1e-8, np.pi)
    wi = np.stack([unit(i, 0.0) for i in cosines for _ in cosines for _ in azimuths])
    wo = np.stack([unit(o, phi) for _ in cosines for o in cosines for phi in azimuths])
    model = models.create(name)

    @jax.jit
    @jax.value_and_grad
    def total(args):
        values, i, o = args
        other = type(model)(spec=model.spec, channels=model.channels, values=values)
        return jnp.sum(other.value(Pair.split(i, o)))

    for eta, alpha, tau in ((1.0, 1e-4, 0.0), (1.5, 0.3, 0.1), (2.5, 2.0, 10.0)):
        values = {**model.values, "eta": eta, "alpha": alpha, "tau": tau}
        values = {k: jnp.asarray(v, dtype) for k, v in values.items()}
        found, slope = total((values, jnp.asarray(wi, dtype), jnp.asarray(wo, dtype)))
        assert found.dtype == dtype
        assert np.isfinite(found)
        assert finite(slope)


def test_refraction_at_the_facet_obeys_snell():
    wi, wo = (unit(mu, phi) for mu, phi in ((0.3, 0.0), (0.8, 2.0)))
    model = models.create("layered(lambert)")
    inside = Coat.of(ndf.of(model.spec, model.values), jnp.asarray(1.5), Pair.split(wi, wo)).inside
    inner = np.array(inside).reshape(2, 3)
    np.testing.assert_allclose(np.linalg.norm(inner, axis=1), 1.0, rtol=1e-14)
    h = (wi + wo) / np.linalg.norm(wi + wo)
    for outer, refracted in zip((wi, wo), inner, strict=True):
        np.testing.assert_allclose(np.cross(h, refracted), np.cross(h, outer) / 1.5, atol=1e-15)
        assert refracted @ h > outer @ h


def test_without_contrast_only_absorption_is_left():
    base = models.create("ward", kd=0.3, ks=0.1, alpha=0.2)
    coated = models.create(
        "layered(ward)", base_kd=0.3, base_ks=0.1, base_alpha=0.2, eta=1.0, alpha=0.4, tau=0.2
    )
    wi, wo = unit(0.4, 0.0), unit(0.7, 2.5)
    expected = np.asarray(base.evaluate(wi, wo)) * np.exp(-0.2 * (1 / 0.4 + 1 / 0.7))
    np.testing.assert_allclose(coated.evaluate(wi, wo), expected, rtol=1e-13)


def test_is_reciprocal_where_its_base_is():
    rng = np.random.default_rng(2)
    wi, wo = (np.stack([unit(*d) for d in rng.uniform([0, 0], [1, 6], (500, 2))]) for _ in range(2))
    model = models.create("layered(torrance_sparrow)", tau=[0.0, 0.1, 0.5], base_alpha=0.3)
    assert model.reciprocal(model.spec)
    np.testing.assert_allclose(model.evaluate(wi, wo), model.evaluate(wo, wi), rtol=1e-12)


def test_dispersion_evaluates_each_channel_at_its_own_directions():
    together = models.create("layered(ward)", eta=[1.3, 1.5, 1.9], base_alpha=0.1)
    wi, wo = unit(0.5, 0.1), np.stack([unit(0.6, 3.1), unit(0.9, 1.0)])
    for channel, eta in enumerate((1.3, 1.5, 1.9)):
        alone = models.create("layered(ward)", eta=eta, base_alpha=0.1)
        np.testing.assert_allclose(
            together.evaluate(wi, wo)[:, channel], alone.evaluate(wi, wo)[:, 0], rtol=1e-13
        )


def test_albedo_can_exceed_one_by_as_much_as_stated():
    albedos = [
        float(models.create("layered(lambert)", base_kd=1.0, eta=eta, alpha=1e-3).albedo(unit(mu, 0.0))[0])
        for eta, mu in ((1.05, 1.0), (1.05, 0.5), (1.05, 0.003), (1.5, 0.01))
    ]
    assert 1.7 < max(albedos) < LARGEST_ALBEDO
    assert albedos[0] <= 1.0


@pytest.mark.parametrize("cosine", [1.0, 0.6, 0.1])
def test_weights_estimate_the_albedo(cosine):
    model = models.create(
        "layered(torrance_sparrow:ggx:smith)", base_alpha=0.1, tau=[0.0, 0.2, 1.0], alpha=0.3
    )
    wi = unit(cosine, 0.4)
    samples = model.sample(wi, 200_000, seed=1)
    error = samples.weight.std(axis=0) / np.sqrt(len(samples))
    np.testing.assert_array_less(
        np.abs(samples.weight.mean(axis=0) - np.asarray(model.albedo(wi))), 4.5 * error + 1e-5
    )


def test_a_mirror_below_is_the_limit_of_narrow_bases():
    settings = {"eta": 1.5, "alpha": 0.2, "tau": 0.1}
    bare = models.create("layered(lambert)", base_kd=0.0, **settings)
    mirror = models.create("layered(specular)", base_ks=0.8, **settings)
    narrow = models.create(
        "layered(torrance_sparrow:ggx:smith:none:no_diffuse)", base_ks=0.8, base_alpha=1e-3, **settings
    )
    for cosine in (1.0, 0.7, 0.3):
        wi = unit(cosine, 0.3)
        coat = np.asarray(bare.albedo(wi))
        np.testing.assert_allclose(mirror.albedo(wi) - coat, narrow.albedo(wi) - coat, rtol=2e-3)
        samples = mirror.sample(wi, 100_000, seed=3)
        np.testing.assert_allclose(samples.weight.mean(axis=0), mirror.albedo(wi), rtol=2e-2)
        np.testing.assert_allclose(
            samples.wo[samples.is_delta], np.broadcast_to(wi * [-1, -1, 1], (samples.is_delta.sum(), 3))
        )


def test_a_base_that_transmits_is_refused():
    with pytest.raises(SpecError, match="transmits"):
        models.create("layered(rough_dielectric)")
