"""Rough interfaces: transmission against 50 digits, its energy, its symmetry, its draws, its limits."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

from fitter import SpecError, models
from fitter.models import refraction
from fitter.models.pair import Pair
from tests.models.fifty_digits import DIGITS, excess
from tests.models.statistics import finite

NAMES = (
    "rough_dielectric", "rough_dielectric:beckmann", "rough_dielectric:smith_separable",
    "rough_dielectric:beckmann:smith_separable",
)  # fmt: skip


def unit(cosine: float, phi: float, side: float = 1.0) -> np.ndarray:
    sine = np.sqrt((1 - cosine) * (1 + cosine))
    return np.array([sine * np.cos(phi), sine * np.sin(phi), side * cosine])


def distribution(kind: str, alpha: mp.mpf, x: mp.mpf, y: mp.mpf, z: mp.mpf) -> mp.mpf:
    tan2 = (x * x + y * y) / (z * z)
    if kind == "ggx":
        return (1 + tan2) ** 2 / (mp.pi * alpha**2 * (1 + tan2 / alpha**2) ** 2)
    return mp.exp(-tan2 / alpha**2) * (1 + tan2) ** 2 / (mp.pi * alpha**2)


def smith_lambda(kind: str, alpha: mp.mpf, x: mp.mpf, y: mp.mpf, z: mp.mpf) -> mp.mpf:
    square = alpha**2 * (x * x + y * y) / (z * z)
    if kind == "ggx" or not square:
        return (mp.sqrt(1 + square) - 1) / 2
    a = 1 / mp.sqrt(square)
    return mp.exp(-a * a) / (2 * a * mp.sqrt(mp.pi)) - mp.erfc(a) / 2


def _transmission(kind: str, masking: str, *inputs: mp.mpf) -> mp.mpf:
    ix, iy, iz, ox, oy, oz, eta, alpha = inputs
    ni, no = (1, eta) if iz > 0 else (eta, 1)
    x, y, z = (ni * a + no * b for a, b in ((ix, ox), (iy, oy), (iz, oz)))
    squared = x * x + y * y + z * z
    turn = (1 if z * iz > 0 else -1) / mp.sqrt(squared)
    a, b = turn * (ix * x + iy * y + iz * z), -turn * (ox * x + oy * y + oz * z)
    if iz * oz >= 0 or a <= 0 or b <= 0:
        return mp.mpf(0)
    power = 2 * ni * no * a * b * (1 / (ni * a + no * b) ** 2 + 1 / (no * a + ni * b) ** 2)
    li, lo = smith_lambda(kind, alpha, ix, iy, abs(iz)), smith_lambda(kind, alpha, ox, oy, abs(oz))
    g = 1 / ((1 + li) * (1 + lo)) if masking == "smith_separable" else mp.beta(1 + li, 1 + lo)
    return a * b * no**2 * power * g * distribution(kind, alpha, x, y, z) / (abs(iz * oz) * squared)


def _refracted(wi: np.ndarray, h: np.ndarray, eta: float) -> np.ndarray | None:
    """wo of the facet h on the side of wi, None where reflection is total or wo leaves on that side."""
    ratio = 1 / eta if wi[2] > 0 else eta
    c = h @ wi
    left = 1 - ratio**2 * (1 - c * c)
    if c <= 0 or left <= 0:
        return None
    wo = (ratio * c - np.sqrt(left)) * h - ratio * wi
    return wo / np.linalg.norm(wo) if wo[2] * wi[2] < 0 else None


def _cases(rng: np.random.Generator, count: int) -> np.ndarray:
    """Both sides, indices to 2e-3 from 1, grazing on either side, facets 1e-3 to 5 widths off the normal."""
    rows = []
    while len(rows) < count:
        eta, alpha = (
            rng.choice([0.4, 0.6, 0.9, 0.998, 1.002, 1.01, 1.33, 1.5, 2.5]),
            10 ** rng.uniform(-4, 0.3),
        )
        side = rng.choice([1.0, -1.0])
        cosine = rng.choice([1e-6, 1e-3, 1.0, rng.uniform(), 10 ** rng.uniform(-6, 0)])
        wi = unit(cosine, rng.choice([0.0, np.pi, rng.uniform(0, 6)]), side)
        how = rng.integers(4)
        if how:
            h = np.array([*(alpha * (1e-3, 1.0, 5.0)[how - 1] * unit(0.0, rng.uniform(0, 6))[:2]), side])
            wo = _refracted(wi, h / np.linalg.norm(h), eta)
        else:
            wo = unit(10 ** rng.uniform(-6, 0), rng.uniform(0, 6), -side)
        if wo is not None:
            rows.append([*wi, *wo, eta, alpha])
    return np.array(rows)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_fifty_digits(name, dtype):
    spec = models.create(name).spec
    cases = _cases(np.random.default_rng(11), 60).astype(dtype)
    found = []
    for row in cases:
        model = models.create(name, ks=0.0, eta=float(row[6]), alpha=float(row[7]))
        found.append(model.evaluate(jnp.asarray(row[:3]), jnp.asarray(row[3:6]))[0])
    found = np.array(found)
    assert (found > 0).mean() > 0.5
    over = excess(lambda *x: _transmission(spec.ndf, spec.masking, *x), list(cases.T), found, dtype)
    assert over.max() < 1


@pytest.mark.parametrize(("dtype", "bound"), [(np.float64, 5e-14), (np.float32, 1e-5)])
def test_opposed_masking_digits(dtype, bound):
    grid = np.array([0, 1e-6, 1e-3, 0.1, 1, 5, 30, 1e3, 1e6], dtype)
    for a in grid:
        for b in grid:
            with mp.workdps(DIGITS):
                x, y = mp.mpf(float(a)), mp.mpf(float(b))
                exact = mp.gammaprod([2 + x, 2 + y], [2 + x + y])
            found = refraction.opposed_masking(jnp.asarray(a), jnp.asarray(b))
            assert found.dtype == dtype
            if exact > 1e-20:
                assert abs(float(found) / float(exact) - 1) < bound
            else:
                assert 0 <= found < 1e-19


@pytest.mark.parametrize("name", NAMES)
def test_symmetry_is_that_of_radiance(name):
    """f(wi, wo) / n_o^2 = f(wo, wi) / n_i^2, with n = 1 above and eta below: reciprocal on one side."""
    rng = np.random.default_rng(8)
    wi, wo = (
        np.stack([unit(rng.uniform(0, 1), rng.uniform(0, 6), rng.choice([1, -1])) for _ in range(400)])
        for _ in range(2)
    )
    eta = 1.6
    model = models.create(name, eta=eta, alpha=0.4)
    assert not model.reciprocal(model.spec)
    there, back = np.asarray(model.evaluate(wi, wo))[:, 0], np.asarray(model.evaluate(wo, wi))[:, 0]
    index_i, index_o = (np.where(w[:, 2] > 0, 1.0, eta) for w in (wi, wo))
    assert (there > 0).any()
    np.testing.assert_allclose(there / index_o**2, back / index_i**2, rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "dtype"),
    [
        (NAMES[0], np.float32), (NAMES[0], np.float64),
        *zip(NAMES[1:], (np.float32, np.float64, np.float32), strict=True),
        ("rough_dielectric:anisotropic", np.float64),
    ],
)  # fmt: skip
def test_slopes_are_finite(name, dtype):
    """In all parameters and directions, either side, at grazing, normal, mirror, straight on and critical."""
    critical = np.sqrt(1 - 1 / 1.5**2)
    cosines, azimuths = (1e-6, 1e-3, critical, 1.0), (0.0, 1e-8, 1.0, np.pi - 1e-8, np.pi)
    sides = ((1, 1), (1, -1), (-1, 1), (-1, -1))
    wi = np.stack([unit(i, 0.0, s) for i in cosines for _ in cosines for _ in azimuths for s, _ in sides])
    wo = np.stack([unit(o, phi, s) for _ in cosines for o in cosines for phi in azimuths for _, s in sides])
    wi = np.concatenate([wi, wi])
    wo = np.concatenate([wo, -wi[: len(wo)]])
    model = models.create(name)

    @jax.jit
    @jax.value_and_grad
    def total(args):
        values, i, o = args
        return jnp.sum(jnp.stack(type(model).terms(model.spec, values, Pair.split(i, o))))

    for eta, width in ((0.4, 1e-4), (1.5, 0.3), (2.5, 2.0), (1.0011, 1e-4)):
        values = {k: dtype(width if k.startswith("alpha") else v) for k, v in model.nonlinear.items()}
        values["eta"] = dtype(eta)
        found, slope = total((values, jnp.asarray(wi, dtype), jnp.asarray(wo, dtype)))
        assert found.dtype == dtype
        assert np.isfinite(found)
        assert finite(slope)


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("eta", "cosine", "side"), [(1.5, 0.8, 1), (1.5, 0.3, -1), (0.6, 0.9, 1), (2.4, 0.1, 1)]
)
def test_draws_carry_the_energy(name, eta, cosine, side):
    """Weights estimate reflectance and transmittance, each by quadrature; together they are at most 1."""
    model = models.create(name, eta=eta, alpha=0.25)
    wi = unit(cosine, 0.6, side)
    n = 200_000
    samples = model.sample(wi, n, seed=1)
    reflectance, transmittance = model.albedo(wi), model.transmittance(wi)
    assert float(reflectance[0] + transmittance[0]) < 1 + 1e-4
    for there, expected in (
        (samples.wo[:, 2] * side > 0, reflectance),
        (samples.wo[:, 2] * side < 0, transmittance),
    ):
        weight = np.where(there[:, None], samples.weight, 0.0)
        error = weight.std(axis=0) / np.sqrt(n)
        np.testing.assert_array_less(np.abs(weight.mean(axis=0) - np.asarray(expected)), 4.5 * error + 2e-4)
    # Drawn facets are those seen from wi: what is left is masking on the way out (4/e more for Beckmann's).
    assert samples.weight.max() < (1.0 + 1e-12 if "beckmann" not in name else 2.5)
    assert not samples.weight[~samples.valid].any()


@pytest.mark.parametrize(("eta", "cosine", "side"), [(1.5, 0.8, 1), (1.5, 0.5, -1), (0.6, 0.4, 1)])
def test_density_integrates_to_what_is_not_lost(eta, cosine, side):
    model = models.create("rough_dielectric", eta=eta, alpha=0.3)
    wi = unit(cosine, 0.2, side)
    lost = 1 - model.sample(wi, 400_000, seed=5).valid.mean()
    mu, w = np.polynomial.legendre.leggauss(400)
    phi = (np.arange(800) + 0.5) * 2 * np.pi / 800
    sine = np.sqrt(1 - mu * mu)[:, None]
    wo = np.stack([sine * np.cos(phi), sine * np.sin(phi), np.broadcast_to(mu[:, None], (400, 800))], axis=-1)
    total = float((np.asarray(model.pdf(wi, wo)).sum(axis=1) * w).sum() * 2 * np.pi / 800)
    assert total == pytest.approx(1 - lost, abs=4.5 * np.sqrt(max(lost, 1e-4) / 400_000) + 3e-4)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("eta", "side"), [(1.5, 1), (1.5, -1), (0.4, 1), (1.002, 1)])
def test_narrow_lobes_draw_bounded_weights(dtype, eta, side):
    model = models.create("rough_dielectric", eta=eta, alpha=1e-2)
    for cosine in (1.0, 0.8, 0.3, 1e-3):
        samples = model.sample(unit(cosine, 0.3, side).astype(dtype), 20_000, seed=3)
        assert samples.wo.dtype == dtype
        assert np.isfinite(samples.weight).all()
        assert samples.weight.max() <= 1 + (1e-3 if dtype == np.float32 else 1e-9)


@pytest.mark.parametrize("eta", [1.5, 0.7])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_smooth_limit(eta, side):
    """As alpha goes to 0 the shares become those of the smooth interface, total reflection included."""
    rough, smooth = (
        models.create("rough_dielectric", eta=eta, alpha=1e-3),
        models.create("smooth_dielectric", eta=eta),
    )
    for cosine in (1.0, 0.9, 0.5):
        wi = unit(cosine, 0.0, side)
        np.testing.assert_allclose(rough.albedo(wi), smooth.albedo(wi), atol=1e-4)
        np.testing.assert_allclose(rough.transmittance(wi), smooth.transmittance(wi), atol=1e-3)


def test_refraction_peaks_where_snell_says():
    model = models.create("rough_dielectric", ks=0.0, eta=1.5, alpha=0.02)
    wi = unit(0.6, 0.0)
    theta = np.linspace(0.0, np.pi / 2, 2001)[:-1]
    wo = np.stack([-np.sin(theta), 0 * theta, -np.cos(theta)], axis=-1)
    peak = theta[np.argmax(np.asarray(model.evaluate(wi, wo))[:, 0])]
    assert np.sin(peak) == pytest.approx(0.8 / 1.5, abs=2e-3)


def test_each_channel_may_have_its_index():
    together = models.create("rough_dielectric", eta=[1.3, 1.5, 1.9], alpha=0.2)
    wi, wo = unit(0.5, 0.1), np.stack([unit(0.8, 3.2, -1), unit(0.7, 3.0), unit(0.9, 1.0, -1)])
    for channel, eta in enumerate((1.3, 1.5, 1.9)):
        alone = models.create("rough_dielectric", eta=eta, alpha=0.2)
        np.testing.assert_allclose(
            together.evaluate(wi, wo)[:, channel], alone.evaluate(wi, wo)[:, 0], rtol=1e-13
        )
    samples = together.sample(wi, 200_000, seed=9)
    error = samples.weight.std(axis=0) / np.sqrt(len(samples))
    whole = np.asarray(together.albedo(wi) + together.transmittance(wi))
    np.testing.assert_array_less(np.abs(samples.weight.mean(axis=0) - whole), 4.5 * error + 2e-4)


@pytest.mark.parametrize("eta", [1.0, 1.0005, [1.5, 0.9995, 1.4]])
def test_no_contrast_is_refused(eta):
    with pytest.raises(SpecError, match="undeviated"):
        models.create("rough_dielectric", eta=eta)


@pytest.mark.parametrize("eta", [1.0, 1.0 - 1e-12])
def test_no_contrast_inside_a_program_is_finite(eta):
    """An optimiser may pass through eta = 1: the straight direction has no number there, nor a NaN."""
    model = models.create("rough_dielectric", eta=1.5)

    def total(eta):
        values = {**model.nonlinear, "eta": eta}
        wi, wo = unit(0.5, 0.0), np.stack([-unit(0.5, 0.0), unit(0.5, np.pi), unit(0.9, 1.0, -1)])
        return jnp.sum(jnp.stack(type(model).terms(model.spec, values, Pair.split(wi, wo))))

    found, slope = jax.value_and_grad(total)(jnp.asarray(eta))
    assert np.isfinite(found)
    assert np.isfinite(slope)
