"""Parameters to 8 certified digits on every problem, from both starts, through the layer of every fit."""

from __future__ import annotations

import numpy as np
import pytest

from fitter.fitting.least_squares import solve
from tests.fitting.strd import PROBLEMS, Problem

#: Lanczos1's residuals are the rounding of its data: 13 digits of 14.
ROUNDED = {"Lanczos1"}
CASES = [
    pytest.param(problem, start, id=f"{problem.name}-{start + 1}") for problem in PROBLEMS for start in (0, 1)
]


def test_there_are_all_of_them():
    levels = [problem.level for problem in PROBLEMS]
    assert [levels.count(level) for level in ("lower", "average", "higher")] == [8, 11, 8]


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda problem: problem.name)
def test_certified_values_have_the_certified_residuals(problem: Problem):
    """What proves that data and model were typed right."""
    rss = problem.equations(problem.certified).objective
    if problem.name in ROUNDED:
        assert rss < 1e-20
    else:
        assert rss == pytest.approx(problem.rss, rel=2e-10)


@pytest.mark.parametrize(("problem", "start"), CASES)
def test_certified_digits(problem: Problem, start: int):
    size, freedom = len(problem.certified), len(problem.y) - len(problem.certified)
    anywhere = np.full(size, np.inf)
    found = solve(
        problem.equations, problem.starts[start], -anywhere, anywhere, freedom, max_passes=1000,
        tolerance=1e-20,
    )  # fmt: skip
    assert found.converged
    np.testing.assert_allclose(found.p, problem.certified, rtol=1e-8)
    deviations = np.sqrt(
        np.diagonal(np.linalg.inv(found.normal.matrix)) * found.normal.objective / freedom
    )
    if problem.name not in ROUNDED:
        assert found.normal.objective == pytest.approx(problem.rss, rel=1e-9)
        np.testing.assert_allclose(deviations, problem.deviations, rtol=1e-6)


@pytest.mark.parametrize("problem", [p for p in PROBLEMS if p.level == "lower"], ids=lambda p: p.name)
def test_the_tolerance_of_fits_leaves_a_thousandth_of_a_deviation(problem: Problem):
    size = len(problem.certified)
    anywhere = np.full(size, np.inf)
    found = solve(problem.equations, problem.starts[1], -anywhere, anywhere, len(problem.y) - size)
    assert found.converged
    assert (np.abs(found.p - problem.certified) / problem.deviations).max() < 2e-3


def test_bounds_hold_and_the_rest_is_at_its_best():
    """Misra1a with its first parameter held below the optimum: the second is at the best of what is left."""
    problem = PROBLEMS[0]
    upper = np.array([200.0, np.inf])
    start = problem.starts[1]
    found = solve(problem.equations, start, np.zeros(2), upper, 12, max_passes=100, tolerance=1e-16)
    assert found.converged
    assert found.p[0] == 200.0
    assert found.normal.rhs[0] > 0
    assert abs(found.normal.rhs[1]) < 1e-8 * np.sqrt(found.normal.matrix[1, 1] * found.normal.objective)


def test_a_start_without_a_finite_neighbour_is_not_called_converged():
    class Cliff:
        matrix, rhs = np.eye(1), np.ones(1)

        def __init__(self, p: np.ndarray) -> None:
            self.objective = 1.0 if p[0] == 1.0 else np.inf

    found = solve(Cliff, np.ones(1), np.zeros(1), np.full(1, 9.0), 1)
    assert not found.converged
    assert found.p == [1.0]
