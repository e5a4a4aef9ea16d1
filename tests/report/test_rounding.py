"""Rounding for print."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fitter.report.rounding import NOT_STATED, percent, rounded, significant

CASES = [
    (0.123456, 0.00123, "0.1235", "0.0012"),
    (0.1, 0.0996, "0.10", "0.10"),  # the carry makes a new leading digit
    (0.1, 0.0994, "0.100", "0.099"),
    (12345.678, 123.0, "12350", "120"),
    (123.0, 45.0, "123", "45"),
    (99999.0, 1.0, "99999.0", "1.0"),
    (-0.0001, 0.01, "0.000", "0.010"),  # no minus sign before a zero
    (0.0, 0.01, "0.000", "0.010"),
    (-2.5, 0.25, "-2.50", "0.25"),
    (0.02, 1e5, "0", "100000"),
    (1234567.0, 12.0, "1.234567 × 10⁶", "0.000012 × 10⁶"),
    (1e-9, 2.3e-11, "1.000 × 10⁻⁹", "0.023 × 10⁻⁹"),
    (5e300, 2e298, "5.000 × 10³⁰⁰", "0.020 × 10³⁰⁰"),
    (1.0, 1e-30, "1.00000000000000", "1.0 × 10⁻³⁰"),
    (0.123456789, math.nan, "0.12346", NOT_STATED),
    (0.5, 0.0, "0.50000", NOT_STATED),
    (0.5, math.inf, "0.50000", NOT_STATED),
    (0.5, -1.0, "0.50000", NOT_STATED),
    (0.0, math.nan, "0", NOT_STATED),
    (math.nan, 0.1, NOT_STATED, "0.10"),
    (math.inf, math.nan, NOT_STATED, NOT_STATED),
]


@pytest.mark.parametrize(("value", "u", "y_text", "u_text"), CASES)
def test_two_digits_of_u_and_y_to_the_same_place(value: float, u: float, y_text: str, u_text: str) -> None:
    assert rounded(value, u) == (y_text, u_text)


@given(
    st.floats(-1e300, 1e300, allow_subnormal=True),
    st.floats(0, 1e300, allow_subnormal=True) | st.just(math.nan) | st.just(math.inf),
)
def test_what_is_printed_is_within_half_a_unit_of_the_last_place(value: float, u: float) -> None:
    text = rounded(value, u)
    back = _number(text.value)
    if text.uncertainty == NOT_STATED:
        assert back == pytest.approx(value, rel=1e-4, abs=5e-324)
    else:
        assert abs(back - value) <= 0.051 * u + 1e-14 * abs(value)
        assert _number(text.uncertainty) == pytest.approx(u, rel=0.051, abs=5e-324)


@given(st.floats(1e-200, 1e200), st.integers(1, 12))
def test_significant_keeps_so_many_digits(value: float, digits: int) -> None:
    assert _number(significant(value, digits)) == pytest.approx(value, rel=0.51 * 10.0 ** (1 - digits))


def test_percent() -> None:
    assert [percent(x) for x in (0.1234, 1.5, 0.00001, 2200.0, math.nan)] == [
        "12 %", "150 %", "0.0010 %", "a factor 2200", NOT_STATED,
    ]  # fmt: skip


def _number(text: str) -> float:
    digits, _, power = text.partition(" × 10")
    return float(f"{digits}e{power.translate(str.maketrans('⁻⁰¹²³⁴⁵⁶⁷⁸⁹', '-0123456789')) or '0'}")
