"""Differences, the one-standard-error rule, effective samples, information criterion: against plain sums."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from fitter.selection.compare import (
    Difference,
    as_good,
    difference,
    effective_samples,
    information_criterion,
    score,
)

errors = st.lists(st.floats(1e-6, 1e3), min_size=3, max_size=20)


@given(errors, st.data())
def test_a_difference_is_a_paired_t_interval_of_logarithms(a, data):
    b = data.draw(st.lists(st.floats(1e-6, 1e3), min_size=len(a), max_size=len(a)))
    found = difference(np.array(a), np.array(b))
    d = [math.log(x / y) for x, y in zip(a, b, strict=True)]
    mean = sum(d) / len(d)
    spread = math.sqrt(sum((x - mean) ** 2 for x in d) / (len(d) - 1) / len(d))
    assert math.log(found.ratio) == pytest.approx(mean, abs=1e-9)
    assert found.log_error == pytest.approx(spread, rel=1e-6, abs=1e-9)
    assert math.log(found.upper / found.ratio) == pytest.approx(
        stats.t(len(d) - 1).ppf(0.975) * spread, rel=1e-6, abs=1e-8
    )


@given(errors, st.floats(0.1, 10.0))
def test_it_does_not_depend_on_the_scale_of_the_folds(a, factor):
    one = np.array(a)
    other = one * np.linspace(1.0, 1.5, len(one))
    scale = np.geomspace(1.0, factor, len(one))
    assert difference(other, one).ratio == pytest.approx(difference(other * scale, one * scale).ratio)
    assert score(one * factor) == pytest.approx(score(one) * factor)


@pytest.mark.parametrize(
    ("ratio", "error", "same"),
    [
        (1.0, 0.0, True),
        (1.009, 0.0, True),  # below 1 %: the same for every purpose
        (1.02, 0.0, False),
        (1.05, 0.06, True),  # within one standard error
        (1.05, 0.04, False),
        (1.2, 5.0, False),  # an uncertain difference is no licence
    ],
)
def test_the_rule_of_one_standard_error_has_a_floor_and_a_ceiling(ratio, error, same):
    assert as_good(Difference(ratio, error, 0.0, 9.0)) is same


def test_independent_residuals_are_worth_their_number():
    rng = np.random.default_rng(1)
    found = effective_samples(rng.standard_normal((2000, 2)), rng.uniform(size=(2000, 3)), 0)
    assert found == pytest.approx(2000, rel=0.05)


def test_clusters_of_equal_residuals_are_worth_as_many_samples_as_there_are_clusters():
    rng = np.random.default_rng(2)
    middle = rng.uniform(0, 100, size=(40, 3))
    at = np.repeat(middle, 25, axis=0) + 1e-3 * rng.standard_normal((1000, 3))
    residual = np.repeat(rng.standard_normal((40, 1)), 25, axis=0)
    assert effective_samples(residual, at, 0) == pytest.approx(40, rel=0.4)


def test_a_constant_misfit_is_worth_one_sample():
    at = np.random.default_rng(3).uniform(size=(500, 2))
    assert effective_samples(np.ones((500, 1)), at, 0) == pytest.approx(1.0, rel=0.01)


def test_the_criterion_weighs_a_parameter_against_the_error():
    n = 50.0
    # A parameter pays where it lowers ln(error^2) by more than ln(n)/n.
    worth = math.exp(-0.5 * math.log(n) / n)
    base = information_criterion(1.0, 3, n)
    assert information_criterion(worth * 0.999, 4, n) < base < information_criterion(worth * 1.001, 4, n)
