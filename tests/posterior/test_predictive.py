"""Bands of new measurements: they hold what they say where the model misses."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import fitter
from fitter import Table, models
from fitter.errors import SpecError
from fitter.posterior import predictive, process, robust
from fitter.posterior.predictive import features, slopes
from tests.posterior.test_jackknife import scans


def missed(seed: int) -> tuple[Table, np.ndarray]:
    """A surface of two lobes with 1 % noise, which one lobe can't fit, and the scan of each sample."""
    wi, wo, scan = scans(np.deg2rad(np.linspace(3.0, 70.0, 14)))
    exact = np.asarray(
        models.create("ward", channels=["c"], kd=0.2, ks=0.06, alpha=0.12).evaluate(wi, wo)
    ) + np.asarray(models.create("ward", channels=["c"], kd=0.0, ks=0.08, alpha=0.45).evaluate(wi, wo))
    noise = 0.01 * np.random.default_rng(seed).standard_normal(exact.shape)
    return Table(wi=wi, wo=wo, value=exact * (1 + noise)), scan


def interval_score(lower: np.ndarray, upper: np.ndarray, y: np.ndarray) -> float:
    """Of 95 % intervals, smaller is better (T. Gneiting, A. Raftery 2007, eq. 43)."""
    outside = np.maximum(lower - y, 0.0) + np.maximum(y - upper, 0.0)
    return float(np.mean(upper - lower + 2 / 0.05 * outside))


@pytest.mark.long
@pytest.mark.parametrize("held_out", ["random", "scans"])
def test_bands_hold_what_they_say_and_score_better_than_one_number_for_the_misfit(held_out):
    """Held-out scans lie between fitted ones, or beside the outermost."""
    inside, bright, score = [], [], []
    for seed in range(4):
        table, scan = missed(seed)
        some = np.random.default_rng([seed, 2]).random(len(scan)) < 0.5
        used = some if held_out == "random" else scan % 2 == seed % 2
        part = Table(wi=table.wi[used], wo=table.wo[used], value=table.value[used])
        fit = fitter.fit(part, "ward")
        found = predictive(part, fit, robust(part, fit), seed=3)
        y = table.value[~used]
        lower, upper = found.predict(
            table.wi[~used], table.wo[~used], new="directions" if held_out == "random" else "scans"
        )
        held = (y >= lower) & (y <= upper)
        inside.append(held.mean())
        bright.append(held[y >= np.quantile(y, 0.9)].mean())
        f = np.asarray(fit.model.evaluate(table.wi[~used], table.wo[~used]))
        misfit = part.value - np.asarray(fit.model.evaluate(part.wi, part.wo))
        constant = 1.96 * float(np.sqrt(np.mean(np.square(misfit))))
        score.append(interval_score(lower, upper, y) / interval_score(f - constant, f + constant, y))
    assert 0.92 <= np.mean(inside) <= 0.995, inside
    assert np.mean(bright) > 0.8, bright
    assert np.mean(score) < 0.7, score


def test_the_parameters_are_part_of_the_band():
    """Without misfit and with hardly any noise the band is what the parameters' covariance makes of it."""
    wi, wo, _ = scans()
    exact = np.asarray(models.create("ward", channels=["c"], kd=0.2, ks=0.1, alpha=0.2).evaluate(wi, wo))
    noise = 1e-6 * np.random.default_rng(4).standard_normal(exact.shape)
    table = Table(wi=wi, wo=wo, value=exact * (1 + noise))
    fit = fitter.fit(table, "ward")
    found = predictive(table, fit)
    assert found.labels[0].startswith("kd")
    moved = slopes(fit.model, fit.labels, np.diag([1e-4, 0.0, 0.0]), wi, wo)
    # u(kd) = 0.01 moves f by 0.01/pi everywhere.
    np.testing.assert_allclose(np.sqrt(np.square(moved).sum(axis=1)), 0.01 / np.pi, rtol=1e-6)
    # Where there are measurements they know better than the parameters' own uncertainty.
    lower, upper = found.predict(wi, wo)
    assert np.median((upper - lower) / exact) < 1e-4


@pytest.mark.parametrize("by_scan", [False, True])
def test_what_is_left_out_is_predicted_as_if_it_had_not_been_there(by_scan: bool):
    """The short form against processes conditioned on the rest, one after the other."""
    rng = np.random.default_rng(7)
    n = 40
    scan = np.repeat(np.arange(5), 8)
    at, f, y, moved = rng.random((n, 4)), rng.uniform(0.1, 1, n), rng.uniform(0.1, 1, n), rng.random((n, 2))
    scale = process.Scale(0.3, 0.05)
    z, nearby = scale.scaled(y, f), process.Nearby(at, np.zeros(n), 0)
    distance = np.linalg.norm(at[:, None] - at[None], axis=2)
    whole = process.conditioned(scale, nearby, z, f, at, moved, distance, 0.5, 0.8, (0.0, 1.0))
    off, deviation = whole.misfits(scan if by_scan else None)
    root3 = np.sqrt(3) * distance / 0.5
    field = 0.8 * (1 + root3) * np.exp(-root3) + (0.2 + process.JITTER) * np.eye(n)
    slopes = moved / scale.size(f)[:, None]
    covariance = whole.deviation**2 * field + slopes @ slopes.T
    for out in np.arange(5)[:, None] == scan if by_scan else np.eye(n, dtype=bool):
        cross = covariance[np.ix_(out, ~out)]
        gain = cross @ np.linalg.inv(covariance[np.ix_(~out, ~out)])
        left = covariance[np.ix_(out, out)] - gain @ cross.T
        np.testing.assert_allclose(off[out], z[out] - gain @ z[~out], rtol=1e-7)
        np.testing.assert_allclose(deviation[out], np.sqrt(np.diagonal(left)), rtol=1e-7)


def test_misses_set_the_width_where_they_are():
    """The share of like samples that a band must hold, as an exact quantile of theirs."""
    f = np.linspace(0.0, 1.0, 400)
    miss = np.where(f < 0.5, 1.0, 3.0) + 1e-3 * np.arange(400)
    misses = process.Misses(f, miss)
    low, high = misses.reach(np.array([0.1, 0.9]), 0.95)
    # The 39th of 40 neighbours: 38.95 = 0.95 x 41 rounded up.
    assert low == np.sort(miss[20:60])[38]
    assert high > 3.3


def _spread_by_orders(ends: tuple[float, float]) -> process.Process:
    """Values about f = 1 that differ by factors of 1000 either way, on a logarithmic scale."""
    rng = np.random.default_rng(8)
    at, f, y = rng.random((60, 4)), np.ones(60), 10.0 ** rng.uniform(-3, 3, 60)
    scale = process.Scale(3.0, 1e-3, asinh=True)
    distance = np.linalg.norm(at[:, None] - at[None], axis=2)
    nearby = process.Nearby(at, np.zeros(60), 0)
    return process.conditioned(
        scale, nearby, scale.scaled(y, f), f, at, np.zeros((60, 0)), distance, 0.2, 0.5, ends
    )


def test_bands_end_where_values_do():
    """At 0 or the smallest value, and at twice the largest that was measured or that the model expects."""
    at = np.full((3, 4), 50.0) + np.arange(3)[:, None]
    for ends in ((0.0, 40.0), (-0.5, 40.0)):
        lower, upper = _spread_by_orders(ends).band(np.array([1.0, 39.0, 70.0]), at, np.zeros((3, 0)), 0.95)
        assert (lower >= ends[0]).all()
        np.testing.assert_allclose(upper, [80.0, 80.0, 140.0])
    # Wider bands hold narrower ones, where they end and where they are beyond.
    for ends in ((0.0, 40.0), (0.0, 1e-2), (0.5, 1.0)):
        one = _spread_by_orders(ends)
        near = one.at[:40] + 0.02
        several = [one.band(np.ones(40), near, np.zeros((40, 0)), q) for q in (0.5, 0.8, 0.95, 0.99)]
        for (lower, upper), (lower_, upper_) in itertools.pairwise(several):
            assert ((lower_ <= lower) & (upper <= upper_)).all()
    # As a whole beyond: the range, and not a point.
    lower, upper = _spread_by_orders((0.0, 1e-9))._around(
        np.array([1e-3]), np.ones(1), np.array([9.0]), np.array([0.1])
    )
    assert (lower[0], upper[0]) == (0.0, 2e-3)


def test_the_ends_of_a_band_are_the_mean_of_those_that_left_out_samples_chose():
    table, _ = missed(5)
    fit = fitter.fit(table, "ward")
    found = predictive(table, fit, seed=6)
    several = found.processes["directions"][0]
    assert len(several) == 3
    assert len({(one.scale.asinh, one.nearby.count) for one in several}) == 3
    wi, wo = table.wi[:9], table.wo[:9]
    f = np.asarray(fit.model.evaluate(wi, wo))[:, 0]
    moved = slopes(fit.model, found.labels, found.covariance, wi, wo)[:, :, 0]
    each = [one.band(f, features(wi, wo), moved, 0.95) for one in several]
    np.testing.assert_allclose(np.stack(found.predict(wi, wo))[:, :, 0], np.mean(each, axis=0), rtol=1e-9)


def test_scans_as_yet_unmeasured_need_several_measured_ones():
    wi, wo, _ = scans(np.deg2rad([20.0]))
    table = Table(wi=wi, wo=wo, value=np.full((len(wi), 1), 0.1))
    found = predictive(table, fitter.fit(table, "lambert"))
    with pytest.raises(SpecError, match="too few scans"):
        found.predict(wi[:3], wo[:3], new="scans")


def test_the_same_seed_gives_the_same_band():
    table, _ = missed(5)
    fit = fitter.fit(table, "ward")
    first, again = (predictive(table, fit, seed=6).predict(table.wi[:9], table.wo[:9]) for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_a_table_of_nothing_but_one_value_has_a_band():
    wi, wo, _ = scans()
    table = Table(wi=wi, wo=wo, value=np.full((len(wi), 1), 0.1))
    fit = fitter.fit(table, "lambert")
    lower, upper = predictive(table, fit).predict(wi[:5], wo[:5])
    assert np.isfinite(lower).all()
    assert np.isfinite(upper).all()
    np.testing.assert_allclose(0.5 * (lower + upper), 0.1, rtol=1e-6)
