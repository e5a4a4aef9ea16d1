"""Posteriors that a table can't support: a typed outcome and a sentence, never a confident number.

The ids are those of docs/hard-cases.md.
"""

from __future__ import annotations

import numpy as np
import pytest

import fitter
from fitter import FitError, Table, TableError, models
from tests.fitting.conftest import scattered
from tests.posterior.test_jackknife import INCIDENCES, gained

QUICK = {"rhat": 1.05, "ess": 400, "budget_seconds": 300.0, "seed": 5}


@pytest.fixture(scope="module")
def base() -> Table:
    model = models.create("ward", kd=0.2, ks=0.06, alpha=0.15)
    return scattered(model, seed=1, n=300, noise=0.05, sigma=True)


def test_p01_sigma_that_is_none(base):
    """Zero, negative or missing: masked and counted; the draws are those of the table without them."""
    sigma = base.sigma.copy()
    sigma[:4, 0] = [0.0, -1.0, np.nan, np.inf]
    table = Table(wi=base.wi, wo=base.wo, value=base.value, sigma=sigma)
    without = Table(wi=base.wi[4:], wo=base.wo[4:], value=base.value[4:], sigma=base.sigma[4:])
    fit = fitter.fit(without, "ward")
    found, right = (fitter.posterior(one, fit, **QUICK) for one in (table, without))
    assert found.table["samples"] == 296
    assert table.metadata.masked["sigma missing or not positive"] == 4
    np.testing.assert_array_equal(found.draws, right.draws)
    with pytest.raises(TableError, match="none of the 300 samples is usable"):
        Table(wi=base.wi, wo=base.wo, value=base.value, sigma=np.zeros(300))


def test_p02_all_values_are_equal(base):
    """Without sigma there is no noise to infer; with it the lobe is not identified, and is said to be."""
    flat = Table(wi=base.wi, wo=base.wo, value=np.full(300, 0.1))
    with pytest.raises(FitError) as caught:
        fitter.posterior(flat, fitter.fit(flat, "ward"), **QUICK)
    assert caught.value.code == "no-noise"
    known = Table(wi=base.wi, wo=base.wo, value=np.full(300, 0.1), sigma=np.full(300, 0.01))
    post = fitter.posterior(known, fitter.fit(known, "ward"), **QUICK)
    assert post.status == "not_identified", post.message
    assert "the draws of ks[value]" in post.message
    assert post.draws[:, post.labels.index("kd[value]")].mean() == pytest.approx(0.1 * np.pi, rel=0.05)


def test_p03_fewer_samples_than_parameters(base):
    fit = fitter.fit(base, "ward")
    few = Table(wi=base.wi[:2], wo=base.wo[:2], value=base.value[:2])
    with pytest.raises(FitError) as caught:
        fitter.posterior(few, fit, **QUICK)
    assert caught.value.code == "too-few-samples"
    assert "2 usable values can't determine 5 parameters" in str(caught.value)


def test_p04_a_prior_that_excludes_the_data(base):
    post = fitter.posterior(base, fitter.fit(base, "ward", bounds={"alpha": (0.5, 1.0)}), **QUICK)
    assert post.status == "prior_conflict"
    assert "the bounds given for alpha exclude what the table asks for" in post.message
    assert any("residuals exceed the stated noise" in warning for warning in post.warnings)


def test_p05_one_scan_only():
    table = gained(3, incidences=INCIDENCES[3:4])
    post = fitter.posterior(table, fitter.fit(table, "ward", fixed={"alpha": 0.2}), **QUICK)
    assert any("one incidence" in warning for warning in post.warnings)
    assert post.uncertainties["robust"]["method"] == "correlated"
    assert "no scans to leave out" in post.uncertainties["robust"]["words"]


def test_p06_a_budget_too_small(base):
    post = fitter.posterior(base, fitter.fit(base, "ward"), budget_seconds=1e-3, ess=100_000)
    assert post.status == "not_converged"
    assert "wanted R-hat < 1.01 and 100000 effective samples: give it more time" in post.message
    assert np.isfinite(post.draws).all()


def test_p07_a_floor_of_noise_near_zero():
    """Relative noise only: the inferred floor lies against 0, and no walker is lost beyond it."""
    model = models.create("ward", kd=[0.1, 0.2, 0.3], ks=0.05, alpha=0.15)
    table = scattered(model, seed=3, n=300, noise=0.04)
    post = fitter.posterior(table, fitter.fit(table, "ward"), **QUICK)
    assert post.status == "converged", post.message
    assert post.acceptance > 0.2
    floors = post.draws[:, [k for k, label in enumerate(post.labels) if label.startswith("noise_floor")]]
    assert (floors >= 0).all()
    assert (floors.min(axis=0) < 0.1 * floors.mean(axis=0)).all()


def test_p09_noise_that_is_relative_or_a_floor():
    """Values that are nearly all the same do not tell how much of their noise is relative."""
    model = models.create("oren_nayar", rho=[0.3, 0.4, 0.5], sigma=0.1)
    table = scattered(model, seed=3, n=150, noise=0.3)
    post = fitter.posterior(table, fitter.fit(table, "lambert"), **QUICK)
    assert post.status == "converged", post.message
    assert post.acceptance > 0.3
    part = [post.draws[:, post.labels.index(f"{name}[R]")] for name in ("relative_noise", "noise_floor")]
    # On an arc: its middle is farther from 0 than the mean of each.
    size = np.hypot(part[0] * np.median(table.value[:, 0]), part[1])
    assert size.std() < 0.2 * size.mean()
    assert min(p.std() / p.mean() for p in part) > 0.3
