"""Likelihoods beside Gaussian noise: outliers, angles that are off; and what stands beside a posterior."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import fitter
from fitter import Metadata, SpecError, Table, directions, models
from fitter.fitting.layout import layout
from fitter.posterior.beside import rescaled
from fitter.posterior.density import Data, Noise, log_likelihood
from fitter.posterior.jackknife import Robust
from fitter.posterior.offsets import shifted, tangents
from tests.fitting.conftest import scattered
from tests.posterior.test_jackknife import gained

QUICK = {"rhat": 1.05, "ess": 400, "budget_seconds": 300.0, "seed": 5}
TRUTH = {"kd": 0.2, "ks": 0.06, "alpha": 0.15}


def draws_of(post, label):
    return post.draws[:, post.labels.index(label)]


def test_student_t_is_the_density_it_says():
    """Against SciPy's, with the table's scale and with an inferred one."""
    from scipy import stats

    model = models.create("ward", channels=["c"], **TRUTH)
    table = scattered(model, seed=2, n=50, noise=0.1, sigma=True)
    fit = fitter.fit(table, "ward")
    places = layout(fit.spec)
    pair = np.concatenate([table.wi.T, table.wo.T])
    for y in (np.array([0.2, 0.06, np.log(0.15)]), np.array([0.25, 0.05, np.log(0.2)])):
        other = models.create("ward", channels=["c"], kd=y[0], ks=y[1], alpha=np.exp(y[2]))
        f = np.asarray(other.evaluate(table.wi, table.wo))
        known = Data(pair, table.value.T, table.sigma.T)
        ours = log_likelihood(places, Noise(3.0), jnp.asarray(y), known)
        exact = stats.t.logpdf((table.value - f) / table.sigma, 3.0).sum()
        constant = len(table) * stats.t.logpdf(0.0, 3.0)
        assert float(ours) == pytest.approx(exact - constant, rel=1e-9)
        scale = np.hypot(0.08 * f, 0.003)
        inferred = Data(pair, table.value.T, None)
        found = log_likelihood(places, Noise(3.0), jnp.asarray([*y, 0.08, 0.003]), inferred)
        exact = stats.t.logpdf(table.value, 3.0, loc=f, scale=scale).sum()
        assert float(found) == pytest.approx(exact - constant, rel=1e-9)


def test_outliers_move_student_t_less():
    model = models.create("ward", **TRUTH)
    clean = scattered(model, seed=1, n=300, noise=0.03, sigma=True)
    value = clean.value.copy()
    value[::30] *= 1.5
    table = Table(wi=clean.wi, wo=clean.wo, value=value, sigma=clean.sigma)
    fit = fitter.fit(table, "ward")
    plain = fitter.posterior(table, fit, **QUICK)
    heavy = fitter.posterior(table, fit, likelihood="student_t", **QUICK)
    assert heavy.status == "converged", heavy.message
    off = [abs(draws_of(post, "kd[value]").mean() - TRUTH["kd"]) for post in (plain, heavy)]
    assert off[1] < 0.3 * off[0]
    assert heavy.noise["degrees_of_freedom"] == 4.0
    # Beside it: what Gaussian noise would have said, by its name.
    assert plain.uncertainties["naive"] is None
    beside = heavy.uncertainties["naive"]["u"]["kd[value]"]
    assert beside == pytest.approx(plain.uncertainties["posterior"]["u"]["kd[value]"], rel=0.15)
    # New measurements have the tails, too.
    new = scattered(model, seed=9, n=400, noise=0.03)
    width = [np.subtract(*post.predict(new.wi, new.wo, level=0.99)[::-1]).mean() for post in (plain, heavy)]
    assert width[1] > 1.5 * width[0]


def test_directions_turn_by_the_offsets():
    """Against spherical angles, in and out of the plane, with the normal in it."""
    theta_i, theta_o = np.deg2rad([0.0, 30.0, 60.0, 20.0]), np.deg2rad([40.0, 0.0, 50.0, 70.0])
    phi = np.deg2rad([180.0, 180.0, 90.0, 180.0])
    wi = directions.vector_from_spherical(theta_i, 0.0)
    wo = directions.vector_from_spherical(theta_o, phi)
    pair = np.concatenate([wi.T, wo.T])
    off = np.deg2rad([0.3, -0.5, 0.7])
    found = np.asarray(shifted(pair, tangents(pair, signed=False), off))
    there = directions.vector_from_spherical(theta_i + off[0], 0.0)
    np.testing.assert_allclose(found[:3].T, there, atol=1e-14)
    there = directions.vector_from_spherical(theta_o + off[1], phi + off[2])
    np.testing.assert_allclose(found[3:].T, there, atol=1e-14)
    # An arm whose angle has a sign: -20 deg becomes -19.5 deg.
    wo = directions.vector_from_spherical(np.deg2rad([20.0]), 0.0)
    pair = np.concatenate([wi[2:3].T, wo.T])
    found = np.asarray(shifted(pair, tangents(pair, signed=True), np.array([0.0, np.deg2rad(0.5)])))
    there = directions.vector_from_spherical(np.deg2rad(19.5), 0.0)
    np.testing.assert_allclose(found[3:, 0], there, atol=1e-14)


def turned(offset_deg, seed=3, stated=None):
    """A glossy surface measured with theta_o read that much too small, in scans out of the plane, too."""
    model = models.create("ward", channels=["value"], kd=0.2, ks=0.1, alpha=0.1)
    table = scattered(model, seed=seed, n=400, noise=0.0)
    theta, phi = directions.spherical_from_vector(table.wo)
    actual = directions.vector_from_spherical(np.minimum(theta + np.deg2rad(offset_deg), 1.55), phi)
    value = np.asarray(model.evaluate(table.wi, actual))
    value = value * (1 + 0.02 * np.random.default_rng(seed).standard_normal(value.shape))
    stated = None if stated is None else float(np.deg2rad(stated))
    return Table(
        wi=table.wi, wo=table.wo, value=value, sigma=0.02 * value, metadata=Metadata(angle_uncertainty=stated)
    )


def test_an_angle_offset_is_found_and_the_parameters_with_it():
    table = turned(0.5, stated=0.4)
    fit = fitter.fit(table, "ward")
    post = fitter.posterior(table, fit, angles="offset", **QUICK)
    assert post.labels[-3:] == ("theta_i_offset", "theta_o_offset", "phi_offset")
    # theta_i and theta_o move the mirror direction alike: their difference is what is measured.
    difference = draws_of(post, "theta_o_offset") - draws_of(post, "theta_i_offset")
    assert np.rad2deg(difference.mean()) == pytest.approx(0.5, abs=0.1)
    left_out = fitter.posterior(table, fit, **QUICK)
    assert any("angle uncertainty of 0.4 deg is not in these draws" in one for one in left_out.warnings)
    assert not any(label.endswith("_offset") for label in left_out.labels)
    off, wide = (
        abs(draws_of(one, "alpha").mean() - 0.1) / draws_of(one, "alpha").std() for one in (left_out, post)
    )
    assert wide < 3 < off
    # Named beside it: the uncertainty with angles exactly as stated, which is smaller.
    naive = post.uncertainties["naive"]["u"]["kd[value]"]
    assert naive == pytest.approx(left_out.uncertainties["posterior"]["u"]["kd[value]"], rel=0.2)


@pytest.mark.long
def test_offsets_are_common_to_channels_that_share_nothing_else():
    model = models.create("lafortune", channels=["R", "G"], kd=0.2, ks=0.2, gamma=[0.75, 0.8], n=[20.0, 30.0])
    table = scattered(model, seed=5, n=200, noise=0.05, sigma=True)
    fit = fitter.fit(table, "lafortune")
    post = fitter.posterior(table, fit, angle_uncertainty_deg=0.2, **QUICK)
    assert post.labels.count("theta_o_offset") == 1
    assert {"n[c0]", "n[c1]"} <= set(post.labels)
    assert post.status == "converged", post.message
    for k, label in enumerate(("n[c0]", "n[c1]")):
        low, high = np.quantile(draws_of(post, label), [0.0005, 0.9995])
        assert low < float(model.values["n"][k]) < high


def test_robust_draws_have_the_robust_covariance():
    """And the table's scans their gains: the stated likelihood's draws are far too narrow for them."""
    table = gained(1)
    fit = fitter.fit(table, "ward", metric="relative")
    plain = fitter.posterior(table, fit, **QUICK)
    wide = fitter.posterior(table, fit, draws="robust", **QUICK)
    robust = fitter.posterior.robust(table, fit)
    beside = wide.uncertainties
    assert beside["robust"]["u"] == pytest.approx(robust.standard_uncertainty)
    assert beside["posterior"] == plain.uncertainties["posterior"]
    for label, u in robust.standard_uncertainty.items():
        # Student's t with 7 degrees of freedom: its standard deviation is sqrt(7/5) of its scale.
        assert draws_of(wide, label).std() == pytest.approx(np.sqrt(7 / 5) * u, rel=0.15)
        assert draws_of(wide, label).mean() == pytest.approx(draws_of(plain, label).mean(), abs=0.1 * u)
        low, high = np.quantile(draws_of(wide, label), [0.025, 0.975])
        assert high - low == pytest.approx(2 * robust.coverage_factor * u, rel=0.15)
    assert draws_of(wide, "kd[value]").std() > 3 * draws_of(plain, "kd[value]").std()
    np.testing.assert_array_equal(draws_of(wide, "noise_floor[value]"), draws_of(plain, "noise_floor[value]"))


def test_rescaled_draws_keep_to_their_range_and_to_what_is_stated():
    rng = np.random.default_rng(0)
    model = models.create("ward", channels=["c"], kd=0.001, ks=0.1, alpha=0.2)
    draws = np.abs(np.array([0.001, 0.1, 0.2]) + rng.standard_normal((4000, 3)) * [0.0005, 0.001, 0.002])
    labels = ("kd[c]", "ks[c]", "alpha")
    covariance = np.diag([0.01, 0.02, np.nan]) ** 2
    robust = Robust(
        labels, {"kd[c]": 0.01, "ks[c]": 0.02, "alpha": np.nan}, covariance, np.inf, 1.96, "jackknife", 9, "",
        (1.0,), {},
    )  # fmt: skip
    found = rescaled(draws, labels, model, robust, rng)
    assert (found[:, 0] >= 0).all()
    assert found[:, 1].std() == pytest.approx(0.02, rel=0.05)
    np.testing.assert_array_equal(found[:, 2], draws[:, 2])


def test_a_common_scale_error_is_named_and_not_sampled():
    model = models.create("ward", **TRUTH)
    made = scattered(model, seed=1, n=300, noise=0.05, sigma=True)
    table = Table(
        wi=made.wi, wo=made.wo, value=made.value, sigma=made.sigma, metadata=Metadata(scale_uncertainty=0.03)
    )
    fit = fitter.fit(table, "ward")
    with_it, without = fitter.posterior(table, fit, **QUICK), fitter.posterior(made, fit, **QUICK)
    np.testing.assert_array_equal(with_it.draws, without.draws)
    with pytest.raises(SpecError, match="the table states none"):
        fitter.posterior(table, fit, angles="offset")
    assert any("scale uncertainty of 3 % is not in these draws" in warning for warning in with_it.warnings)


def test_settings_out_of_range():
    for settings in ({"likelihood": "cauchy"}, {"degrees_of_freedom": 0.5}, {"angle_uncertainty_deg": 9.0},
                     {"draws": "wide"}):  # fmt: skip
        with pytest.raises(SpecError):
            fitter.posterior(None, None, **settings)
