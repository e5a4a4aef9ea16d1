"""Draws from grids in half and difference angles, see :mod:`fitter.sampling.half_difference`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled, part
from fitter.kernels.angles import cosine_and_sine
from fitter.kernels.candidates import ABOVE, CHANCE, CHUNK, REJECTED, U, V, collected, proposed
from fitter.kernels.grids import half_difference, located
from fitter.kernels.uniform import left, resumed

FloatArray = NDArray[np.float64]

# Rows of a chunk: the cell, the direction and pdf, then fractions on the three axes, and whether it was
# measured.
_SIN2, _COS2, _CHANGE, _PHI, _WIDTH, _MAJORANT = 3, 4, 5, 6, 7, 8
OUT, _AT, DENSITY = 9, 13, 17
ROWS = 18


@part
def placed(
    nodes: FloatArray,
    first: NDArray[np.int64],
    about: FloatArray,
    where: NDArray[np.int64],
    b: FloatArray,
    m: int,
) -> None:
    """Angles in the rows from ``_AT`` on replaced by fractions on their axes; into the rows of ``where`` the
    flat index of the lowest corner, and strides to the ones beside."""
    columns, deep = np.int64(about[1, 0]), np.int64(about[2, 0])
    for i in range(m):
        b[(_AT + 3) * CHUNK + i] = 1.0
    for k in range(3):
        start = (_AT + k) * CHUNK
        located(nodes, first, about, k, b, start, where, where[3 * CHUNK :], k * CHUNK, m, (_AT + 3) * CHUNK)
    for i in range(m):
        where[i] = (where[i] * columns + where[CHUNK + i]) * deep + where[2 * CHUNK + i]
        where[3 * CHUNK + i] *= columns * deep
        where[4 * CHUNK + i] *= deep


@part
def angles(about: FloatArray, start: float, wi: tuple[float, float], b: FloatArray, m: int) -> None:
    """Half and difference angles, into the rows from ``_AT`` on, of the directions in the rows from ``OUT``
    on."""
    period = about[2, 5] if about[2, 5] > 0 else 2 * np.pi
    for i in range(m):
        theta_h, theta_d, phi_d = half_difference(
            wi[0], 0.0, wi[1], b[OUT * CHUNK + i], b[(OUT + 1) * CHUNK + i], b[(OUT + 2) * CHUNK + i]
        )
        phi_d -= start
        b[_AT * CHUNK + i], b[(_AT + 1) * CHUNK + i] = theta_h, theta_d
        b[(_AT + 2) * CHUNK + i] = start + max(phi_d - period * np.floor(phi_d * (1 / period)), 0.0)


@part
def trilinear(table: FloatArray, where: NDArray[np.int64], b: FloatArray, i: int) -> float:
    """The interpolant of flat values; NaN outside what was measured and next to masked nodes."""
    a, down, across, along = where[i], where[3 * CHUNK + i], where[4 * CHUNK + i], where[5 * CHUNK + i]
    r, s, t = b[_AT * CHUNK + i], b[(_AT + 1) * CHUNK + i], b[(_AT + 2) * CHUNK + i]
    g, c = a + across, a + down
    d = c + across
    f00, f01 = table[a] + t * (table[a + along] - table[a]), table[g] + t * (table[g + along] - table[g])
    f10, f11 = table[c] + t * (table[c + along] - table[c]), table[d] + t * (table[d + along] - table[d])
    low, high = f00 + s * (f01 - f00), f10 + s * (f11 - f10)
    return low + r * (high - low) if b[(_AT + 3) * CHUNK + i] > 0 else np.nan


@part
def channel(table: FloatArray, c: int, where: NDArray[np.int64], b: FloatArray, i: int) -> float:
    """The same of one channel of values (N, C), clamped at 0, where all nodes are usable."""
    a, down, across, along = where[i], where[3 * CHUNK + i], where[4 * CHUNK + i], where[5 * CHUNK + i]
    r, s, t = b[_AT * CHUNK + i], b[(_AT + 1) * CHUNK + i], b[(_AT + 2) * CHUNK + i]
    total = 0.0
    for k in range(8):
        index = a + (k >> 2) * down + ((k >> 1) & 1) * across + (k & 1) * along
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

    cells : (K, 6) sin^2 and cos^2 of theta, their change, azimuth, width and majorant. wi : its sine and
    cosine. turn : cosine and sine of its azimuth. table : (N,) f+ weighted; channels : (N, C). every : keep
    rejected candidates, too, with a pdf of -1.

    Returns how many candidates were tried, -1 where one exceeded its bound, and how many draws were made.
    """
    r = resumed(state)
    over = 1.0 / integral
    b, items, taken = np.empty(ROWS * CHUNK), np.empty(CHUNK, np.int64), np.empty(CHUNK + 1, np.int64)
    where = np.empty(6 * CHUNK, np.int64)
    tried = filled = 0
    while filled < len(pdf) and tried < budget:
        m = min(CHUNK, budget - tried)
        r = proposed(r, share, alias, cells, 6, items, b, m)
        for i in range(m):
            # sin^2 and cos^2 drawn together: either alone would lose half the other's digits.
            change = b[U * CHUNK + i] * b[_CHANGE * CHUNK + i]
            flat, z = np.sqrt(b[_SIN2 * CHUNK + i] + change), np.sqrt(max(b[_COS2 * CHUNK + i] - change, 0.0))
            c, s = cosine_and_sine(b[_PHI * CHUNK + i] + b[V * CHUNK + i] * b[_WIDTH * CHUNK + i])
            b[OUT * CHUNK + i], b[(OUT + 1) * CHUNK + i], b[(OUT + 2) * CHUNK + i] = flat * c, flat * s, z
        angles(about, nodes[2, 0], wi, b, m)
        placed(nodes, first, about, where, b, m)
        for i in range(m):
            b[DENSITY * CHUNK + i] = trilinear(table, where, b, i)
        for i in range(m):
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
                    weight[k, c] = channel(channels, c, where, b, i) * factor
    left(state, r)
    return tried, filled
