"""The kernel that undoes logarithms, beside NumPy's exponential functions."""

from __future__ import annotations

import numpy as np
import pytest

from fitter.compression import scale
from fitter.kernels.logarithms import restored

LARGE = 700.0
# As the kernel states: the series ends 5e-16 early at the ends of its range, the rest is rounding.
BOUND = 1.4e-15


def undone(y: np.ndarray, floor: float, unit: float = 1.0) -> np.ndarray:
    found = np.empty((len(y), 1))
    restored(y[None], unit, np.array([floor]), LARGE, found)
    return found[:, 0]


@pytest.mark.parametrize("floor", [1.0, 3e-7, 1e3])
def test_it_is_expm1_over_its_range(floor: float) -> None:
    rng = np.random.default_rng(1)
    halves = (np.arange(1, 2000) / 2 * np.log(2.0))[:, None] * (1 + np.array([-1e-15, 0.0, 1e-15]))
    y = np.concatenate([
        rng.uniform(0, LARGE, 100_000), rng.uniform(0, 2, 100_000), 10.0 ** rng.uniform(-300, 0, 50_000),
        halves.reshape(-1), [np.nextafter(LARGE, 0.0)],
    ])  # fmt: skip
    y = y[y < LARGE]
    expected = np.expm1(y) * floor
    usual = expected > 1e-300
    assert np.abs(undone(y, floor)[usual] / expected[usual] - 1).max() < BOUND
    assert np.array_equal(undone(-y, floor), -undone(y, floor))
    assert (np.diff(undone(np.sort(y), floor)) >= 0).all()


def test_from_large_on_it_is_that_of_the_sum() -> None:
    y = np.array([LARGE, 705.0, 709.9, 745.0, 1400.0])
    with np.errstate(over="ignore"):
        expected = np.exp(y + np.log(1e-300))
    assert np.allclose(undone(y, 1e-300), expected, rtol=1e-12)
    assert np.array_equal(undone(-y, 1e-300), -undone(y, 1e-300))


def test_what_is_no_number_and_nothing() -> None:
    y = np.array([0.0, np.nan, np.inf, -np.inf, 1.0])
    expected = [0.0, np.nan, np.inf, -np.inf, undone(y[4:], 2.0)[0]]
    assert np.array_equal(undone(y, 2.0), expected, equal_nan=True)
    assert len(undone(np.zeros(0), 1.0)) == 0


def test_channels_floors_and_single_precision() -> None:
    """More numbers than are worked on at a time, each with the floor of its channel, in either type."""
    rng = np.random.default_rng(2)
    steps = rng.normal(0, 300, (3, 1001)).astype(np.float32)
    floor = np.array([1e-4, 1.0, 50.0])
    found = scale.values(steps, 0.02, floor)
    y = steps.astype(np.float64) * 0.02
    expected = np.copysign(np.expm1(np.abs(y)), y).T * floor
    assert found.shape == (1001, 3)
    assert np.allclose(found, expected, rtol=BOUND, atol=0)
    assert np.array_equal(found, scale.values(steps.astype(np.float64), 0.02, floor))
