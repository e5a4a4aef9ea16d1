"""What every reflectance model must keep: finite, reciprocal, normalised, differentiable, in its dtype."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fitter import SpecError, models
from fitter.models.base import _evaluate, _pdf
from tests.models import MODELS
from tests.models.conftest import draw

EDGE = st.sampled_from([1e-6, 1e-3, 0.1, 0.5, 0.9, 1.0 - 1e-8, 1.0])
AZIMUTH = st.sampled_from([0.0, 1e-8, 0.5, np.pi / 2, np.pi - 1e-8, np.pi, 4.0])


def direction(mu: float, phi: float) -> np.ndarray:
    s = np.sqrt(max(0.0, 1.0 - mu * mu))
    return np.array([s * np.cos(phi), s * np.sin(phi), mu])


@pytest.mark.parametrize("name", MODELS)
@given(mu_i=EDGE, mu_o=EDGE, phi=AZIMUTH, seed=st.integers(0, 50))
def test_finite_and_differentiable_at_hard_directions(name, mu_i, mu_o, phi, seed):
    model = draw(name, seed)
    wi, wo = jnp.asarray(direction(mu_i, 0.0)), jnp.asarray(direction(mu_o, phi))
    value, slope = _value_and_slope(model, wi, wo)
    assert np.isfinite(value)
    assert value >= 0
    assert all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(slope))


@eqx.filter_jit
def _value_and_slope(model, wi, wo):
    def total(args):
        m, i, o = args
        return jnp.sum(m.evaluate(i, o))

    return total((model, wi, wo)), eqx.filter_grad(total)((model, wi, wo))


@pytest.mark.parametrize("name", MODELS)
def test_reciprocal(name):
    rng = np.random.default_rng(3)
    model = draw(name, 1)
    wi, wo = (_hemisphere(rng, 2000) for _ in range(2))
    there, back = np.asarray(model.evaluate(wi, wo)), np.asarray(model.evaluate(wo, wi))
    np.testing.assert_allclose(there, back, rtol=1e-11, atol=1e-300)


@pytest.mark.parametrize("name", MODELS)
def test_zero_below_the_horizon(name):
    model = draw(name, 2)
    up, down = direction(0.5, 0.3), direction(-0.5, 0.3)
    for wi, wo in ((up, down), (down, up), (down, down)):
        assert not np.asarray(model.evaluate(wi, wo)).any()


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("theta", [0.0, 30.0, 85.0])
def test_pdf_integrates_to_one_less_what_is_lost(name, theta):
    model = draw(name, 5)
    wi = direction(np.cos(np.deg2rad(theta)), 0.4)
    samples = model.sample(wi, 200_000, seed=11)
    lost = 1.0 - samples.valid.mean()
    # A quadrature that knows nothing of the lobes: the density itself must be right, not its own nodes.
    mu, w = np.polynomial.legendre.leggauss(1200)
    mu, w = 0.5 * (mu + 1), 0.5 * w
    phi = (np.arange(2400) + 0.5) * 2 * np.pi / 2400
    grid = _product(mu, phi)
    total = float((np.asarray(model.pdf(wi, grid)).sum(axis=1) * w).sum() * 2 * np.pi / 2400)
    assert total == pytest.approx(1.0 - lost, abs=4 * np.sqrt(max(lost, 1e-4) / 200_000) + 2e-3)


@pytest.mark.parametrize("name", MODELS)
def test_samples_follow_the_pdf(name):
    """Chi-square over bins of the hemisphere, 2e5 draws against the integrated density."""
    model = draw(name, 7)
    wi = direction(np.cos(np.deg2rad(40.0)), 0.0)
    n = 200_000
    samples = model.sample(wi, n, seed=3)
    bins_mu, bins_phi, fine = 8, 16, 60
    wo = samples.wo[samples.valid]
    row = np.minimum((wo[:, 2] * bins_mu).astype(int), bins_mu - 1)
    turn = np.arctan2(wo[:, 1], wo[:, 0]) / (2 * np.pi) % 1
    col = np.minimum((turn * bins_phi).astype(int), bins_phi - 1)
    counts = np.bincount(row * bins_phi + col, minlength=bins_mu * bins_phi)
    mu = (np.arange(bins_mu * fine) + 0.5) / (bins_mu * fine)
    phi = (np.arange(bins_phi * fine) + 0.5) / (bins_phi * fine) * 2 * np.pi
    density = np.asarray(model.pdf(wi, _product(mu, phi))).reshape(bins_mu, fine, bins_phi, fine)
    expected = n * density.mean(axis=(1, 3)).reshape(-1) * (2 * np.pi / (bins_mu * bins_phi))
    # Midpoint cells of a narrow lobe carry a relative error of their own: allow 1 %.
    keep = expected > 10
    chi2 = np.sum((counts - expected)[keep] ** 2 / (expected[keep] + (0.01 * expected[keep]) ** 2))
    assert chi2 < keep.sum() + 5 * np.sqrt(2 * keep.sum())


@pytest.mark.parametrize("name", MODELS)
def test_weights_estimate_the_albedo(name):
    model = draw(name, 9)
    wi = direction(np.cos(np.deg2rad(35.0)), 1.0)
    samples = model.sample(wi, 400_000, seed=1)
    error = samples.weight.std(axis=0) / np.sqrt(len(samples))
    np.testing.assert_array_less(
        np.abs(samples.weight.mean(axis=0) - np.asarray(model.albedo(wi))), 4.5 * error + 1e-4
    )


@pytest.mark.parametrize("name", MODELS)
def test_same_seed_same_draws(name):
    model = draw(name, 9)
    wi = direction(0.7, 0.0)
    first, again, other = (model.sample(wi, 1000, seed=s) for s in (4, 4, 5))
    np.testing.assert_array_equal(first.wo, again.wo)
    assert (first.wo != other.wo).any()
    assert first.seed == 4


@pytest.mark.parametrize("name", MODELS)
def test_float32_stays_float32(name):
    model = draw(name, 9)
    wi = jnp.asarray(direction(0.7, 0.0), jnp.float32)
    wo = jnp.asarray(_hemisphere(np.random.default_rng(0), 64), jnp.float32)
    values = {k: v.astype(jnp.float32) for k, v in model.values.items()}
    single = eqx.tree_at(lambda m: m.values, model, values)
    for kernel in (_evaluate, _pdf):
        # The traced program may name constants in f64; what is compiled may not.
        assert "f64" not in kernel.lower(single, wi, wo).compile().compiled.as_text()
    assert model.evaluate(wi, wo).dtype == jnp.float32
    np.testing.assert_allclose(
        np.asarray(model.evaluate(wi, wo)), np.asarray(model.evaluate(wi.astype(float), wo.astype(float))),
        rtol=2e-3, atol=1e-12,
    )  # fmt: skip


@pytest.mark.parametrize("name", MODELS)
def test_document_round_trip(name):
    model = draw(name, 4)
    again = models.from_dict(model.to_dict())
    assert again.spec == model.spec
    wi, wo = _hemisphere(np.random.default_rng(1), 50), _hemisphere(np.random.default_rng(2), 50)
    np.testing.assert_array_equal(np.asarray(model.evaluate(wi, wo)), np.asarray(again.evaluate(wi, wo)))


@pytest.mark.parametrize(
    ("name", "values", "parameter"),
    [
        ("ward", {"alpha": -1.0}, "alpha"),
        ("ward", {"alpha": np.nan}, "alpha"),
        ("ward", {"shine": 1.0}, "shine"),
        ("torrance_sparrow", {"f0": 1.5}, "f0"),
        ("lafortune", {"kd": [0.1, 0.2], "n": [1.0, 2.0, 3.0]}, None),
    ],
)
def test_bad_parameters_are_named(name, values, parameter):
    with pytest.raises(SpecError) as caught:
        models.create(name, **values)
    assert caught.value.parameter == parameter
    assert caught.value.remedy


def test_unknown_model_names_the_known_ones():
    with pytest.raises(SpecError, match="ward, torrance_sparrow, lafortune, oren_nayar"):
        models.create("phong")


def test_sampling_needs_an_incidence_above_the_horizon():
    model = models.create("ward")
    with pytest.raises(SpecError, match="below the horizon"):
        model.sample([0.0, 0.6, -0.8], 10, seed=1)
    with pytest.raises(SpecError, match="n is 0"):
        model.sample([0.0, 0.0, 1.0], 0, seed=1)


def test_parameter_table_documents_itself():
    for name in MODELS:
        for p in models.parameter_table(name):
            document = p.to_dict()
            assert document["description"]
            assert document["unit"]
            assert document["prior"]


def _product(mu: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """(len(mu), len(phi), 3) directions of all pairs."""
    s = np.sqrt(1 - mu * mu)[:, None]
    z = np.broadcast_to(mu[:, None], (len(mu), len(phi)))
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=-1)


def _hemisphere(rng: np.random.Generator, n: int) -> np.ndarray:
    mu, phi = rng.uniform(0.01, 1.0, n), rng.uniform(0, 2 * np.pi, n)
    s = np.sqrt(1 - mu * mu)
    return np.stack([s * np.cos(phi), s * np.sin(phi), mu], axis=1)
