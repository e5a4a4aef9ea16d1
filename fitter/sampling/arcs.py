"""Linear functions of theta times sin(theta) cos(theta) over short arcs: integrals and their inversion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# Newton's steps and, where they don't settle, halvings.
_STEPS, _HALVINGS = 6, 60
_SETTLED = 1e-14


def moments(theta: FloatArray, height: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Integrals of (1 - s) and of s times sin cos over theta + s height, s in [0, 1]."""
    flat, slope = _up_to(np.ones_like(theta), theta, height)
    return height * (flat - slope), height * slope


def _up_to(s: FloatArray, theta: FloatArray, height: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Integrals over s' in [0, s] of sin(2 theta')/2 and of s' sin(2 theta')/2, theta' = theta + s' height.

    With x = 2 height s and a = 2 theta: (sin(a) sin(x) + cos(a) (1 - cos x))/x and (sin(a) (cos x - 1 + x
    sin x) + cos(a) (sin x - x cos x))/x^2, times s/2 and s^2/2. As series: the closed forms cancel for small
    x, and cells are short (x < 0.3: the terms left out are below 1e-16).
    """
    x = 2 * height * s
    square = x * x
    a = 2 * theta
    sine, cosine = np.sin(a), np.cos(a)
    one = 1 - square / 6 * (1 - square / 20 * (1 - square / 42 * (1 - square / 72)))
    two = 0.5 * (1 - square / 12 * (1 - square / 30 * (1 - square / 56 * (1 - square / 90))))
    three = 0.5 - square * (1 / 8 - square * (1 / 144 - square * (1 / 5760 - square / 403200)))
    four = 1 / 3 - square * (1 / 30 - square * (1 / 840 - square * (1 / 45360 - square / 3991680)))
    flat = sine * one + cosine * x * two
    slope = sine * three + cosine * x * four
    return 0.5 * s * flat, 0.5 * s * s * slope


def inverted(
    u: FloatArray, a: FloatArray, b: FloatArray, theta: FloatArray, height: FloatArray
) -> FloatArray:
    """s in [0, 1] with the share ``u`` of the integral of (a + (b - a) s) sin cos below it.

    Newton's method from the answer that a constant sin cos would have; halving where it does not settle.
    """
    flat, slope = _up_to(np.ones_like(u), theta, height)
    wanted = u * (a * flat + (b - a) * slope)
    scale = a * flat + (b - a) * slope
    low, high = np.zeros_like(u), np.ones_like(u)
    s = u.copy()
    for step in range(_STEPS + _HALVINGS):
        flat, slope = _up_to(s, theta, height)
        missing = wanted - (a * flat + (b - a) * slope)
        if float(np.max(np.abs(missing) / scale, initial=0.0)) < _SETTLED:
            break
        low, high = np.where(missing > 0, s, low), np.where(missing > 0, high, s)
        rate = (a + (b - a) * s) * 0.5 * np.sin(2 * (theta + s * height))
        moved = s + missing / np.where(rate > 0, rate, np.inf)
        inside = (moved > low) & (moved < high) & (step < _STEPS)
        s = np.where(inside, moved, 0.5 * (low + high))
    return s
