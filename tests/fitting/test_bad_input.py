"""Tables that no model can be fitted to as they are: a typed outcome and a sentence, never a silent number.

The ids are those of docs/hard-cases.md.
"""

from __future__ import annotations

import numpy as np
import pytest

import fitter
from fitter import FitError, SpecError, Table, TableError, models
from fitter.fitting.least_squares import solve
from fitter.fitting.polish import Normal, Polished
from fitter.fitting.solving import _distinct
from tests.bench import tables
from tests.fitting.conftest import scattered

FAMILIES = ["ward", "torrance_sparrow", "lafortune", "oren_nayar"]


@pytest.fixture(scope="module")
def base() -> Table:
    return scattered(models.create("ward", channels=["c"], kd=0.2, ks=0.1, alpha=0.15), 1, n=300)


@pytest.mark.parametrize("name", [*FAMILIES, "lafortune:3"])
def test_f01_fewer_values_than_parameters(name, base):
    few = Table(wi=base.wi[:1], wo=base.wo[:1], value=base.value[:1])
    with pytest.raises(FitError) as caught:
        fitter.fit(few, name)
    assert caught.value.code == "too-few-samples"
    assert "1 usable values can't determine" in str(caught.value)


@pytest.mark.parametrize("name", FAMILIES)
def test_f02_nothing_but_zeros(name, base):
    with pytest.raises(FitError) as caught:
        fitter.fit(Table(wi=base.wi, wo=base.wo, value=np.zeros(300)), name)
    assert caught.value.code == "nothing-to-fit"
    assert "all values are zero" in str(caught.value)


@pytest.mark.parametrize("name", FAMILIES)
def test_f03_a_constant_table_leaves_the_lobe_open(name, base):
    """What fits a constant exactly is the diffuse term: no number of the lobe is stated as determined."""
    fit = fitter.fit(Table(wi=base.wi, wo=base.wo, value=np.full(300, 0.1)), name)
    assert fit.status in ("not_identified", "converged")
    if name == "oren_nayar":
        assert fit.parameters["sigma"].at_bound == ("lower",)
        assert float(fit.parameters["rho"].value[0]) == pytest.approx(0.1 * np.pi, rel=1e-4)
        return
    for lobe in {"alpha", "n", "gamma"} & set(fit.parameters):
        assert np.isnan(fit.parameters[lobe].standard_uncertainty).all()
    assert fit.status == "not_identified"
    assert "does not determine" in fit.message


def test_f04_one_incidence_only(base):
    wi = np.tile([[0.6, 0.0, 0.8]], (300, 1))
    value = np.asarray(models.create("ward", channels=["c"], kd=0.2, ks=0.1).evaluate(wi, base.wo))
    fit = fitter.fit(Table(wi=wi, wo=base.wo, value=value), "ward")
    assert any("one incidence only" in warning for warning in fit.warnings)


@pytest.mark.parametrize(
    ("sigma", "left"), [(0.0, 299), (np.inf, 299), (np.nan, 299), (-1.0, 299)]
)  # fmt: skip
def test_f05_weights_that_are_no_numbers_are_left_out(sigma, left, base):
    """u = 0 would be an infinite weight, u = inf none: both are masked by the table and counted."""
    u = 0.01 * base.value
    u[3] = sigma
    table = Table(wi=base.wi, wo=base.wo, value=base.value, sigma=u)
    fit = fitter.fit(table, "ward")
    assert fit.table["fitted"] == left
    assert table.metadata.masked["sigma missing or not positive"] == 1


def test_f05_no_weight_at_all(base):
    with pytest.raises(TableError) as caught:
        Table(wi=base.wi, wo=base.wo, value=base.value, sigma=np.full_like(base.value, np.inf))
    assert caught.value.code == "table-nothing-usable"


@pytest.mark.parametrize("sigma", [1e-200, 1e-80])
def test_f06_a_weight_that_is_all_but_infinite(sigma, base):
    u = 0.01 * base.value
    u[3] = sigma
    with pytest.raises(FitError) as caught:
        fitter.fit(Table(wi=base.wi, wo=base.wo, value=base.value, sigma=u), "ward")
    assert caught.value.code == "values-out-of-range"


@pytest.mark.parametrize("metric", ["log", "relative"])
def test_f07_logarithms_of_negatives(metric, base):
    value = base.value.copy()
    value[:5] = -1.0
    fit = fitter.fit(Table(wi=base.wi, wo=base.wo, value=value, negatives="keep"), "ward", metric=metric)
    assert fit.table["left_out"] == {f"too negative for the metric {metric}": 5}


def test_f08_noise_that_is_not_stated(base):
    with pytest.raises(SpecError) as caught:
        fitter.fit(base, "ward", metric="measurement")
    assert caught.value.code == "metric-needs-sigma"


def test_f09_solid_angles_that_can_not_be_told(base):
    with pytest.raises(SpecError) as caught:
        fitter.fit(base, "ward", weighting="solid_angle")
    assert caught.value.code == "no-scans"


@pytest.mark.parametrize("starts", [6, 96])
def test_f15_a_lobe_that_a_subset_left_to_chance_is_dropped(starts):
    """1,024 samples leave a lobe of alpha = 2e-4 any height, 5e151 for one: its sums over all are no numbers.
    That was a warning and ten passes for nothing."""
    table = tables.scattered("ward", 60_000, 1)
    few = fitter.fit(table, "ward", metric="cosine", subset=1024, starts=starts)
    assert few.status == "converged"
    usual = fitter.fit(table, "ward", metric="cosine")
    assert few.metrics["objective"] == pytest.approx(usual.metrics["objective"], rel=1e-9)


def test_f15_ends_that_overflow_are_none_beside_others():
    """Nor are two of them compared: their scales are no numbers."""

    def end(p: float, size: float) -> Polished:
        normal = Normal(np.full((1, 1), size), np.zeros(1), size, 0.0, 0.0)
        return Polished(np.array([p]), normal, 1, False, np.zeros((1, 1)))

    lost = [end(0.0, np.nan), end(0.0, np.inf), end(1.0, np.inf), end(0.0, 1e200)]
    assert [e.p[0] for e in _distinct([*lost, end(3.0, 2.0), end(2.0, 1.0)], 10)] == [2.0, 3.0]
    assert len(_distinct(lost, 10)) == 1


@pytest.mark.parametrize("size", [np.inf, np.nan, 1e200])
def test_f15_no_step_is_taken_from_sums_that_are_no_numbers(size):
    def equations(p):
        return Normal(np.full((2, 2), size), np.full(2, size), size, 0.0, 0.0)

    end = solve(equations, np.ones(2), np.zeros(2), np.full(2, 2.0), 10)
    assert (end.passes, end.converged) == (1, False)
