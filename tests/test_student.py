"""Coverage factors and effective degrees of freedom, against the GUM's own figures and SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from fitter.student import coverage_factor, effective_degrees


def test_the_end_gauge_of_the_gum():
    """JCGM 100:2008, H.1.6: u^2 is 1002 nm^2, of parts with 18, 25.6, 50 and 2 degrees of freedom."""
    parts = [(25.0**2, 18.0), (9.7**2, 25.6), (2.9**2, 50.0), (16.6**2, 2.0)]
    degrees = effective_degrees(1002.0, parts)
    assert degrees == 16.0
    assert float(coverage_factor(degrees, 0.99)) == pytest.approx(2.92, abs=0.005)


def test_factors_are_the_quantiles_of_t():
    degrees = np.array([1.0, 2.5, 9.0, 1e6])
    np.testing.assert_allclose(coverage_factor(degrees, 0.95), stats.t.ppf(0.975, degrees), rtol=1e-9)
    assert float(coverage_factor(math.inf, 0.9545)) == pytest.approx(2.0, abs=1e-5)


def test_parts_that_are_known_leave_no_doubt():
    assert effective_degrees(2.0, [(1.0, math.inf), (1.0, math.inf)]) == math.inf
    assert effective_degrees(1.0, [(math.nan, 3.0)]) == math.inf
    assert effective_degrees(1.0, [(1.0, 0.4)]) == 1.0
    assert effective_degrees(math.nan, [(1.0, 3.0)]) == math.inf


@pytest.mark.parametrize("variance", [1e-200, 1.0, 1e160])
def test_rounding_takes_no_degree_away(variance: float):
    for degrees in range(1, 2000):
        assert effective_degrees(variance, [(variance, float(degrees))]) == degrees
