"""Posteriors: moves that keep their target, calibrated intervals, and an honest end."""

from __future__ import annotations

import emcee
import numpy as np
import pytest

import fitter
from fitter import FitSpec, ModelSpec, PosteriorSpec, SpecError, models
from fitter.fitting.layout import layout
from fitter.posterior import load_posterior
from fitter.posterior.density import Data, Density
from fitter.posterior.diagnostics import diagnose
from fitter.posterior.moves import DifferenceMove, IndependenceMove, mixture
from tests.fitting.conftest import TRUTHS, scattered

QUICK = {"rhat": 1.05, "ess": 400, "budget_seconds": 300.0, "seed": 5}


@pytest.fixture(scope="module")
def ward():
    model = models.create("ward", kd=0.2, ks=0.06, alpha=0.15)
    table = scattered(model, seed=1, n=300, noise=0.05, sigma=True)
    fit = fitter.fit(table, "ward")
    return model, table, fit, fitter.posterior(table, fit, **QUICK)


@pytest.mark.long
@pytest.mark.parametrize("dimension", [2, 9])
def test_moves_keep_a_correlated_normal(dimension):
    """Standard deviations of a known target to 5 %: emcee's own snooker move misses them by 13 %."""
    rng = np.random.default_rng(0)
    root = rng.standard_normal((dimension, dimension)) / np.sqrt(dimension) + np.eye(dimension)
    covariance = root @ root.T
    inverse = np.linalg.inv(covariance)

    def log_density(x):
        return -0.5 * np.einsum("wi,ij,wj->w", x, inverse, x)

    alone = [(IndependenceMove(np.zeros(dimension), 2.0 * covariance), 1.0)]
    differences = [(DifferenceMove(2), 0.7), (DifferenceMove(2, 1.0), 0.3)]
    for moves in (alone, differences, mixture(np.ones(dimension), covariance, 2)):
        sampler = emcee.EnsembleSampler(40, dimension, log_density, vectorize=True, moves=moves)
        sampler.random_state = np.random.RandomState(1).get_state()
        sampler.run_mcmc(rng.standard_normal((40, dimension)), 4000)
        draws = sampler.get_chain(discard=500, flat=True)
        sd = np.sqrt(np.diagonal(covariance))
        np.testing.assert_allclose(draws.std(axis=0), sd, rtol=0.05)
        np.testing.assert_allclose(draws.mean(axis=0), 0.0, atol=0.12 * sd.max())


@pytest.mark.parametrize("mirrors", [5, 1])
def test_moves_keep_a_normal_that_is_cut_off(monkeypatch, mirrors):
    """Correlated, with a bound at its middle and two at a standard deviation; against plain draws. With one
    mirror only, what lies beyond the other bounds is refused: as right, only slower."""
    monkeypatch.setattr("fitter.posterior.moves.MIRRORS", mirrors)
    rng = np.random.default_rng(1)
    covariance = np.array([[1.0, 0.6, 0.3], [0.6, 1.0, -0.2], [0.3, -0.2, 1.0]])
    inverse, lower, upper = np.linalg.inv(covariance), np.array([0.0, -9.0, -1.0]), np.array([9.0, 1.0, 9.0])

    def log_density(x):
        inside = ((x >= lower) & (x <= upper)).all(axis=1)
        return np.where(inside, -0.5 * np.einsum("wi,ij,wj->w", x, inverse, x), -np.inf)

    plain = rng.multivariate_normal(np.zeros(3), covariance, 400_000)
    plain = plain[np.isfinite(log_density(plain))]
    alone = [(IndependenceMove(plain.mean(axis=0), np.cov(plain.T), lower, upper), 1.0)]
    for moves in (alone, mixture(plain.mean(axis=0), np.cov(plain.T), 2, lower, upper)):
        sampler = emcee.EnsembleSampler(40, 3, log_density, vectorize=True, moves=moves)
        sampler.random_state = np.random.RandomState(1).get_state()
        sampler.run_mcmc(plain[:40], 2500)
        draws = sampler.get_chain(discard=100, flat=True)
        np.testing.assert_allclose(draws.mean(axis=0), plain.mean(axis=0), atol=0.03)
        np.testing.assert_allclose(np.cov(draws.T), np.cov(plain.T), atol=0.03)


def test_ensembles_know_nothing_of_each_other():
    """Two islands, an ensemble on each: a difference between walkers of both would be a way across."""

    def log_density(x):
        return -0.5 * np.square(np.abs(x) - 50.0).sum(axis=1)

    start = np.repeat([[-50.0], [50.0]], 12, axis=0) + np.random.default_rng(0).standard_normal((24, 1))
    moves = [(DifferenceMove(2), 0.5), (DifferenceMove(2, 1.0), 0.5)]
    sampler = emcee.EnsembleSampler(24, 1, log_density, vectorize=True, moves=moves)
    sampler.random_state = np.random.RandomState(0).get_state()
    sampler.run_mcmc(start, 500)
    chain = sampler.get_chain()
    assert chain[:, :12].max() < -40
    assert chain[:, 12:].min() > 40


def test_parts_of_the_walkers_are_the_whole(ward):
    """Evaluated in parts of one length, the last filled up: the same to rounding, none lost."""
    _, table, fit, _ = ward
    places = layout(fit.spec)
    pair = np.concatenate([table.wi.T, table.wo.T])
    y = np.array([0.2, 0.06, np.log(0.15)]) * (1 + 0.01 * np.arange(11)[:, None])
    found = [
        Density(
            places, Data(pair, table.value.T, table.sigma.T), np.array([0.0, 0.0, -7.0]),
            np.array([np.inf, np.inf, 0.0]), rows=rows,
        )(y)
        for rows in (0, 4, 11)
    ]  # fmt: skip
    np.testing.assert_allclose(found[1], found[0], rtol=1e-12)
    np.testing.assert_allclose(found[2], found[0], rtol=1e-12)


def test_folding_keeps_bounds_and_flat_priors():
    places = layout(FitSpec(model=ModelSpec.parse("ward")))
    nothing = np.zeros((1, 1))
    lower, upper = np.array([0.0, -2.0, 0.0]), np.array([np.inf, 1.0, 3.0])
    density = Density(places, Data(np.zeros((6, 1)), nothing, nothing + 1), lower, upper)
    x = np.random.default_rng(0).uniform(-9, 9, (60_000, 3))
    y = density.folded(x)
    assert (y >= density.lower).all()
    assert (y <= density.upper).all()
    inside = np.array([[0.3, 0.5, 1.5]])
    np.testing.assert_allclose(density.folded(inside), inside)
    for k in (1, 2):  # 18 is a whole number of periods: uniform in, uniform out
        counts, _ = np.histogram(y[:, k], bins=10)
        assert np.abs(counts / 6000 - 1).max() < 0.07


def test_stuck_walkers_are_seen():
    rng = np.random.default_rng(0)
    chains = rng.standard_normal((64, 200, 1))
    assert diagnose(chains)[0].rhat < 1.01
    chains[:4] = 6.0 + 0.01 * rng.standard_normal((4, 200, 1))
    assert diagnose(chains)[0].rhat > 1.05
    chains[:] = 1.0
    assert diagnose(chains)[0].ess_bulk == 0.0


def test_converges_on_the_truth_and_the_curvature(ward):
    model, _, fit, post = ward
    assert post.status == "converged", post.message
    assert post.labels == ("kd[value]", "ks[value]", "alpha")
    intervals = post.intervals(0.999)
    for label, name in (("kd[value]", "kd"), ("ks[value]", "ks"), ("alpha", "alpha")):
        true = float(np.asarray(model.values[name]).reshape(-1)[0])
        assert intervals[label]["lower"] < true < intervals[label]["upper"]
        # Well-specified, many samples: the posterior is its own Laplace approximation.
        u = float(fit.parameters[name].standard_uncertainty.reshape(-1)[0])
        assert intervals[label]["sd"] == pytest.approx(u, rel=0.12)


def test_same_seed_same_draws(ward):
    _, table, fit, post = ward
    again = fitter.posterior(table, fit, **QUICK)
    np.testing.assert_array_equal(again.draws, post.draws)  # nothing but the budget looks at the clock
    other = fitter.posterior(table, fit, **{**QUICK, "seed": 6})
    assert not np.array_equal(other.draws[:10], post.draws[:10])


def test_round_trip(ward, tmp_path):
    _, table, _, post = ward
    post.save(tmp_path / "posterior.json")
    read = load_posterior(tmp_path / "posterior.json")
    np.testing.assert_allclose(read.draws, post.draws)
    assert read.to_dict() == post.to_dict()
    np.testing.assert_allclose(
        read.predict(table.wi[:5], table.wo[:5]), post.predict(table.wi[:5], table.wo[:5])
    )


def test_predictive_band_covers_new_measurements(ward):
    model, _, _, post = ward
    new = scattered(model, seed=77, n=1500, noise=0.05)
    lower, upper = post.predict(new.wi, new.wo, level=0.9)
    inside = ((new.value >= lower) & (new.value <= upper)).mean()
    assert inside == pytest.approx(0.9, abs=0.04)


def test_inferred_noise_is_found():
    # A glossy table: where values hardly vary, a relative noise and a floor are the same thing.
    model = models.create("ward", **TRUTHS["ward"])
    table = scattered(model, seed=3, n=600, noise=0.04)
    post = fitter.posterior(table, fitter.fit(table, "ward"), **QUICK)
    for channel in "RGB":
        k = post.labels.index(f"relative_noise[{channel}]")
        assert post.draws[:, k].mean() == pytest.approx(0.04, rel=0.15)
    assert any("misfit counts as independent noise" in warning for warning in post.warnings)


def test_albedo_near_zero_stays_positive_and_finite():
    model = models.create("ward", kd=0.0, ks=0.3, alpha=0.2)
    exact = scattered(model, seed=4, n=200, noise=0.0)
    sigma = 0.05 * exact.value + 0.002
    noisy = exact.value + sigma * np.random.default_rng(4).standard_normal(sigma.shape)
    table = fitter.Table(wi=exact.wi, wo=exact.wo, value=noisy, sigma=sigma, negatives="keep")
    post = fitter.posterior(table, fitter.fit(table, "ward"), **QUICK)
    assert np.isfinite(post.draws).all()
    assert (post.draws >= 0).all()


def test_per_channel_parameters_have_their_own_labels():
    model = models.create("lafortune", **TRUTHS["lafortune"])
    table = scattered(model, seed=5, n=300, sigma=True)
    post = fitter.posterior(table, fitter.fit(table, "lafortune"), **QUICK)
    assert {"n[R]", "n[G]", "n[B]", "kd[R]"} <= set(post.labels)
    assert post.draws.shape == (post.spec.keep, len(post.labels))


def test_a_budget_too_small_says_so(ward):
    _, table, fit, _ = ward
    post = fitter.posterior(table, fit, budget_seconds=1e-3, ess=100_000)
    assert post.status == "not_converged"
    assert "give it more time" in post.message
    assert np.isfinite(post.draws).all()


def test_big_tables_are_conditioned_on_a_part_and_say_so(ward):
    _, table, fit, _ = ward
    post = fitter.posterior(table, fit, **{**QUICK, "max_samples": 100})
    assert post.table["used"] == 100
    assert any("100 of 300 samples" in warning for warning in post.warnings)


def test_requests_that_make_no_sense(ward):
    _, table, fit, _ = ward
    bare = fitter.Table(wi=table.wi, wo=table.wo, value=table.value)
    with pytest.raises(SpecError, match="states none"):
        fitter.posterior(bare, fit, noise="table")
    with pytest.raises(SpecError):
        fitter.posterior(table, fit, ensembles=1)
    with pytest.raises(SpecError, match="not both"):
        fitter.posterior(table, fit, PosteriorSpec(), seed=1)
    with pytest.raises(SpecError, match="no linear or noise parameter"):
        fitter.posterior(table, fit, within={"alpha": (0.1, 0.2)})


def test_progress_can_stop_it(ward):
    from fitter.progress import Cancelled

    _, table, fit, _ = ward

    def stop(share, what):
        if "sampling" in what:
            raise Cancelled

    with pytest.raises(Cancelled):
        fitter.posterior(table, fit, progress=stop)


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_values_of_any_scale(ward, scale):
    _, table, _, post = ward
    other = fitter.Table(wi=table.wi, wo=table.wo, value=table.value * scale, sigma=table.sigma * scale)
    scaled = fitter.posterior(other, fitter.fit(other, "ward"), **QUICK)
    for label in ("kd[value]", "ks[value]"):
        k = post.labels.index(label)
        assert scaled.draws[:, k].mean() / scale == pytest.approx(post.draws[:, k].mean(), rel=0.01)


@pytest.mark.long
def test_a_lobe_that_the_table_does_not_show_has_a_proper_posterior():
    """kd is known, ks may be anything below its stated bound: finite draws, and no false convergence."""
    model = models.create("ward", kd=0.3, ks=0.0)
    table = scattered(model, seed=6, n=200, noise=0.02)
    post = fitter.posterior(table, fitter.fit(table, "torrance_sparrow"), **{**QUICK, "budget_seconds": 10.0})
    assert np.isfinite(post.draws).all()
    k = post.labels.index("ks[value]")
    assert post.draws[:, k].max() <= 100 * np.pi * np.abs(table.value).max() * 1.0001
    k = post.labels.index("kd[value]")
    assert post.draws[:, k].mean() == pytest.approx(0.3, rel=0.02)


# Mixed parameters, coefficients that are not free, anisotropic surfaces ---------------------------------


@pytest.mark.long
@pytest.mark.parametrize(
    ("spec", "values"),
    [
        ("oren_nayar:eon", {"rho": [0.3, 0.9], "sigma": 0.5}),
        (ModelSpec(family="lafortune", per_channel=("n",)), {"kd": 0.2, "gamma": 0.8, "n": [20.0, 40.0]}),
        # The mode at the end of psi's half turn.
        ("ward:anisotropic", {"kd": 0.1, "ks": 0.05, "alpha_x": 0.1, "alpha_y": 0.3, "psi": 1.57}),
    ],
)
def test_posteriors_of_every_kind_of_parameter(spec, values):
    model = models.create(spec, **values)
    table = scattered(model, seed=1, n=300, noise=0.05, sigma=True, azimuths=True)
    fit = fitter.fit(table, model.spec)
    post = fitter.posterior(table, fit, **QUICK)
    assert post.status == "converged", post.message
    assert post.labels == fit.labels
    u = np.sqrt(np.diagonal(fit.covariance))
    for k, (label, interval) in enumerate(post.intervals(0.9999).items()):
        name, _, channel = label.partition("[")
        true = np.asarray(model.values[name])
        true = float(true[model.channels.index(channel[:-1])] if true.ndim else true)
        assert interval["lower"] < true < interval["upper"], label
        assert interval["sd"] == pytest.approx(u[k], rel=0.2), label
    assert np.isfinite(np.asarray(post.models(3)[1].evaluate(table.wi, table.wo))).all()


def test_an_azimuth_that_the_data_leave_open_is_spread_over_its_half_turn():
    """And the axes keep their order: one mode, walkers that agree, no proposals that run away."""
    model = models.create("ward", kd=0.1, ks=0.05, alpha=0.1)
    table = scattered(model, seed=1, n=300, noise=0.05, sigma=True, azimuths=True)
    post = fitter.posterior(table, fitter.fit(table, "ward:anisotropic"), **QUICK)
    # Whether noise that happens to look anisotropic counts as knowing psi is not what is tested here.
    assert post.status in ("converged", "not_identified"), post.message
    along, across, psi = (post.draws[:, post.labels.index(name)] for name in ("alpha_x", "alpha_y", "psi"))
    assert (along <= across).all()
    assert np.ptp(psi) <= np.pi * (1 + 1e-9)
    # Some of it everywhere: an eighth of the half turn has a sixteenth of an even share.
    assert np.histogram(psi, bins=8)[0].min() > len(psi) / 128


def test_there_is_nothing_beyond_the_bounds():
    places = layout(FitSpec(model=ModelSpec.parse("ward")))
    nothing = np.zeros((1, 1))
    density = Density(
        places, Data(np.zeros((6, 1)), nothing, nothing + 1), np.zeros(3), np.array([np.inf, 1.0, 3.0])
    )
    x = np.array([[50.0, 0.5, 1.0], [0.0, 0.0, 3.0], [-1e-9, 0.5, 1.0], [0.0, 1.1, 0.0], [0.0, 0.0, 3.1]])
    assert density.within(x).tolist() == [True, True, False, False, False]
    assert np.isneginf(density(x)).tolist() == [False, False, True, True, True]
