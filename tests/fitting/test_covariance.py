"""u of a sandwich: leverage, channels that share errors, and how many samples tell a parameter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import fitter
from fitter import Table, directions, models
from tests.fitting.conftest import TRUTHS, scattered


def test_the_sandwich_allows_for_the_samples_own_pull():
    """Against leave-one-out refits, linear in kd and ks with alpha held: the residual over 1 - h is what each
    sample misses the fit to the others by."""
    table = scattered(models.create("ward", **TRUTHS["ward"]), seed=9, n=24, noise=0.1)
    fit = fitter.fit(table, "ward", metric="absolute", fixed={"alpha": 0.15})
    terms = [models.create("ward", channels=["c"], kd=kd, ks=1 - kd, alpha=0.15) for kd in (1.0, 0.0)]
    x = np.concatenate([np.asarray(term.evaluate(table.wi, table.wo)) for term in terms], axis=1)
    y = table.value
    bread = np.linalg.inv(x.T @ x)
    for c, name in enumerate(table.channels):
        meat = np.zeros((2, 2))
        for k in range(len(x)):
            others = np.arange(len(x)) != k
            b = np.linalg.lstsq(x[others], y[others, c], rcond=None)[0]
            score = x[k] * (y[k, c] - x[k] @ b)
            meat += np.outer(score, score)
        u = np.sqrt(np.diagonal(bread @ meat @ bread))
        found = [fit.parameters[p].standard_uncertainty[c] for p in ("kd", "ks")]
        np.testing.assert_allclose(found, u, rtol=1e-8, err_msg=name.name)


def test_columns_that_repeat_a_channel_tell_no_more_than_it():
    """Copies share every error: neither u nor its degrees of freedom change."""
    one = scattered(models.create("ward", channels=["c"], kd=0.2, ks=0.1, alpha=0.1), seed=5, n=60, noise=0.1)
    many = Table(wi=one.wi, wo=one.wo, value=np.repeat(one.value, 3, axis=1), negatives="keep")
    alone, copied = (fitter.fit(table, "ward", metric="cbrt") for table in (one, many))
    for name, estimate in alone.parameters.items():
        other = copied.parameters[name]
        for what in ("standard_uncertainty", "degrees_of_freedom"):
            found, expected = getattr(other, what), float(np.ravel(getattr(estimate, what))[0])
            np.testing.assert_allclose(found, expected, rtol=1e-3, err_msg=f"{what} of {name}")


def test_few_samples_that_tell_a_parameter_give_its_u_few_degrees_of_freedom():
    """Of 400 samples with a lobe in 5 of them ks has about 5, kd about as many as see nothing but it."""
    mirror = np.arange(400) < 5
    theta_i = np.where(mirror, np.linspace(0.5, 0.7, 400), 0.6)
    theta_o, phi = np.where(mirror, theta_i, np.linspace(0.0, 1.2, 400)), np.where(mirror, np.pi, 1.5)
    wo = directions.vector_from_spherical(theta_o, phi)
    wi = directions.vector_from_spherical(theta_i, np.zeros(400))
    model = models.create("ward", channels=["c"], kd=0.3, ks=0.2, alpha=0.03)
    exact = np.asarray(model.evaluate(wi, wo))
    value = exact * (1 + 0.02 * np.random.default_rng(4).standard_normal(exact.shape))
    fit = fitter.fit(fitter.Table(wi=wi, wo=wo, value=value), "ward", metric="log", fixed={"alpha": 0.03})
    degrees = {name: float(np.ravel(e.degrees_of_freedom)[0]) for name, e in fit.parameters.items()}
    assert degrees["ks"] == pytest.approx(5.0, abs=1.5)
    assert 300 < degrees["kd"] <= 400
    expanded = fit.parameters["ks"].expanded_uncertainty() / fit.parameters["ks"].standard_uncertainty
    assert float(expanded[0]) == pytest.approx(stats.t.ppf(0.975, degrees["ks"]))
    again = fitter.FitResult.from_dict(fit.to_dict())
    assert float(again.parameters["ks"].degrees_of_freedom[0]) == degrees["ks"]
