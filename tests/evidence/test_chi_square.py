"""The sampling study finds what it is there to find, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from fitter import models
from tests.evidence.chi_square import SIGNIFICANCE, TESTS, P, _verdicts, examine
from tests.models import cells
from tests.models.statistics import chi_square_p

pytestmark = pytest.mark.long


def verdicts(found: dict) -> list[str]:
    return [what for what, broken in _verdicts(found) if broken]


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_density_two_percent_too_wide_is_found(dtype):
    right, wrong = (models.create("ward", kd=0.3, ks=0.3, alpha=a) for a in (0.2, 0.204))
    assert verdicts(examine(right, 45.0, dtype, 1)) == []
    assert verdicts(examine(right, 45.0, dtype, 1, stated=wrong)) == ["draws do not follow the density"]


def test_a_wrong_share_of_ideal_draws_is_found():
    right, wrong = (models.create("sum(specular, lambert)", a_ks=ks, b_kd=0.5) for ks in (0.3, 0.305))
    assert verdicts(examine(right, 45.0, "float64", 1)) == []
    assert "the number of ideal draws is not its share" in verdicts(
        examine(right, 45.0, "float64", 1, stated=wrong)
    )


def test_the_correction_is_that_of_all_tests():
    found = 1 - (1 - SIGNIFICANCE) ** TESTS
    assert found == pytest.approx(P, rel=1e-6)


def test_bins_integrate_lobes_of_any_width():
    theta, phi = cells.edges(20, 40)
    axis = cells.directions(np.array(0.7), np.array(2.0))
    for n in (10.0, 1e4, 1e7):

        def lobe(w: np.ndarray, n: float = n) -> np.ndarray:
            return (n + 1) / (2 * np.pi) * np.maximum(1 - 0.5 * np.sum((w - axis) ** 2, axis=1), 0.0) ** n

        look = np.zeros(20 * 40, bool)
        look[cells.bin_of(axis[None], theta, phi)] = True
        found, error = cells.integrate(lobe, theta, phi, absolute=1e-9, look=look.reshape(20, 40))
        # A lobe of n = 10 reaches below the horizon: 1 less that share, by the same rule over the sphere.
        whole, _ = (
            cells.integrate(lobe, *cells.edges(40, 40, sphere=True), absolute=1e-9) if n == 10 else (1, 0)
        )
        assert np.sum(whole) == pytest.approx(1.0, abs=1e-6)
        assert found.sum() <= 1.0 + 1e-6
        assert abs(found.sum() - 1.0) <= (2e-2 if n == 10 else 1e-6)
        assert error.sum() < 1e-5


def test_p_values_are_uniform_and_small_bins_are_pooled():
    rng = np.random.default_rng(3)
    expected = 2000 * np.array([0.5, 0.3, 0.1, 0.095, *[0.001] * 5])
    ps = [chi_square_p(rng.multinomial(2000, expected / 2000).astype(float), expected) for _ in range(400)]
    assert 0.4 < np.mean(ps) < 0.6
    assert np.mean(np.array(ps) < 0.05) < 0.1
    shifted = rng.multinomial(2000, np.roll(expected, 1) / 2000).astype(float)
    assert chi_square_p(shifted, expected) < 1e-9
