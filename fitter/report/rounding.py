"""Rounding for print: two significant digits of the uncertainty, the value to the same decimal place."""

from __future__ import annotations

import math
from decimal import ROUND_HALF_EVEN, Decimal, localcontext
from typing import NamedTuple

#: What is printed where no uncertainty can be stated.
NOT_STATED = "—"
#: Decimal exponents of the leading digit that are written out; others go into a power of ten.
PLAIN = range(-5, 6)
#: Significant digits of a value whose uncertainty is not stated.
VALUE_DIGITS = 5
#: Significant digits that a float64 can carry: an uncertainty below them does not add zeros.
MOST_DIGITS = 15


class Rounded(NamedTuple):
    """``value`` and ``uncertainty`` as they are printed, with one common power of ten."""

    value: str
    uncertainty: str


def rounded(value: float, uncertainty: float) -> Rounded:
    """``value`` and its ``uncertainty`` for print (GUM 7.2.6: at most two significant digits of u).

    An uncertainty that is not finite or not positive is not stated; the value then gets five digits.
    """
    if not math.isfinite(value):
        return Rounded(NOT_STATED, significant(uncertainty, 2) if uncertainty > 0 else NOT_STATED)
    if not (math.isfinite(uncertainty) and uncertainty > 0):
        return Rounded(significant(value, VALUE_DIGITS), NOT_STATED)
    y, u = Decimal(repr(float(value))), Decimal(repr(float(uncertainty)))
    place = _place(u, 2)
    if y and y.adjusted() - place >= MOST_DIGITS:
        return Rounded(significant(value, MOST_DIGITS), significant(uncertainty, 2))
    power = _power(max(y.adjusted() if y else place, u.adjusted()))
    return Rounded(_fixed(y, place, power), _fixed(u, place, power))


def significant(value: float, digits: int) -> str:
    """``value`` to so many significant digits, trailing zeros kept; "—" where it is not finite."""
    if not math.isfinite(value):
        return NOT_STATED
    number = Decimal(repr(float(value)))
    if not number:
        return "0"
    return _fixed(number, _place(number, digits), _power(number.adjusted()))


def at_place_of(value: float, uncertainty: float) -> str:
    """``value`` rounded as beside ``uncertainty``: the ends of an interval, from its half width."""
    return rounded(value, uncertainty).value


def percent(share: float, digits: int = 2) -> str:
    """A relative quantity in words: a percentage, or a factor from ten times on; "—" where not finite."""
    if math.isfinite(share) and share >= 10:
        return f"a factor {significant(share, digits)}"
    return f"{significant(100 * share, digits)} %" if math.isfinite(share) else NOT_STATED


def _place(number: Decimal, digits: int) -> int:
    """Decimal exponent of the last of ``digits`` significant digits of ``number`` after rounding."""
    place = number.adjusted() - digits + 1
    # 0.0996 to two digits is 0.10: rounding may carry into a new leading digit.
    return _quantised(number, place).adjusted() - digits + 1


def _quantised(number: Decimal, place: int) -> Decimal:
    with localcontext() as context:
        context.prec = 700  # float64 spans 1e-324 to 1e308
        return number.quantize(Decimal(1).scaleb(place), rounding=ROUND_HALF_EVEN)


def _power(leading: int) -> int:
    return 0 if leading in PLAIN else leading


def _fixed(number: Decimal, place: int, power: int) -> str:
    with localcontext() as context:
        context.prec = 700
        mantissa = _quantised(number, place).scaleb(-power)
        # Digits to the left of the point that were rounded away are zeros without meaning, but
        # "1200" reads better than "1.2 x 10^3" within the plain range.
        text = f"{mantissa:f}" if place - power < 0 else f"{mantissa.to_integral_value():f}"
    if mantissa == 0:
        text = text.removeprefix("-")
    return text if not power else f"{text} × 10{str(power).translate(_SUPERSCRIPT)}"


_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
