"""Bands of ranks against simulated ranks, which know nothing of how the bands are found."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fitter.calibration import bands


def _counts(rng: np.random.Generator, tables: int, n: int, draws: int) -> np.ndarray:
    ranks = rng.integers(0, draws + 1, (tables, n))
    return np.stack([np.bincount(row, minlength=draws + 1).cumsum()[:draws] for row in ranks])


@pytest.mark.parametrize(("n", "draws", "level"), [(60, 19, 0.9), (200, 99, 0.95)])
def test_uniform_ranks_stay_within_the_band_as_often_as_it_says(n: int, draws: int, level: float) -> None:
    lowest, highest = bands.ecdf_band(n, draws, level)
    counts = _counts(np.random.default_rng(1), 4000, n, draws)
    inside = ((counts >= lowest) & (counts <= highest)).all(axis=1).mean()
    # Counts are whole numbers: no band has exactly this probability. Three standard errors of 4,000 tables.
    assert level - 3 * np.sqrt(level * (1 - level) / 4000) < inside < level + 0.03


def test_p_values_are_those_of_simulated_ranks() -> None:
    rng = np.random.default_rng(2)
    found = np.array([bands.p_value(rng.integers(0, 40, 80), 39) for _ in range(500)])
    for p in (0.05, 0.2, 0.5):
        assert (found <= p).mean() == pytest.approx(p, abs=0.06)


@given(st.lists(st.integers(0, 19), min_size=5, max_size=60))
def test_a_band_holds_what_its_p_value_does_not_reject(ranks: list[int]) -> None:
    lowest, highest = bands.ecdf_band(len(ranks), 19, 0.95)
    counts = bands.ecdf(ranks, 19)
    assert ((counts >= lowest) & (counts <= highest)).all() == (bands.p_value(ranks, 19) > 0.05 - 1e-6)


def test_posteriors_too_narrow_too_wide_or_shifted_are_seen() -> None:
    rng = np.random.default_rng(3)
    draws = rng.standard_normal((200, 99))
    for truth in (2 * rng.standard_normal(200), 0.4 * rng.standard_normal(200), rng.normal(0.5, 1, 200)):
        assert bands.p_value((draws < truth[:, None]).sum(axis=1), 99) < 0.001
    good = (draws < rng.standard_normal(200)[:, None]).sum(axis=1)
    assert bands.p_value(good, 99) > 0.01


def test_coverage_is_judged_by_the_binomial_distribution() -> None:
    low, high = bands.coverage_band(200, 0.95, 0.99)
    held = np.random.default_rng(4).binomial(200, 0.95, 100_000)
    assert 0.985 < ((held >= low) & (held <= high)).mean() < 0.998
    assert bands.corrected(0.99, 7) ** 7 == pytest.approx(0.99)
