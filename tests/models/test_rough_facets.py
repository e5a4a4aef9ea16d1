"""Rough facets: their limits, their quadrature, and what facets can't be."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitter import SpecError, models
from fitter.models import rough_facets
from tests.models.statistics import hemisphere


def lambertian(ndf: str, alpha: float, wi: np.ndarray, wo: np.ndarray) -> float:
    """The integral for white Lambertian facets by brute force: a fine even grid of slopes."""
    psi = (np.arange(1500) + 0.5) / 1500 * np.pi / 2
    rho = np.tan(psi)
    density = 2 / (1 + rho**2) ** 2 if ndf == "ggx" else 2 * np.exp(-(rho**2))
    weight = (density * rho * (1 + rho**2) * np.pi / 3000)[:, None]
    phi = (np.arange(720) + 0.5) * 2 * np.pi / 720
    t = alpha * rho[:, None]
    x, y = t * np.cos(phi), t * np.sin(phi)
    seen = np.prod([np.maximum(w[0] * x + w[1] * y + w[2], 0) for w in (wi, wo)], axis=0)
    mean = np.sum(weight * seen / np.sqrt(1 + t * t)) / 720

    def hidden(w: np.ndarray) -> float:
        a = w[2] / (alpha * np.hypot(w[0], w[1]))
        if ndf == "ggx":
            return (np.sqrt(1 + 1 / a**2) - 1) / 2
        return np.exp(-a * a) / (2 * a * np.sqrt(np.pi)) - 0.5 * float(jax.scipy.special.erfc(a))

    return mean / (np.pi * wi[2] * wo[2] * (1 + hidden(wi) + hidden(wo)))


@pytest.mark.parametrize(("ndf", "alpha"), [("ggx", 0.1), ("ggx", 0.5), ("beckmann", 0.1), ("beckmann", 0.6)])
def test_against_brute_force(ndf: str, alpha: float) -> None:
    model = models.create(f"rough_facets:{ndf}(lambert)", alpha=alpha, facet_kd=1.0)
    wi, wo = hemisphere(1, 12, 0.1), hemisphere(2, 12, 0.1)
    expected = [lambertian(ndf, alpha, i, o) for i, o in zip(wi, wo, strict=True)]
    np.testing.assert_allclose(np.asarray(model.evaluate(wi, wo))[:, 0], expected, rtol=1e-4)


@pytest.mark.long
@pytest.mark.parametrize(("ndf", "error"), [("ggx", 2e-5), ("beckmann", 1e-4)])
def test_more_nodes_change_nothing(monkeypatch: pytest.MonkeyPatch, ndf: str, error: float) -> None:
    wi, wo = hemisphere(3, 60), hemisphere(4, 60)
    model = models.create(f"rough_facets:{ndf}(lambert)", alpha=0.4)
    stated = np.asarray(model.evaluate(wi, wo))
    monkeypatch.setattr(rough_facets, "RADII", 48)
    monkeypatch.setattr(rough_facets, "AZIMUTHS", 48)
    jax.clear_caches()
    np.testing.assert_allclose(stated, model.evaluate(wi, wo), rtol=error)
    jax.clear_caches()


@pytest.mark.parametrize("facet", ["lambert", "oren_nayar", "lafortune:no_diffuse"])
def test_smooth_surface_is_the_facet(facet: str) -> None:
    wi, wo = hemisphere(5, 40, 0.1), hemisphere(6, 40, 0.1)
    rough = models.create(f"rough_facets({facet})", alpha=1e-4)
    # Beside a lobe there is the light of the few steep facets, of the order of alpha^2.
    np.testing.assert_allclose(
        rough.evaluate(wi, wo), models.create(facet).evaluate(wi, wo), rtol=2e-3, atol=1e-7
    )


@pytest.mark.long
def test_white_facets_lose_light_and_look_like_oren_nayar() -> None:
    """Retro-reflection brightens and forward scattering darkens, as in Oren and Nayar's V-grooves."""
    rough = models.create("rough_facets:beckmann(lambert)", alpha=0.6, facet_kd=1.0)
    grooves = models.create("oren_nayar", rho=1.0, sigma=0.4)
    s, c = np.sin(1.1), np.cos(1.1)
    wi = np.array([s, 0, c])
    wo = np.array([[s * np.cos(phi), s * np.sin(phi), c] for phi in np.linspace(0, np.pi, 9)])
    here, there = (np.asarray(m.evaluate(wi, wo))[:, 0] for m in (rough, grooves))
    assert (np.diff(here) < 0).all()
    assert np.corrcoef(here, there)[0, 1] > 0.9
    for mu in (1.0, 0.5, 0.1):
        draws = rough.sample([np.sqrt(1 - mu * mu), 0, mu], 4096, seed=1).weight
        assert 0.5 < draws.mean() < 1 - 4 * draws.std() / 64


def test_reciprocal_and_in_its_dtype() -> None:
    wi, wo = hemisphere(7, 300), hemisphere(8, 300)
    model = models.create("rough_facets(oren_nayar)", alpha=0.3)
    there = np.asarray(model.evaluate(wi, wo))
    np.testing.assert_allclose(there, model.evaluate(wo, wi), rtol=1e-12)
    narrow = model.evaluate(wi.astype(np.float32), wo.astype(np.float32))
    assert narrow.dtype == np.float32
    np.testing.assert_allclose(narrow, there, rtol=2e-5)


def test_each_channel_has_its_roughness() -> None:
    alphas = [0.05, 0.3, 0.9]
    wi, wo = hemisphere(9, 5), hemisphere(10, 5)
    model = models.create("rough_facets(lambert)", alpha=alphas, facet_kd=[0.2, 0.5, 0.9])
    for k, (alpha, kd) in enumerate(zip(alphas, (0.2, 0.5, 0.9), strict=True)):
        one = models.create("rough_facets(lambert)", alpha=alpha, facet_kd=kd)
        np.testing.assert_allclose(model.evaluate(wi, wo)[:, k], one.evaluate(wi, wo)[:, 0], rtol=1e-12)


def test_differentiates() -> None:
    wi, wo = jnp.asarray([0.6, 0.0, 0.8]), jnp.asarray([-0.3, 0.5, np.sqrt(0.66)])

    def value(alpha: jax.Array, o: jax.Array) -> jax.Array:
        model = models.create("rough_facets(lambert)", alpha=0.5)
        return type(model)(model.spec, model.channels, {**model.values, "alpha": alpha}).evaluate(wi, o)[0]

    by_alpha, by_wo = jax.grad(value, argnums=(0, 1))(jnp.asarray(0.5), wo)
    step = 1e-4
    difference = (value(jnp.asarray(0.5 + step), wo) - value(jnp.asarray(0.5 - step), wo)) / (2 * step)
    assert float(by_alpha) == pytest.approx(float(difference), rel=1e-3)
    along = jnp.asarray([0.0, step, 0.0])
    difference = (value(jnp.asarray(0.5), wo + along) - value(jnp.asarray(0.5), wo - along)) / (2 * step)
    assert float(by_wo[1]) == pytest.approx(float(difference), rel=1e-3)


@pytest.mark.parametrize(
    ("facet", "remedy"),
    [
        ("specular", "torrance_sparrow"),
        ("smooth_dielectric", "rough_dielectric"),
        ("ward:anisotropic", "iso"),
    ],
)
def test_what_facets_cannot_be(facet: str, remedy: str) -> None:
    with pytest.raises(SpecError, match=remedy):
        models.create(f"rough_facets({facet})")
