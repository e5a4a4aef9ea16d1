"""Kulla-Conty: nothing is lost, the table of what single scattering loses, and its derivative."""

from __future__ import annotations

import csv
from collections.abc import Callable
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitter import models
from fitter.models.scattering_loss import loss

COSINES = (1.0, 0.9, 0.5, 0.1, 0.02, 1e-3)


@cache
def program(ndf: str) -> Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
    """What is lost at cosines, and 1 less its average: one program for all alphas."""

    def run(alpha: jax.Array, mu: jax.Array) -> tuple[jax.Array, jax.Array]:
        found = loss(ndf, alpha)
        return found(mu), found.average

    return jax.jit(run)


@cache
def slopes(ndf: str) -> Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
    """The derivatives of what is lost, in alpha and in the cosine."""
    return jax.jit(jax.grad(lambda alpha, mu: loss(ndf, alpha)(mu), argnums=(0, 1)))


def direction(mu: float) -> np.ndarray:
    return np.array([np.sqrt(1 - mu * mu), 0.0, mu])


@pytest.mark.long
@pytest.mark.parametrize("ndf", ["ggx", "beckmann"])
@pytest.mark.parametrize("alpha", [1e-3, 0.01, 0.1, 0.5, 1.0, 2.0])
def test_white_furnace(ndf: str, alpha: float) -> None:
    model = models.create(f"kulla_conty:{ndf}:none", ks=1.0, alpha=alpha)
    albedo = np.asarray(model.albedo([direction(mu) for mu in COSINES]))
    assert np.abs(albedo - 1).max() < 1e-5


def test_a_metal_reflects_less_than_it_receives_and_more_than_once() -> None:
    f0 = [0.95, 0.6, 0.3]
    wi = [direction(mu) for mu in COSINES[:5]]
    all_of_it = np.asarray(models.create("kulla_conty", ks=1.0, f0=f0, alpha=0.8).albedo(wi))
    single = models.create("torrance_sparrow:ggx:smith:no_diffuse", ks=1.0, f0=f0, alpha=0.8)
    once = np.asarray(single.albedo(wi))
    assert (all_of_it < 1).all()
    gain = all_of_it / once - 1
    # The darker the facets, the less a second reflection adds.
    assert (np.diff(gain, axis=1) < 0).all()
    assert (gain > 0).all()


@pytest.mark.measured
@pytest.mark.parametrize(("prefix", "ndf"), [("GGX height", "ggx"), ("Beckmann height", "beckmann")])
def test_loss_against_the_oracle(shared: Path, prefix: str, ndf: str) -> None:
    with (shared / "oracles" / "directional_albedo.csv").open() as stream:
        rows = [row for row in csv.DictReader(stream) if row["model"].startswith(prefix)]
    assert len(rows) >= 40
    for row in rows:
        lost, _ = program(ndf)(jnp.asarray(float(row["parameter"])), jnp.asarray(float(row["mu"])))
        # The oracle is printed to six digits.
        assert 1 - float(lost) == pytest.approx(float(row["albedo"]), abs=1.5e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_loss_against_closed_forms(dtype: type) -> None:
    """GGX at alpha = 1 loses mu ln(1 + 1/mu), found by quadrature; averages are published."""
    mu = jnp.asarray(np.geomspace(1e-6, 1, 50), dtype)
    lost, _ = program("ggx")(jnp.asarray(1.0, dtype), mu)
    assert lost.dtype == dtype
    np.testing.assert_allclose(lost, mu * np.log1p(1 / np.asarray(mu)), atol=2e-6)
    for alpha, average in ((1.0, 0.40913709), (0.5, 0.70024047), (0.25, 0.88232338)):
        found = program("ggx")(jnp.asarray(alpha, dtype), mu)[1]
        assert 1 - float(found) == pytest.approx(average, abs=3e-7)


@pytest.mark.long
@pytest.mark.parametrize("ndf", ["ggx", "beckmann"])
@pytest.mark.parametrize("alpha", [1e-3, 0.05, 0.4, 1.5])
def test_loss_differentiates(ndf: str, alpha: float) -> None:
    """The program's derivatives equal differences of its values, in alpha and in the cosine."""

    def lost(a: jax.Array, mu: jax.Array) -> jax.Array:
        return program(ndf)(a, mu)[0]

    slope = slopes(ndf)
    for mu in (3e-3, 0.04, 0.3, 0.97):
        at, step = (jnp.asarray(alpha), jnp.asarray(mu)), 1e-4
        by_alpha = (lost(at[0] * (1 + step), at[1]) - lost(at[0] * (1 - step), at[1])) / (2 * step)
        by_mu = (lost(at[0], at[1] * (1 + step)) - lost(at[0], at[1] * (1 - step))) / (2 * step)
        found = slope(*at)
        assert float(found[0] * alpha) == pytest.approx(float(by_alpha), rel=1e-4, abs=1e-8)
        assert float(found[1] * mu) == pytest.approx(float(by_mu), rel=1e-4, abs=1e-8)


def test_one_table_per_channel() -> None:
    alphas = [0.1, 0.3, 0.7]
    wi, wo = direction(0.6), direction(0.3) * [-1, 1, 1]
    model = models.create("kulla_conty", ks=1.0, f0=0.5, alpha=alphas)
    apart = [models.create("kulla_conty", ks=1.0, f0=0.5, alpha=a).evaluate(wi, wo)[0] for a in alphas]
    np.testing.assert_allclose(model.evaluate(wi, wo), apart, rtol=1e-12)


def test_coefficients_and_back() -> None:
    kind = models.family_of(models.create("kulla_conty").spec)
    spec = models.create("kulla_conty").spec
    linear = {"ks": jnp.asarray([0.2, 0.9]), "f0": jnp.asarray([0.04, 1.0])}
    nonlinear = {"alpha": jnp.asarray(0.4)}
    back = kind.linear_from(spec, kind.coefficients(spec, linear, nonlinear), nonlinear)  # type: ignore[attr-defined]
    for name, value in linear.items():
        np.testing.assert_allclose(back[name], value, rtol=1e-14)
