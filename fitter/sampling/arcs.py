"""Linear functions of theta times sin(theta) cos(theta) over short arcs: integrals and their inversion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# Newton's steps, each of which doubles the digits, and halvings where they don't settle.
_STEPS, _HALVINGS = 4, 60
_SETTLED = 1e-13


def moments(theta: FloatArray, height: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Integrals of (1 - s) and of s times sin cos over theta + s height, s in [0, 1]."""
    flat, slope = up_to(np.ones_like(theta), height, np.sin(2 * theta), np.cos(2 * theta))
    return height * (flat - slope), height * slope


def up_to(
    s: FloatArray, height: FloatArray, sine: FloatArray, cosine: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Integrals over s' in [0, s] of sin(2 theta')/2 and of s' sin(2 theta')/2, theta' = theta + s' height.

    sine, cosine : of a = 2 theta. With x = 2 height s: (sin(a) sin(x) + cos(a) (1 - cos x))/x and (sin(a)
    (cos x - 1 + x sin x) + cos(a) (sin x - x cos x))/x^2, times s/2 and s^2/2. As series: the closed forms
    cancel for small x, and cells are short (x < 0.3: the terms left out are below 1e-16).
    """
    x = 2 * height * s
    square = x * x
    one = 1 - square / 6 * (1 - square / 20 * (1 - square / 42 * (1 - square / 72)))
    two = 0.5 * (1 - square / 12 * (1 - square / 30 * (1 - square / 56 * (1 - square / 90))))
    three = 0.5 - square * (1 / 8 - square * (1 / 144 - square * (1 / 5760 - square / 403200)))
    four = 1 / 3 - square * (1 / 30 - square * (1 / 840 - square * (1 / 45360 - square / 3991680)))
    flat = sine * one + cosine * x * two
    slope = sine * three + cosine * x * four
    return 0.5 * s * flat, 0.5 * s * s * slope


def inverted(
    u: FloatArray, a: FloatArray, b: FloatArray, sine: FloatArray, cosine: FloatArray, height: FloatArray
) -> FloatArray:
    """s in [0, 1] with the share ``u`` of the integral of (a + (b - a) s) sin cos below it.

    sine, cosine : of 2 theta where the arc begins. Newton's method, each until it settles, from the answer
    that a linear product would have; halving where it does not settle.
    """
    flat, slope = up_to(np.ones_like(u), height, sine, cosine)
    whole = a * flat + (b - a) * slope
    wanted = u * whole
    found = linear(u, a * sine, b * np.maximum(_sine(sine, cosine, 2 * height), 0.0))
    left, s = np.arange(len(u)), found
    flat, slope = up_to(s, height, sine, cosine)
    missing = wanted - (a * flat + (b - a) * slope)
    for _ in range(_STEPS):
        rate = 0.5 * (a + (b - a) * s) * _sine(sine, cosine, 2 * height * s)
        s = np.clip(s + missing / np.where(rate > 0, rate, np.inf), 0.0, 1.0)
        found[left] = s
        flat, slope = up_to(s, height, sine, cosine)
        missing = wanted - (a * flat + (b - a) * slope)
        still = np.flatnonzero(np.abs(missing) > _SETTLED * whole)
        if not len(still):
            return found
        left = left[still]
        s, missing, a, b, sine, cosine, height, wanted, whole = (
            x[still] for x in (s, missing, a, b, sine, cosine, height, wanted, whole)
        )
    low, high = np.zeros(len(left)), np.ones(len(left))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        flat, slope = up_to(middle, height, sine, cosine)
        below = a * flat + (b - a) * slope < wanted
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    found[left] = 0.5 * (low + high)
    return found


def _sine(sine: FloatArray, cosine: FloatArray, x: FloatArray) -> FloatArray:
    """sin(a + x) for short x, of the sine and cosine of a."""
    square = x * x
    return sine * (
        1 - square / 2 * (1 - square / 12 * (1 - square / 30 * (1 - square / 56)))
    ) + cosine * x * (1 - square / 6 * (1 - square / 20 * (1 - square / 42 * (1 - square / 72))))


def linear(u: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Where in [0, 1] the integral of a + (b - a) x makes up the share ``u`` of the whole.

    u (a + b)/(a + sqrt(a^2 + u (b^2 - a^2))), which does not cancel where b is close to a.
    """
    total = a + b
    root = b - a
    root *= total
    root *= u
    square = a * a
    root += square
    np.sqrt(np.abs(root, out=root), out=root)
    root += a
    # 0/0 where the values are 0 at the low end and u is, too.
    np.maximum(root, 1e-300, out=root)
    total *= u
    total /= root
    return np.minimum(total, 1.0, out=total)
