"""Conditioning, gradients and second derivatives of a function of many numbers, by differences of 70 digits.

Steps are 1e-25 of each input (1e-30 where it is 0), so truncation and rounding stay below 1e-15 of what is
asked. At a kink the derivatives from the two sides differ: both are returned.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mpmath import mpf

Function = Callable[[Sequence[mpf]], mpf]

_STEP, _STEP_AT_ZERO = mpf("1e-25"), mpf("1e-30")


@dataclass(frozen=True)
class Gradient:
    """Derivatives by each input from below and above, the smaller in ``low``; equal but at a kink.

    uncertainty : sum_k |x_k d2f/dx_j dx_k|, what an error of the inputs does to each derivative.
    """

    value: mpf
    low: list[mpf]
    high: list[mpf]
    uncertainty: list[mpf]


def conditioning(f: Function, x: Sequence[mpf]) -> tuple[mpf, mpf]:
    """f(x) and sum_k |x_k df/dx_k| (the condition number times |f|), one-sided."""
    centre, total = f(x), mpf(0)
    for k, v in enumerate(x):
        if v:
            total += abs(v * (f(_moved(x, k, _step(v))) - centre) / _step(v))
    return centre, total


def gradient(f: Function, x: Sequence[mpf]) -> Gradient:
    """f, its one-sided derivatives and their uncertainty at x."""
    centre, low, high = sides(f, x)
    return Gradient(centre, low, high, _uncertainty(f, x))


def sides(f: Function, x: Sequence[mpf]) -> tuple[mpf, list[mpf], list[mpf]]:
    """f(x) and the smaller and larger of the derivatives from below and above, for each input."""
    centre, low, high = f(x), list[mpf](), list[mpf]()
    for k, v in enumerate(x):
        h = _step(v)
        above, below = (f(_moved(x, k, h)) - centre) / h, (centre - f(_moved(x, k, -h))) / h
        if abs(above - below) <= mpf("1e-14") * (abs(above) + abs(below)):
            above = below = (above + below) / 2
        low.append(min(above, below))
        high.append(max(above, below))
    return centre, low, high


def _uncertainty(f: Function, x: Sequence[mpf]) -> list[mpf]:
    # Beside the point, in a direction no tie survives: second differences across a kink mean nothing.
    beside = [v + (v * mpf("1e-18") if v else mpf("1e-24")) * (1 + mpf(k) / 7) for k, v in enumerate(x)]
    steps, n = [_step(v) for v in x], len(x)
    centre, once = f(beside), [f(_moved(beside, k, h)) for k, h in enumerate(steps)]
    total = [mpf(0)] * n
    for j in range(n):
        for k in range(j, n):
            if not x[j] and not x[k]:
                continue
            both = f(_moved(_moved(beside, j, steps[j]), k, steps[k]))
            second = (both - once[j] - once[k] + centre) / (steps[j] * steps[k])
            total[j] += abs(x[k] * second)
            if j != k:
                total[k] += abs(x[j] * second)
    return total


def _step(v: mpf) -> mpf:
    return abs(v) * _STEP if v else _STEP_AT_ZERO


def _moved(x: Sequence[mpf], k: int, by: mpf) -> list[mpf]:
    moved = list(x)
    moved[k] += by
    return moved
