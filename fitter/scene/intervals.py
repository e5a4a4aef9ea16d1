"""Interval arithmetic on NumPy arrays, rounded outward: what it returns contains every real result.

Sums, products, quotients and roots are rounded to nearest by the hardware, so the next number outward bounds
them; exp, log, cos and sin of NumPy err by less than 4 units in the last place (their documented bound), and
are widened by 8 or more. R. Moore, R. Kearfott and M. Cloud, Introduction to Interval Analysis, 2009.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

_ULPS = 8 * np.finfo(np.float64).eps
_TINY = np.finfo(np.float64).tiny


def _down(x: ArrayLike) -> FloatArray:
    return np.nextafter(x, -np.inf)


def _up(x: ArrayLike) -> FloatArray:
    return np.nextafter(x, np.inf)


def _finite(x: FloatArray) -> FloatArray:
    """0 times infinity is 0."""
    lost = np.isnan(x)
    return np.where(lost, 0.0, x) if lost.any() else x


@dataclass(frozen=True, eq=False)
class Interval:
    """[lo, hi] elementwise; bounds may be infinite, never NaN. 0 times infinity is 0 (a limit from
    inside)."""

    lo: FloatArray
    hi: FloatArray

    @staticmethod
    def of(x: ArrayLike) -> Interval:
        """Exact numbers."""
        array = np.asarray(x, np.float64)
        return Interval(array, array)

    def __add__(self, other: Interval | float) -> Interval:
        o = _interval(other)
        with np.errstate(over="ignore"):
            return Interval(_down(self.lo + o.lo), _up(self.hi + o.hi))

    __radd__ = __add__

    def __neg__(self) -> Interval:
        return Interval(-self.hi, -self.lo)

    def __sub__(self, other: Interval | float) -> Interval:
        return self + (-_interval(other))

    def __rsub__(self, other: float) -> Interval:
        return (-self) + other

    def __mul__(self, other: Interval | float) -> Interval:
        o = _interval(other)
        with np.errstate(invalid="ignore", over="ignore"):
            if not (self.lo.min(initial=0.0) < 0 or o.lo.min(initial=0.0) < 0):
                # The usual case: nothing is negative.
                low = np.maximum(_down(_finite(self.lo * o.lo)), 0.0)
                return Interval(low, _up(_finite(self.hi * o.hi)))
            p, q = _finite(self.lo * o.lo), _finite(self.lo * o.hi)
            r, s = _finite(self.hi * o.lo), _finite(self.hi * o.hi)
        low, high = np.minimum(np.minimum(p, q), np.minimum(r, s)), np.maximum(
            np.maximum(p, q), np.maximum(r, s)
        )
        return Interval(_down(low), _up(high))

    __rmul__ = __mul__

    def __truediv__(self, other: Interval | float) -> Interval:
        return self * _interval(other).reciprocal()

    def __rtruediv__(self, other: float) -> Interval:
        return _interval(other) * self.reciprocal()

    def reciprocal(self) -> Interval:
        """1/x; of intervals that hold 0 inside, the whole line; of [0, hi], [1/hi, infinity]."""
        with np.errstate(divide="ignore", over="ignore"):
            low, high = _down(1.0 / self.hi), _up(1.0 / self.lo)
        low = np.where(self.hi == 0, -np.inf, low)
        high = np.where(self.lo == 0, np.inf, high)
        inside = (self.lo < 0) & (self.hi > 0)
        return Interval(np.where(inside, -np.inf, low), np.where(inside, np.inf, high))

    def squared(self) -> Interval:
        with np.errstate(over="ignore"):
            low, high = self.lo * self.lo, self.hi * self.hi
        across = (self.lo <= 0) & (self.hi >= 0)
        least = np.where(across, 0.0, np.maximum(_down(np.minimum(low, high)), 0.0))
        return Interval(least, _up(np.maximum(low, high)))

    def sqrt(self) -> Interval:
        """Of what is not negative; negative parts count as 0."""
        low, high = np.sqrt(np.maximum(self.lo, 0.0)), np.sqrt(np.maximum(self.hi, 0.0))
        return Interval(np.maximum(_down(low), 0.0), _up(high))

    def exp(self) -> Interval:
        with np.errstate(over="ignore", under="ignore"):
            low, high = np.exp(self.lo), np.exp(self.hi)
        return Interval(np.maximum(low * (1 - _ULPS) - _TINY, 0.0), high * (1 + _ULPS) + _TINY)

    def log(self) -> Interval:
        """Of what is not negative."""
        with np.errstate(divide="ignore"):
            low, high = np.log(np.maximum(self.lo, 0.0)), np.log(np.maximum(self.hi, 0.0))
        return increasing(low, high)

    def power5(self) -> Interval:
        """x^5 of x >= 0."""
        two = self.squared()
        return two.squared() * self

    def abs_hi(self) -> FloatArray:
        """The largest magnitude."""
        return np.maximum(np.abs(self.lo), np.abs(self.hi))

    def clip(self, low: float, high: float) -> Interval:
        """What of it lies in [low, high], where the true value is known to lie."""
        lo = np.minimum(np.maximum(self.lo, low), high)
        return Interval(lo, np.maximum(np.minimum(self.hi, high), lo))

    def meet(self, other: Interval) -> Interval:
        """The part common to two enclosures of one value."""
        lo = np.maximum(self.lo, other.lo)
        return Interval(lo, np.maximum(np.minimum(self.hi, other.hi), lo))

    def minimum(self, other: Interval) -> Interval:
        return Interval(np.minimum(self.lo, other.lo), np.minimum(self.hi, other.hi))

    def maximum(self, other: Interval) -> Interval:
        return Interval(np.maximum(self.lo, other.lo), np.maximum(self.hi, other.hi))

    def where(self, condition: NDArray[np.bool_], other: Interval) -> Interval:
        return Interval(np.where(condition, self.lo, other.lo), np.where(condition, self.hi, other.hi))

    @property
    def mid(self) -> FloatArray:
        return 0.5 * (self.lo + self.hi)


def _interval(x: Interval | float) -> Interval:
    return x if isinstance(x, Interval) else Interval.of(x)


def cosine(x: Interval) -> Interval:
    """cos of angles; widened for NumPy's error in value and argument (|x| up to 100)."""
    a, b = np.cos(x.lo), np.cos(x.hi)
    low, high = np.minimum(a, b) - _ULPS, np.maximum(a, b) + _ULPS
    turns = 2 * np.pi
    # Widened a little, so that an extremum at an end is not missed by the rounding of pi.
    start, end = x.lo - 1e-12, x.hi + 1e-12
    top = np.floor(end / turns) >= np.ceil(start / turns)
    bottom = np.floor((end - np.pi) / turns) >= np.ceil((start - np.pi) / turns)
    return Interval(np.where(bottom, -1.0, np.maximum(low, -1.0)), np.where(top, 1.0, np.minimum(high, 1.0)))


def sine(x: Interval) -> Interval:
    """sin of angles, as :func:`cosine`."""
    half = 0.5 * np.pi
    shifted = cosine(Interval(x.lo - half - 1e-15, x.hi - half + 1e-15))
    return Interval(np.maximum(shifted.lo - _ULPS, -1.0), np.minimum(shifted.hi + _ULPS, 1.0))


def increasing(lo: FloatArray, hi: FloatArray, ulps: int = 16) -> Interval:
    """The range of a monotone function from its computed ends, whose relative error is below ``ulps``
    units."""
    widen = ulps * np.finfo(np.float64).eps
    largest = np.finfo(np.float64).max
    low, high = np.minimum(lo, largest), np.maximum(hi, -largest)
    with np.errstate(over="ignore"):
        return Interval(low - widen * np.abs(low) - _TINY, high + widen * np.abs(high) + _TINY)


def unit_component(d: Interval, rest2: Interval) -> Interval:
    """d / sqrt(d^2 + rest2): a component of a normalised vector, every variable once."""

    def ratio(x: FloatArray, r2: FloatArray) -> FloatArray:
        # Not the root of the sum of squares: x^2 may underflow.
        length = np.hypot(x, np.sqrt(np.maximum(r2, 0.0)))
        return np.where(length > 0, x / np.where(length > 0, length, 1.0), 0.0)

    low = ratio(d.lo, np.where(d.lo >= 0, rest2.hi, rest2.lo))
    high = ratio(d.hi, np.where(d.hi >= 0, rest2.lo, rest2.hi))
    lost = (d.lo <= 0) & (d.hi >= 0) & (rest2.lo <= 0)
    found = increasing(np.where(lost, -1.0, low), np.where(lost, 1.0, high))
    return found.clip(-1.0, 1.0)


def unit(
    d: tuple[Interval, Interval, Interval],
) -> tuple[Interval, Interval, Interval]:
    """A vector, normalised."""
    squares = [one.squared() for one in d]
    found = [unit_component(d[k], squares[(k + 1) % 3] + squares[(k + 2) % 3]) for k in range(3)]
    return found[0], found[1], found[2]


def about(a: Interval, c: Interval, z: Interval, turn: float) -> Interval:
    """sin(theta + turn) c + cos(theta + turn) z of a = cos(theta), theta in [0, pi]: r cos(theta - phi),
    theta once, at either end of c and of z, in which it is linear."""
    theta = np.arccos(np.clip(a.hi, -1, 1)) + turn, np.arccos(np.clip(a.lo, -1, 1)) + turn
    # All four corners at once; roundings of angles and of r are below 4 units.
    x, y = np.stack([c.lo, c.lo, c.hi, c.hi]), np.stack([z.lo, z.hi, z.lo, z.hi])
    r, phi = np.hypot(x, y), np.arctan2(x, y)
    turned = cosine(Interval(theta[0] - phi - 2e-15, theta[1] - phi + 2e-15))
    slack = 8e-15 * r
    return Interval((turned.lo * r - slack).min(axis=0), (turned.hi * r + slack).max(axis=0))


def centre(low: float, high: float) -> float:
    """What is relatively as far from both ends, which are not negative: the largest such error is least."""
    return 2 * low * high / (low + high) if high > 0 else 0.0
