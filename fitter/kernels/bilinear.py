"""Draws from bilinear envelopes of in/out grids, see :mod:`fitter.sampling.bilinear`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled, part
from fitter.kernels.angles import short_cosine, short_sine
from fitter.kernels.candidates import ABOVE, CHANCE, CHUNK, OWN, REJECTED, U, V, collected, proposed

FloatArray = NDArray[np.float64]

# Halvings where the inversion does not settle, and steps that are short against what they lead to.
_HALVINGS, _SHORT = 60, 1e-5
# Rows of a chunk: the corners' values, what is known of the row and of the column, the interpolant, the
# direction and pdf.
_F, _ROW, _COLUMN, _ENVELOPE, _DENSITY, _OUT = OWN, OWN + 4, OWN + 12, OWN + 15, OWN + 16, OWN + 17
_ROWS = _OUT + 4
# Of a row: cosine and sine of its middle, half its height, the largest sin(2 theta), sine and cosine of twice
# the lower end, and the integrals of (1 - s) sin cos and s sin cos over s.
_COSINE, _SINE, _HALF, _STEEPEST, _SINE2, _COSINE2, _LOW, _HIGH = range(_ROW, _ROW + 8)


@part
def linear(u: float, a: float, b: float) -> float:
    """Where in [0, 1] the integral of a + (b - a) x makes up the share ``u`` of the whole.

    u (a + b)/(a + sqrt(a^2 + u (b^2 - a^2))), which does not cancel where b is close to a.
    """
    total = a + b
    # 0/0 where the values are 0 at the low end and u is, too.
    below = max(a + np.sqrt(abs(a * a + u * ((b - a) * total))), 1e-300)
    return min(total * u / below, 1.0)


@part
def up_to(s: float, height: float, sine: float, cosine: float) -> tuple[float, float]:
    """As :func:`fitter.sampling.arcs.up_to`."""
    x = 2 * height * s
    q = x * x
    one = 1 - q * (1 / 6 - q * (1 / 120 - q * (1 / 5040 - q * (1 / 362880))))
    two_ = 0.5 - q * (1 / 24 - q * (1 / 720 - q * (1 / 40320 - q * (1 / 3628800))))
    three = 0.5 - q * (1 / 8 - q * (1 / 144 - q * (1 / 5760 - q * (1 / 403200))))
    four = 1 / 3 - q * (1 / 30 - q * (1 / 840 - q * (1 / 45360 - q * (1 / 3991680))))
    return 0.5 * s * (sine * one + cosine * x * two_), 0.5 * s * s * (sine * three + cosine * x * four)


@part
def halley(
    s: float, wanted: float, a: float, b: float, sine: float, cosine: float, height: float
) -> tuple[float, float]:
    """A step of Halley's method, which triples the digits, towards the s below which the integral is
    ``wanted``: where it leads, and its length."""
    flat, slope = up_to(s, height, sine, cosine)
    missing = wanted - (a * flat + (b - a) * slope)
    x = 2 * height * s
    c, e = short_cosine(x), short_sine(x)
    steep, level = sine * c + cosine * e, a + (b - a) * s
    rate = max(0.5 * level * steep, 1e-300)
    bend = 0.5 * ((b - a) * steep + 2 * height * level * (cosine * c - sine * e))
    step = missing / rate
    step = step / max(1 + 0.5 * step * bend / rate, 0.5)
    return min(max(s + step, 0.0), 1.0), abs(step)


@part
def halved(wanted: float, a: float, b: float, sine: float, cosine: float, height: float) -> float:
    """The same s by halving."""
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        s = 0.5 * (low + high)
        flat, slope = up_to(s, height, sine, cosine)
        if a * flat + (b - a) * slope < wanted:
            low = s
        else:
            high = s
    return 0.5 * (low + high)


@part
def invert(b: FloatArray) -> None:
    """The first uniform number of each candidate replaced by the s in [0, 1] with that share of the integral
    of (f + (g - f) s) sin cos below it, f and g the sums of the corners at the ends of theta."""
    for i in range(CHUNK):
        f, g = b[_F * CHUNK + i] + b[(_F + 1) * CHUNK + i], b[(_F + 2) * CHUNK + i] + b[(_F + 3) * CHUNK + i]
        height, sine, cosine = 2 * b[_HALF * CHUNK + i], b[_SINE2 * CHUNK + i], b[_COSINE2 * CHUNK + i]
        wanted = b[U * CHUNK + i] * (b[_LOW * CHUNK + i] * f + b[_HIGH * CHUNK + i] * g)
        # From the answer that a linear product would have.
        x = 2 * height
        end = sine * short_cosine(x) + cosine * short_sine(x)
        s = linear(b[U * CHUNK + i], f * sine, g * max(end, 0.0))
        s, _ = halley(s, wanted, f, g, sine, cosine, height)
        s, step = halley(s, wanted, f, g, sine, cosine, height)
        # A step whose cube is rounding was the last.
        b[U * CHUNK + i] = s if step <= _SHORT * min(s, 1.0 - s) else b[U * CHUNK + i] - 2.0
    for i in range(CHUNK):
        if b[U * CHUNK + i] < 0:
            f, g = (
                b[_F * CHUNK + i] + b[(_F + 1) * CHUNK + i],
                b[(_F + 2) * CHUNK + i] + b[(_F + 3) * CHUNK + i],
            )
            wanted = (b[U * CHUNK + i] + 2.0) * (b[_LOW * CHUNK + i] * f + b[_HIGH * CHUNK + i] * g)
            sine, cosine = b[_SINE2 * CHUNK + i], b[_COSINE2 * CHUNK + i]
            b[U * CHUNK + i] = halved(wanted, f, g, sine, cosine, 2 * b[_HALF * CHUNK + i])


@part
def power_sum(
    where: NDArray[np.int64], ends: FloatArray, roots: FloatArray, power: FloatArray, coefficient: FloatArray,
    item: int, s: float, t: float, first: int, last: int,
) -> float:  # fmt: skip
    """The sum of the terms from ``first`` to ``last`` where a candidate lies."""
    x = ends[item, 0] + s * (ends[item, 1] - ends[item, 0])
    y = ends[item, 2] + t * (ends[item, 3] - ends[item, 2])
    n00, n01, n10, n11 = where[item, 0], where[item, 1], where[item, 2], where[item, 3]
    total = 0.0
    for k in range(first, last):
        low = (1 - y) * roots[k, n00] + y * roots[k, n01]
        high = (1 - y) * roots[k, n10] + y * roots[k, n11]
        total += coefficient[k] * ((1 - x) * low + x * high) ** power[k]
    return total


@compiled
def fill(
    share: FloatArray,
    alias: NDArray[np.int32],
    cells: FloatArray,
    place: NDArray[np.int32],
    rows: FloatArray,
    columns: FloatArray,
    where: NDArray[np.int64],
    ends: FloatArray,
    roots: FloatArray,
    power: FloatArray,
    coefficient: FloatArray,
    weights: FloatArray,
    slack: float,
    exact: bool,
    integral: float,
    state: NDArray[np.uint64],
    every: bool,
    wo: FloatArray,
    pdf: FloatArray,
    weight: FloatArray,
    budget: int,
) -> tuple[int, int]:
    """Draws into ``wo`` (n, 3), ``pdf`` (n,) and ``weight`` (n, C) from at most ``budget`` candidates.

    cells : (K, 4 + 4 C) values at the corners (low, low), (low, high), (high, low), (high, high) of theta and
    azimuth; then the corners of every channel. place : (K, 2) the row and the column of each. rows : (R, 8)
    as named above. columns : (S, 3) cosine and sine of the middle, in the sample's frame, and half the width.
    Where the field is a sum of powers of bilinear functions: where, ends : (K, 4) flat nodes, and fractions
    at the ends of theta and of azimuth, of each cell; roots (T, N), power and coefficient (T,) of each term,
    those of one channel together; weights : (C,) of the channels. Else they have no rows.
    exact : theta by inversion; then every candidate is a draw. slack : what rounding may put a power above
    its envelope by, as a factor. every : keep rejected candidates, too, with a pdf of -1.

    Returns how many candidates were tried, -1 where one exceeded its bound, and how many draws were made.
    """
    over = 1.0 / integral
    powered = len(where) > 0
    terms = len(roots) // len(weights)
    bits = np.empty(_ROWS * CHUNK, np.uint64)
    b = bits.view(np.float64)
    items, taken = np.empty(CHUNK, np.int64), np.empty(CHUNK + 1, np.int64)
    known = 8 if exact else 4
    tried = filled = 0
    while filled < len(pdf) and tried < budget:
        m = min(CHUNK, budget - tried)
        proposed(state, share, alias, bits, b, items)
        for i in range(CHUNK):
            item = np.uint64(items[i])
            row, column = np.uint64(place[item, 0]), np.uint64(place[item, 1])
            b[_F * CHUNK + i], b[(_F + 1) * CHUNK + i] = cells[item, 0], cells[item, 1]
            b[(_F + 2) * CHUNK + i], b[(_F + 3) * CHUNK + i] = cells[item, 2], cells[item, 3]
            b[_COSINE * CHUNK + i], b[_SINE * CHUNK + i] = rows[row, 0], rows[row, 1]
            b[_HALF * CHUNK + i], b[_STEEPEST * CHUNK + i] = rows[row, 2], rows[row, 3]
            b[_COLUMN * CHUNK + i], b[(_COLUMN + 1) * CHUNK + i] = columns[column, 0], columns[column, 1]
            b[(_COLUMN + 2) * CHUNK + i] = columns[column, 2]
            for c in range(4, known):
                b[(_ROW + c) * CHUNK + i] = rows[row, np.uint64(c)]
        if exact:
            invert(b)
        for i in range(CHUNK):
            f00, f01 = b[_F * CHUNK + i], b[(_F + 1) * CHUNK + i]
            f10, f11 = b[(_F + 2) * CHUNK + i], b[(_F + 3) * CHUNK + i]
            s = b[U * CHUNK + i] if exact else linear(b[U * CHUNK + i], f00 + f01, f10 + f11)
            low, high = f00 + s * (f10 - f00), f01 + s * (f11 - f01)
            t = linear(b[V * CHUNK + i], low, high)
            b[U * CHUNK + i], b[V * CHUNK + i] = s, t
            b[_ENVELOPE * CHUNK + i] = b[_DENSITY * CHUNK + i] = low + t * (high - low)
        if powered:
            for i in range(m):
                total = 0.0
                for c in range(len(weights)):
                    if weights[c] > 0:
                        total += weights[c] * power_sum(
                            where, ends, roots, power, coefficient, items[i], b[U * CHUNK + i],
                            b[V * CHUNK + i], c * terms, (c + 1) * terms,
                        )  # fmt: skip
                b[_DENSITY * CHUNK + i] = total
        for i in range(CHUNK):
            d = (2 * b[U * CHUNK + i] - 1) * b[_HALF * CHUNK + i]
            e = (2 * b[V * CHUNK + i] - 1) * b[(_COLUMN + 2) * CHUNK + i]
            c, s = short_cosine(d), short_sine(d)
            # At the horizon a cosine of rounding size may come out on the wrong side.
            cosine = max(b[_COSINE * CHUNK + i] * c - b[_SINE * CHUNK + i] * s, 0.0)
            sine = b[_SINE * CHUNK + i] * c + b[_COSINE * CHUNK + i] * s
            c, s = short_cosine(e), short_sine(e)
            x, y = b[_COLUMN * CHUNK + i], b[(_COLUMN + 1) * CHUNK + i]
            b[_OUT * CHUNK + i], b[(_OUT + 1) * CHUNK + i] = sine * (x * c - y * s), sine * (y * c + x * s)
            b[(_OUT + 2) * CHUNK + i] = cosine
            envelope, density = b[_ENVELOPE * CHUNK + i], b[_DENSITY * CHUNK + i]
            most = b[CHANCE * CHUNK + i] * b[_STEEPEST * CHUNK + i] * envelope
            found = density * cosine * over if exact or most < 2.0 * sine * cosine * density else REJECTED
            b[(_OUT + 3) * CHUNK + i] = ABOVE if density > envelope * slack else found
        before = filled
        used, filled = collected(b, _OUT, m, every or exact, wo, pdf, taken, filled)
        if used < 0:
            return -1, filled
        tried += used
        if weight.shape[1]:
            for k in range(before, filled):
                i = int(taken[k - before])
                item, s, t = int(items[i]), b[U * CHUNK + i], b[V * CHUNK + i]
                # f cos / pdf = f / f+ x integral: the cosine cancels, so this stays exact at the horizon.
                factor = integral / b[_DENSITY * CHUNK + i]
                for c in range(weight.shape[1]):
                    if powered:
                        value = power_sum(
                            where, ends, roots, power, coefficient, item, s, t, c * terms, (c + 1) * terms
                        )
                    else:
                        j = 4 + 4 * c
                        low = cells[item, j] + s * (cells[item, j + 2] - cells[item, j])
                        high = cells[item, j + 1] + s * (cells[item, j + 3] - cells[item, j + 1])
                        value = low + t * (high - low)
                    weight[k, c] = value * factor
    return tried, filled
