"""The study of raw tables finds what it is there for."""

from __future__ import annotations

import numpy as np
import pytest

from fitter.directions import vector_from_spherical
from fitter.sampling import TableSampler
from tests.evidence import raw_tables
from tests.sampling.tables import spherical

WI = vector_from_spherical(np.deg2rad(45.0), raw_tables.AZIMUTH)


@pytest.fixture(scope="module")
def expected() -> np.ndarray:
    sampler = TableSampler(spherical(0.2, 30, 31))
    found, error = raw_tables.expected_counts(sampler, WI, sampler.sample(WI, 100_000, 1).wo)
    assert error < raw_tables.MOST_ERROR
    assert found.sum() == pytest.approx(1, abs=1e-3)
    return found


@pytest.mark.parametrize("method", raw_tables.METHODS)
def test_draws_of_the_table_pass(method: str, expected: np.ndarray) -> None:
    drawn = TableSampler(spherical(0.2, 30, 31), method=method).sample(WI, raw_tables.DRAWS, 5)  # pyright: ignore[reportArgumentType]
    assert min(raw_tables.p_values(drawn.wo, expected)) > raw_tables.SIGNIFICANCE


def test_draws_of_a_lobe_two_percent_wider_do_not(expected: np.ndarray) -> None:
    drawn = TableSampler(spherical(0.204, 30, 31)).sample(WI, raw_tables.DRAWS, 5)
    assert min(raw_tables.p_values(drawn.wo, expected)) < raw_tables.SIGNIFICANCE


def test_a_draw_where_nothing_is_expected_fails(expected: np.ndarray) -> None:
    holed = expected.copy()
    holed[40, 3] = 0.0
    drawn = TableSampler(spherical(0.2, 30, 31)).sample(WI, raw_tables.DRAWS, 5)
    assert raw_tables.p_values(drawn.wo, holed) == (0.0, 0.0)
    inside = np.ones(len(drawn), bool)
    assert raw_tables.p_values(drawn.wo, holed, inside)[0] > raw_tables.SIGNIFICANCE
