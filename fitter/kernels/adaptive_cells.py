"""Cells of tables in an adaptive parameterisation: bounds and integrals, see
:mod:`fitter.sampling.adaptive`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled
from fitter.kernels.adaptive import LOBE, LOOKED_UP, VALUE, S, T, looked_up, unwarped
from fitter.kernels.angles import arc, cosine_and_sine
from fitter.kernels.candidates import CHUNK
from fitter.kernels.maxima import over_rectangle
from fitter.kernels.quadrature import A, B, spread, summed

FloatArray = NDArray[np.float64]

# Rows of a chunk after the points and their weights.
_FACTOR, _AT = 3, 4
_ROWS = _AT + LOOKED_UP


@compiled
def integrals(
    cells: FloatArray,
    x: FloatArray,
    share: FloatArray,
    warp: FloatArray,
    along: FloatArray,
    columns: int,
    data: FloatArray,
    shape: tuple[int, int],
    ndf: FloatArray,
    lobes: tuple[int, int],
    factor: float,
    cosined: bool,
    wi: tuple[float, float, float],
    turn: float,
    found: FloatArray,
    known: NDArray[np.int64],
) -> None:
    """The field's integral over cells (K, 4) by points ``x`` (n,) in [-1, 1] along both sides and their
    weights, into ``found`` (K,), and at how many of the points it was measured, into ``known`` (K,).

    What is known of the table is as in :func:`fitter.kernels.adaptive.fill`.
    """
    n = len(x)
    # Points that a last chunk has none of are looked up, too.
    b = np.zeros(_ROWS * CHUNK)
    per = CHUNK // (n * n)
    for start in range(0, len(cells), per):
        count = min(per, len(cells) - start)
        m = spread(cells, start, count, x, share, b)
        for i in range(m):
            u = b[A * CHUNK + i]
            cos_m, sin_m = cosine_and_sine(u * u * (np.pi / 2))
            c, s = cosine_and_sine((2 * np.pi) * b[B * CHUNK + i] + (turn - np.pi))
            along_m = sin_m * (c * wi[0] + s * wi[1]) + cos_m * wi[2]
            z = 2 * along_m * cos_m - wi[2]
            up = z > 0 and along_m > 0
            b[_FACTOR * CHUNK + i] = (
                (8 * np.pi**2) * along_m * u * sin_m * (1.0 if cosined else z) if up else np.nan
            )
        looked_up(warp, along, columns, data, shape, ndf, lobes, b, A, B, _AT)
        for i in range(m):
            value = b[(_AT + VALUE) * CHUNK + i] * b[(_AT + LOBE) * CHUNK + i]
            b[(_AT + VALUE) * CHUNK + i] = value * factor * b[_FACTOR * CHUNK + i]
        summed(b, _AT + VALUE, start, count, n * n, found, known)


@compiled
def bounds(
    cells: FloatArray,
    warp: FloatArray,
    along: FloatArray,
    columns: int,
    data_nodes: FloatArray,
    data_maxima: NDArray[np.float64],
    lobe_nodes: FloatArray,
    lobe_maxima: NDArray[np.float64],
    factor: float,
    wi: tuple[float, float, float],
    turn: float,
    slack: float,
    found: FloatArray,
) -> None:
    """:meth:`AdaptiveField.bound` of cells (K, 4), into ``found`` (K,). nodes, maxima : of data and lobe, as
    :func:`fitter.sampling.maxima.packed` has them. factor : of their product, for f+ cos(theta_o)
    per unit of the chart but for what depends on the cell. slack : of places in the uniform square."""
    b = np.zeros(_ROWS * CHUNK)
    per = CHUNK >> 2
    for start in range(0, len(cells), per):
        count = min(per, len(cells) - start)
        for k in range(count):
            for c in range(4):
                b[A * CHUNK + 4 * k + c] = cells[start + k, c >> 1]
                b[B * CHUNK + 4 * k + c] = cells[start + k, 2 + (c & 1)]
        unwarped(warp, along, columns, b, A, B, _AT)
        for k in range(count):
            u0, u1, v0, v1 = (
                cells[start + k, 0], cells[start + k, 1], cells[start + k, 2], cells[start + k, 3],
            )  # fmt: skip
            # 1. A rectangle of the uniform square that holds the cell's image.
            s0 = t0 = np.inf
            s1 = t1 = -np.inf
            for i in range(4 * k, 4 * k + 4):
                s, t = b[(_AT + S) * CHUNK + i], b[(_AT + T) * CHUNK + i]
                s0, s1, t0, t1 = min(s0, s), max(s1, s), min(t0, t), max(t1, t)
            value = over_rectangle(data_nodes, data_maxima, s0 - slack, s1 + slack, t0 - slack, t1 + slack)
            # 2. The lobe on the cell itself.
            value *= over_rectangle(lobe_nodes, lobe_maxima, u0, u1, v0, v1)
            # 3. The largest wi.m.
            theta0, theta1 = u0 * u0 * (np.pi / 2), u1 * u1 * (np.pi / 2)
            z, r = cosine_and_sine(0.5 * (theta0 + theta1))
            c, s = cosine_and_sine((v0 + v1 - 1) * np.pi + turn)
            x, y = r * c, r * s
            _, steepest = cosine_and_sine(theta1)
            _, tall = cosine_and_sine(0.25 * (theta1 - theta0))
            _, wide = cosine_and_sine(0.5 * np.pi * (v1 - v0))
            half = np.sqrt(min(tall * tall + r * steepest * wide * wide, 1.0))
            radius = 2 * arc(half, np.sqrt((1 - half) * (1 + half)))
            p, q, w = y * wi[2] - z * wi[1], z * wi[0] - x * wi[2], x * wi[1] - y * wi[0]
            angle = arc(np.sqrt(p * p + q * q + w * w), x * wi[0] + y * wi[1] + z * wi[2])
            nearest, _ = cosine_and_sine(max(angle - radius - 1e-12, 0.0))
            nearest = max(nearest, 0.0)
            # 4. u sin(theta_m) grows with u.
            value *= nearest * factor * u1 * steepest
            # wo is 2 (wi.m) m - wi: all below the horizon where the largest factors leave it there.
            highest, _ = cosine_and_sine(theta0)
            below = 2 * nearest * highest < wi[2] * (1 - 1e-9)
            found[start + k] = 0.0 if below else max(value, 0.0)
