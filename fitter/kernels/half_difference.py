"""Draws from grids in half and difference angles, see :mod:`fitter.sampling.half_difference`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled, part
from fitter.kernels.angles import short_cosine, short_sine
from fitter.kernels.candidates import ABOVE, CHANCE, CHUNK, OWN, REJECTED, U, V, collected, proposed
from fitter.kernels.grids import half_difference, located

FloatArray = NDArray[np.float64]

# Rows of a chunk: the cell, the direction and pdf, then fractions on the three axes, and whether it was
# measured, then indices.
_SIN2, _COS2, _CHANGE, _COSINE, _SINE, _HALF, _MAJORANT = range(OWN, OWN + 7)
OUT, _AT, _WHERE, DENSITY = OWN + 7, OWN + 11, OWN + 15, OWN + 19
ROWS = DENSITY + 1


@part
def placed(
    nodes: FloatArray, first: NDArray[np.int64], about: FloatArray, b: FloatArray, m: int
) -> None:
    """Angles in the rows from ``_AT`` on replaced by fractions on their axes; into the rows from ``_WHERE``
    on the flat index of the lowest corner, and strides to the ones beside."""
    columns, deep, known = about[1, 0], about[2, 0], (_AT + 3) * CHUNK
    for i in range(m):
        b[known + i], b[_WHERE * CHUNK + i] = 1.0, 0.0
    low, step = _WHERE * CHUNK, (_WHERE + 1) * CHUNK
    located(nodes, first, about, 0, b, _AT * CHUNK, known, columns * deep, low, step, m)
    located(nodes, first, about, 1, b, (_AT + 1) * CHUNK, known, deep, low, step + CHUNK, m)
    located(nodes, first, about, 2, b, (_AT + 2) * CHUNK, known, 1.0, low, step + 2 * CHUNK, m)


@part
def corner(b: FloatArray, i: int) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    """What :func:`placed` found, as indices: those that go back are what they are to unsigned numbers."""
    return (
        np.uint64(np.int64(b[_WHERE * CHUNK + i])), np.uint64(np.int64(b[(_WHERE + 1) * CHUNK + i])),
        np.uint64(np.int64(b[(_WHERE + 2) * CHUNK + i])), np.uint64(np.int64(b[(_WHERE + 3) * CHUNK + i])),
    )  # fmt: skip


@part
def angles(about: FloatArray, start: float, wi: tuple[float, float], b: FloatArray, m: int) -> None:
    """Half and difference angles, into the rows from ``_AT`` on, of the directions in the rows from ``OUT``
    on."""
    period = about[2, 5] if about[2, 5] > 0 else 2 * np.pi
    for i in range(m):
        theta_h, theta_d, phi_d = half_difference(
            wi[0], wi[1], b[OUT * CHUNK + i], b[(OUT + 1) * CHUNK + i], b[(OUT + 2) * CHUNK + i]
        )
        phi_d -= start
        b[_AT * CHUNK + i], b[(_AT + 1) * CHUNK + i] = theta_h, theta_d
        b[(_AT + 2) * CHUNK + i] = start + max(phi_d - period * np.floor(phi_d * (1 / period)), 0.0)


@part
def trilinear(table: FloatArray, b: FloatArray, i: int) -> float:
    """The interpolant of flat values; NaN outside what was measured and next to masked nodes."""
    a, down, across, along = corner(b, i)
    r, s, t = b[_AT * CHUNK + i], b[(_AT + 1) * CHUNK + i], b[(_AT + 2) * CHUNK + i]
    g, c = a + across, a + down
    d = c + across
    f00, f01 = table[a] + t * (table[a + along] - table[a]), table[g] + t * (table[g + along] - table[g])
    f10, f11 = table[c] + t * (table[c + along] - table[c]), table[d] + t * (table[d + along] - table[d])
    low, high = f00 + s * (f01 - f00), f10 + s * (f11 - f10)
    return low + r * (high - low) if b[(_AT + 3) * CHUNK + i] > 0 else np.nan


@part
def channel(table: FloatArray, c: int, b: FloatArray, i: int) -> float:
    """The same of one channel of values (N, C), clamped at 0, where all nodes are usable."""
    a, down, across, along = corner(b, i)
    r, s, t = b[_AT * CHUNK + i], b[(_AT + 1) * CHUNK + i], b[(_AT + 2) * CHUNK + i]
    total = 0.0
    for k in range(8):
        index = a + np.uint64(k >> 2) * down + np.uint64((k >> 1) & 1) * across + np.uint64(k & 1) * along
        share = (r if k & 4 else 1 - r) * (s if k & 2 else 1 - s) * (t if k & 1 else 1 - t)
        total += share * max(table[index, c], 0.0)
    return total


@compiled
def fill(
    share: FloatArray,
    alias: NDArray[np.int32],
    cells: FloatArray,
    nodes: FloatArray,
    first: NDArray[np.int64],
    about: FloatArray,
    wi: tuple[float, float],
    turn: tuple[float, float],
    table: FloatArray,
    channels: FloatArray,
    integral: float,
    state: NDArray[np.uint64],
    every: bool,
    wo: FloatArray,
    pdf: FloatArray,
    weight: FloatArray,
    budget: int,
) -> tuple[int, int]:
    """Draws into ``wo`` (n, 3), ``pdf`` (n,) and ``weight`` (n, C) from at most ``budget`` candidates.

    cells : (K, 8) sin^2 and cos^2 of theta, their change, cosine and sine of the middle of the azimuths, half
    their width, majorant, nothing. wi : its sine and cosine. turn : cosine and sine of its azimuth. table :
    (N,) f+ weighted; channels : (N, C). every : keep rejected candidates, too, with a pdf of -1.

    Returns how many candidates were tried, -1 where one exceeded its bound, and how many draws were made.
    """
    over = 1.0 / integral
    bits = np.empty(ROWS * CHUNK, np.uint64)
    b = bits.view(np.float64)
    items, taken = np.empty(CHUNK, np.int64), np.empty(CHUNK + 1, np.int64)
    tried = filled = 0
    while filled < len(pdf) and tried < budget:
        m = min(CHUNK, budget - tried)
        proposed(state, share, alias, bits, b, items)
        for i in range(CHUNK):
            item = np.uint64(items[i])
            b[_SIN2 * CHUNK + i], b[_COS2 * CHUNK + i] = cells[item, 0], cells[item, 1]
            b[_CHANGE * CHUNK + i], b[_COSINE * CHUNK + i] = cells[item, 2], cells[item, 3]
            b[_SINE * CHUNK + i], b[_HALF * CHUNK + i] = cells[item, 4], cells[item, 5]
            b[_MAJORANT * CHUNK + i] = cells[item, 6]
        for i in range(CHUNK):
            # sin^2 and cos^2 drawn together: either alone would lose half the other's digits.
            change = b[U * CHUNK + i] * b[_CHANGE * CHUNK + i]
            flat, z = np.sqrt(b[_SIN2 * CHUNK + i] + change), np.sqrt(max(b[_COS2 * CHUNK + i] - change, 0.0))
            d = (2 * b[V * CHUNK + i] - 1) * b[_HALF * CHUNK + i]
            c, s = short_cosine(d), short_sine(d)
            x, y = b[_COSINE * CHUNK + i], b[_SINE * CHUNK + i]
            b[OUT * CHUNK + i], b[(OUT + 1) * CHUNK + i] = flat * (x * c - y * s), flat * (y * c + x * s)
            b[(OUT + 2) * CHUNK + i] = z
        angles(about, nodes[2, 0], wi, b, CHUNK)
        placed(nodes, first, about, b, CHUNK)
        for i in range(CHUNK):
            b[DENSITY * CHUNK + i] = trilinear(table, b, i)
        for i in range(CHUNK):
            x, y, density = b[OUT * CHUNK + i], b[(OUT + 1) * CHUNK + i], b[DENSITY * CHUNK + i]
            majorant = b[_MAJORANT * CHUNK + i]
            # False where it is NaN: not measured there.
            accepted = b[CHANCE * CHUNK + i] * majorant < density
            found = density * b[(OUT + 2) * CHUNK + i] * over if accepted else REJECTED
            b[(OUT + 3) * CHUNK + i] = ABOVE if density > majorant else found
            b[OUT * CHUNK + i] = turn[0] * x - turn[1] * y
            b[(OUT + 1) * CHUNK + i] = turn[1] * x + turn[0] * y
        before = filled
        used, filled = collected(b, OUT, m, every, wo, pdf, taken, filled)
        if used < 0:
            return -1, filled
        tried += used
        if weight.shape[1]:
            for k in range(before, filled):
                i = int(taken[k - before])
                # f cos / pdf = f / f+ x integral: the cosine cancels, so this stays exact at the horizon.
                factor = integral / b[DENSITY * CHUNK + i]
                for c in range(weight.shape[1]):
                    weight[k, c] = channel(channels, c, b, i) * factor
    return tried, filled
