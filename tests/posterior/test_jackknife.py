"""Robust uncertainties: against real refits, by simulation, and where there is little to go by."""

from __future__ import annotations

import math

import numpy as np
import pytest

import fitter
from fitter import Table, directions, models
from fitter.posterior import robust
from fitter.posterior.correlated import correlation, local_size

INCIDENCES = np.deg2rad([5.0, 15.0, 25.0, 35.0, 45.0, 55.0, 62.0, 70.0])


def scans(
    incidences: np.ndarray = INCIDENCES, per_scan: int = 41
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """wi, wo of in-plane scans, and the scan of each sample."""
    theta_o = np.deg2rad(np.linspace(-75.0, 75.0, per_scan))
    i, o = (a.reshape(-1) for a in np.meshgrid(incidences, theta_o, indexing="ij"))
    wi = directions.vector_from_spherical(i, 0.0)
    wo = directions.vector_from_spherical(np.abs(o), np.where(o < 0, 0.0, np.pi))
    return wi, wo, np.repeat(np.arange(len(incidences)), per_scan)


def gained(seed: int, spread: float = 0.05, noise: float = 0.005, incidences: np.ndarray = INCIDENCES
) -> Table:
    """A Ward surface whose every scan has a gain of its own, and little noise."""
    rng = np.random.default_rng(seed)
    wi, wo, scan = scans(incidences)
    exact = np.asarray(models.create("ward", channels=["c"], kd=0.2, ks=0.1, alpha=0.2).evaluate(wi, wo))
    gain = 1.0 + spread * rng.standard_normal(scan.max() + 1)
    own = 1 + noise * rng.standard_normal(exact.shape)
    return Table(wi=wi, wo=wo, value=exact * gain[scan][:, None] * own)


@pytest.mark.long
@pytest.mark.parametrize("metric", ["cosine", "relative", "cbrt"])
def test_one_step_is_what_refits_without_a_scan_give(metric):
    """Also where the metric's slope moves with the model: the derivative is exact."""
    table = gained(1)
    fit = fitter.fit(table, "ward", metric=metric)
    found = robust(table, fit)
    wi, wo, scan = scans()
    without = []
    for g in range(found.scans):
        keep = scan != g
        part = Table(wi=wi[keep], wo=wo[keep], value=table.value[keep])
        refit = fitter.fit(part, "ward", metric=metric)
        without.append([float(np.ravel(refit.parameters[name].value)[0]) for name in ("kd", "ks", "alpha")])
    moves = np.array(without) - np.mean(without, axis=0)
    spread = np.sqrt((found.scans - 1) / found.scans * np.square(moves).sum(axis=0))
    ours = [found.standard_uncertainty[name] for name in fit.labels]
    np.testing.assert_allclose(ours, spread, rtol=0.1)
    assert (found.method, found.scans) == ("jackknife", len(INCIDENCES))
    assert found.coverage_factor == pytest.approx(2.365, abs=1e-3)  # t(7)
    assert found.to_dict()["degrees_of_freedom"] == len(INCIDENCES) - 1


@pytest.mark.long
def test_gains_of_scans_are_covered_where_independent_residuals_miss():
    """The naive interval covers the projection (the truth, for gains around 1) far too seldom."""
    truth = {"kd[value]": 0.2, "ks[value]": 0.1, "alpha": 0.2}
    plain, ours = np.zeros(3), np.zeros(3)
    count = 40
    for seed in range(count):
        table = gained(100 + seed)
        fit = fitter.fit(table, "ward", metric="relative")
        found = robust(table, fit)
        naive = np.sqrt(np.diagonal(fit.covariance))
        for k, (label, value) in enumerate(truth.items()):
            off = abs(float(np.ravel(fit.parameters[label.partition("[")[0]].value)[0]) - value)
            plain[k] += off <= 1.96 * naive[fit.labels.index(label)]
            ours[k] += off <= found.coverage_factor * found.standard_uncertainty[label]
    # Binomial: of 40 intervals at 95 %, fewer than 33 happen once in a thousand times.
    assert (ours >= 33).all(), ours
    assert (plain[:2] < 30).all(), plain


def test_independent_noise_keeps_its_uncertainty():
    """Where residuals are independent, the jackknife says what the sandwich says, on average."""
    ratio = []
    for seed in range(12):
        table = gained(200 + seed, spread=0.0, noise=0.05)
        fit = fitter.fit(table, "ward", metric="relative")
        found = robust(table, fit)
        plain = np.sqrt(np.diagonal(fit.covariance))
        ratio.append(np.array([found.standard_uncertainty[label] for label in fit.labels]) / plain)
        assert min(found.effective_samples) > 0.2 * len(table)
    assert 0.8 < np.sqrt(np.mean(np.square(ratio))) < 1.25


def test_few_scans_and_none():
    """Four scans: the larger of two. One: what correlated residuals do, with the normal's factor."""
    few = gained(3, incidences=INCIDENCES[::2])
    fit = fitter.fit(few, "ward", metric="relative")
    found = robust(few, fit)
    assert (found.method, found.scans, found.degrees_of_freedom) == ("larger", 4, 3.0)
    alone = gained(3, incidences=INCIDENCES[3:4])
    single = fitter.fit(alone, "ward", metric="relative", fixed={"alpha": 0.2})
    told = robust(alone, single)
    assert (told.method, told.scans, told.degrees_of_freedom) == ("correlated", 0, math.inf)
    assert told.coverage_factor == pytest.approx(1.96, abs=1e-3)
    assert told.to_dict()["degrees_of_freedom"] is None
    assert all(u > 0 for u in told.standard_uncertainty.values())


def test_channels_that_share_and_channels_that_do_not():
    wi, wo, _ = scans()
    exact = np.asarray(
        models.create(
            "lafortune", channels=["R", "G"], kd=[0.2, 0.3], ks=[0.3, 0.2], gamma=[0.78, 0.7], n=[20.0, 30.0]
        ).evaluate(wi, wo)
    )
    noisy = exact * (1 + 0.02 * np.random.default_rng(5).standard_normal(exact.shape))
    table = Table(wi=wi, wo=wo, value=noisy, channels=("R", "G"))
    for model in ("lafortune", "ward"):
        fit = fitter.fit(table, model)
        found = robust(table, fit)
        assert found.labels == fit.labels
        assert len(found.effective_samples) == 2
        stated = np.isfinite(np.diagonal(fit.covariance))
        known = np.array([np.isfinite(found.standard_uncertainty[label]) for label in fit.labels])
        np.testing.assert_array_equal(known, stated)
        half = np.sqrt(np.diagonal(found.covariance))[stated]
        own = [found.standard_uncertainty[fit.labels[k]] for k in np.flatnonzero(stated)]
        np.testing.assert_allclose(half, own)


def test_nothing_is_stated_where_the_fit_states_nothing():
    """A lobe that is not there has no uncertainty in any way."""
    wi, wo, _ = scans()
    flat = 0.1 * (1 + 0.01 * np.random.default_rng(6).standard_normal((len(wi), 1)))
    table = Table(wi=wi, wo=wo, value=flat)
    fit = fitter.fit(table, "oren_nayar")
    found = robust(table, fit)
    for k, label in enumerate(fit.labels):
        assert math.isnan(found.standard_uncertainty[label]) == math.isnan(fit.covariance[k, k]), label


def test_another_table_is_refused():
    table = gained(1)
    fit = fitter.fit(table, "ward")
    other = Table(wi=table.wi, wo=table.wo, value=table.value, channels=("other",))
    with pytest.raises(fitter.SpecError, match="has a channel 'value'"):
        robust(other, fit)


@pytest.mark.parametrize(("share", "reach"), [(0.9, 0.4), (0.5, 0.2)])
def test_a_known_correlation_is_found(share, reach):
    """Fields drawn from the covariance that is looked for; the mean over draws is close to it."""
    rng = np.random.default_rng(7)
    at = rng.uniform(0.0, 2.0, (400, 2))
    distance = np.sqrt(np.square(at[:, None] - at[None]).sum(axis=2))
    scaled = math.sqrt(3.0) * distance / reach
    matrix = share * (1 + scaled) * np.exp(-scaled) + (1 - share) * np.eye(400)
    draws = np.linalg.cholesky(matrix + 1e-9 * np.eye(400)) @ rng.standard_normal((400, 30))
    found = [correlation(z, distance) for z in draws.T]
    # Of a field that is seen once the mean is part of the correlation: that lowers what is left of it.
    near = np.mean([one.at(np.array(0.1)) for one in found])
    x = math.sqrt(3) * 0.1 / reach
    assert near == pytest.approx(share * (1 + x) * math.exp(-x), abs=0.12)
    none = correlation(rng.standard_normal(400), distance)
    assert none.at(np.array(0.2)) < 0.15


def test_the_local_size_follows_the_residuals():
    rng = np.random.default_rng(8)
    at = rng.uniform(0.0, 1.0, (2000, 1))
    size = np.exp(2.0 * at[:, 0])
    found = local_size(at, size * rng.standard_normal(2000))
    assert np.median(np.abs(np.log(found / size))) < 0.15
