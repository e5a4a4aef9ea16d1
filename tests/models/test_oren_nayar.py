"""Oren-Nayar against its authors' angles, published albedos and its own energy balance."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitter import SpecError, models

VARIANTS = ("oren_nayar", "oren_nayar:full", "oren_nayar:fujii", "oren_nayar:eon")


def direction(mu: float, phi: float = 0.0) -> np.ndarray:
    s = math.sqrt((1 - mu) * (1 + mu))
    return np.array([s * math.cos(phi), s * math.sin(phi), mu])


@pytest.mark.long
@pytest.mark.measured
@pytest.mark.parametrize("kind", ["with", "without"])
def test_full_form_has_the_published_albedo(shared: Path, kind: str):
    with (shared / "oracles" / "directional_albedo.csv").open() as stream:
        rows = [r for r in csv.DictReader(stream) if r["model"].endswith(f"rho=1 {kind} interreflection")]
    assert len(rows) == 40
    # Interreflection is of second order in rho: next to nothing is left of it at 1e-9.
    rho = 1.0 if kind == "with" else 1e-9
    for row in rows:
        model = models.create("oren_nayar:full", rho=rho, sigma=float(row["parameter"]))
        found = float(model.albedo(direction(float(row["mu"])))[0]) / rho
        assert found == pytest.approx(float(row["albedo"]), abs=2e-6)


@pytest.mark.parametrize(
    ("mu", "albedo"), [(1, 0.77652207), (0.5, 0.86531955), (0.1, 0.97430675), (0.01, 0.99751722)]
)
def test_fujii_has_the_published_albedo(mu: float, albedo: float):
    model = models.create("oren_nayar:fujii", rho=1.0, sigma=1.0)
    assert float(model.albedo(direction(mu))[0]) == pytest.approx(albedo, abs=1e-8)


@pytest.mark.long
@pytest.mark.parametrize("sigma", [0.0, 1e-8, 0.1, 0.5, 1.0])
def test_eon_preserves_energy(sigma: float):
    white = models.create("oren_nayar:eon", rho=1.0, sigma=sigma)
    grey = models.create("oren_nayar:eon", rho=0.8, sigma=sigma)
    for mu in (1.0, 0.7, 0.3, 1e-2, 1e-4, 1e-6):
        assert float(white.albedo(direction(mu))[0]) == pytest.approx(1.0, abs=1e-13)
        assert float(grey.albedo(direction(mu))[0]) <= 0.8 + 1e-13


@pytest.mark.parametrize("name", VARIANTS)
def test_smooth_is_lambertian(name: str):
    model = models.create(name, rho=0.6, sigma=0.0)
    found = np.asarray(model.evaluate(direction(0.3, 1.0), direction(1e-6, 4.0)))
    np.testing.assert_allclose(found, 0.6 / math.pi, rtol=1e-15)


def test_full_form_is_that_of_the_paper():
    """The printed expression in angles, away from where angles lose digits."""
    rng = np.random.default_rng(2)
    mu, phi = rng.uniform(0.1, 0.95, (2, 500)), rng.uniform(0, 2 * np.pi, (2, 500))
    sigma, rho = 0.7, 0.9
    theta = np.arccos(mu)
    a, b, cos_dphi = theta.max(axis=0), theta.min(axis=0), np.cos(phi[0] - phi[1])
    s2 = sigma**2
    c1, q = 1 - 0.5 * s2 / (s2 + 0.33), s2 / (s2 + 0.09)
    c2 = 0.45 * q * (np.sin(a) - np.where(cos_dphi >= 0, 0, (2 * b / np.pi) ** 3))
    c3 = 0.125 * q * (4 * a * b / np.pi**2) ** 2
    single = c1 + cos_dphi * c2 * np.tan(b) + (1 - np.abs(cos_dphi)) * c3 * np.tan((a + b) / 2)
    double = 0.17 * s2 / (s2 + 0.13) * (1 - cos_dphi * (2 * b / np.pi) ** 2)
    wi, wo = (
        np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), m], axis=1)
        for t, p, m in zip(theta, phi, mu, strict=True)
    )
    found = models.create("oren_nayar:full", rho=rho, sigma=sigma).evaluate(wi, wo)[:, 0]
    np.testing.assert_allclose(np.asarray(found), (rho * single + rho**2 * double) / np.pi, rtol=1e-12)


def test_full_form_is_not_clamped():
    """Published so: below 0 between opposed directions near grazing from sigma = 0.67 on, and only there."""
    wi, wo = direction(1e-6), direction(1e-6, math.pi)
    for sigma, negative in ((0.66, False), (0.68, True), (math.pi / 2, True)):
        model = models.create("oren_nayar:full", rho=1e-9, sigma=sigma)
        assert (float(model.evaluate(wi, wo)[0]) < 0) is negative


HARD = [
    (direction(1.0), direction(1.0)),
    (direction(1.0), direction(1e-6)),
    (np.array([1e-10, 0, 1.0]), np.array([0, -1e-12, 1.0])),
    (np.array([1e-25, 0, 1.0]), np.array([0, -1e-30, 1.0])),
    (direction(0.5, 1.0), direction(0.5, 1.0)),
    (direction(0.5, 1.0), direction(0.5, 1.0 + math.pi)),
    (direction(0.5, 0.0), direction(0.3, math.pi / 2)),
    (direction(1e-6), direction(1e-6)),
    (direction(1e-6), direction(1e-6, math.pi)),
    (direction(1e-6), direction(1e-6, math.pi / 2)),
]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", VARIANTS)
@pytest.mark.parametrize("sigma", [0.0, 0.5, 1.0])
def test_slopes_are_finite_where_azimuths_and_ties_are_not_defined(name: str, sigma: float, dtype: type):
    model = models.create(name, rho=0.9, sigma=sigma)
    model = jax.tree.map(lambda leaf: leaf.astype(dtype), model)
    for wi, wo in HARD:
        value, slopes = _slopes(model, jnp.asarray(wi, dtype), jnp.asarray(wo, dtype))
        for leaf in jax.tree.leaves((value, slopes)):
            assert leaf.dtype == dtype
            assert np.isfinite(np.asarray(leaf)).all()


@eqx.filter_jit
def _slopes(model, wi, wo):
    total = lambda args: jnp.sum(args[0].evaluate(args[1], args[2]))  # noqa: E731
    return total((model, wi, wo)), eqx.filter_grad(total)((model, wi, wo))


@pytest.mark.parametrize("name", VARIANTS)
def test_rho_comes_back_from_the_coefficients(name: str):
    model = models.create(name, rho=[0.0, 0.4, 1.0], sigma=0.8)
    kind = models.family_of(model.spec)
    coefficients = kind.coefficients(model.spec, model.linear, model.nonlinear)
    back = kind.linear_from(model.spec, coefficients, model.nonlinear)
    np.testing.assert_array_equal(np.asarray(back["rho"]), [0.0, 0.4, 1.0])


def test_eon_takes_no_albedo_above_one():
    with pytest.raises(SpecError, match="rho"):
        models.create("oren_nayar:eon", rho=1.01)
