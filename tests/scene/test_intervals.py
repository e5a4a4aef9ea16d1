"""Intervals contain what they say: points in boxes, checked in 40 digits."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fitter.scene.intervals import Interval, about, cosine, increasing, sine, unit_component

NUMBERS = st.floats(-1e3, 1e3, allow_subnormal=False)
SHARE = st.floats(0.0, 1.0)


@st.composite
def boxes(draw: st.DrawFn, low: float = -1e3) -> tuple[Interval, mpmath.mpf]:
    """An interval and a point in it."""
    a, b = (max(draw(NUMBERS), low) for _ in range(2))
    a, b = min(a, b), max(a, b)
    x = min(max(a + draw(SHARE) * (b - a), a), b)
    return Interval(np.array([a]), np.array([b])), mpmath.mpf(x)


def holds(found: Interval, value: mpmath.mpf) -> bool:
    return bool(mpmath.mpf(float(found.lo[0])) <= value <= mpmath.mpf(float(found.hi[0])))


@given(boxes(), boxes())
@settings(max_examples=300)
def test_arithmetic_contains_every_result(
    a: tuple[Interval, mpmath.mpf], b: tuple[Interval, mpmath.mpf]
) -> None:
    (p, x), (q, y) = a, b
    with mpmath.workdps(40):
        assert holds(p + q, x + y)
        assert holds(p - q, x - y)
        assert holds(p * q, x * y)
        if y:
            assert holds(p / q, x / y)
        assert holds(p.squared(), x * x)
        assert holds(p.minimum(q), min(x, y))
        assert holds(p.maximum(q), max(x, y))
        assert float(p.abs_hi()[0]) >= abs(x)
        assert holds(
            unit_component(p, q.squared()), x / mpmath.sqrt(x * x + y * y) if x or y else mpmath.mpf(0)
        )


@given(boxes(low=0.0))
@settings(max_examples=200)
def test_functions_contain_every_result(a: tuple[Interval, mpmath.mpf]) -> None:
    p, x = a
    with mpmath.workdps(40):
        assert holds(p.sqrt(), mpmath.sqrt(x))
        assert holds(p.power5(), x**5)
        assert holds((-p).exp(), mpmath.exp(-x))
        ten = p * 0.01
        assert holds(cosine(ten), mpmath.cos(x * mpmath.mpf(0.01)))
        assert holds(sine(ten), mpmath.sin(x * mpmath.mpf(0.01)))
        assert holds(increasing(np.cbrt(p.lo), np.cbrt(p.hi)), mpmath.cbrt(x))


@pytest.mark.parametrize("low", [-7.0, 0.0, 1.0, 3.0])
def test_extrema_inside_are_not_missed(low: float) -> None:
    wide = Interval(np.array([low]), np.array([low + 2 * np.pi]))
    for found in (cosine(wide), sine(wide)):
        assert found.lo[0] == -1
        assert found.hi[0] == 1


def test_quotients_by_zero_are_the_whole_line_or_half_of_it() -> None:
    one = Interval.of(np.array([1.0]))
    around, above = (Interval(np.array([a]), np.array([1.0])) for a in (-1.0, 0.0))
    assert (one / around).lo[0] == -np.inf
    assert (one / around).hi[0] == np.inf
    assert 0.9 < (one / above).lo[0] <= 1
    assert (one / above).hi[0] == np.inf


@given(boxes(low=0.0), boxes(), boxes(), st.sampled_from([0.0, 0.5]))
@settings(max_examples=200)
def test_turned_cosines_contain_every_result(
    a: tuple[Interval, mpmath.mpf], b: tuple[Interval, mpmath.mpf], c: tuple[Interval, mpmath.mpf],
    turn: float,
) -> None:  # fmt: skip
    (p, x), (q, y), (r, z) = a, b, c
    with mpmath.workdps(40):
        # Cosines between -1 and 1.
        p, x = p * 0.002 - 1.0, x * mpmath.mpf(0.002) - 1
        p = p.clip(-1, 1)
        theta = mpmath.acos(min(max(x, -1), 1)) + mpmath.mpf(turn * np.pi)
        assert holds(about(p, q, r, turn * np.pi), mpmath.sin(theta) * y + mpmath.cos(theta) * z)
