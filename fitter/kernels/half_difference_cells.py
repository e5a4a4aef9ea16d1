"""Cells of grids in half and difference angles: bounds and integrals, see
:mod:`fitter.sampling.half_difference`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled
from fitter.kernels.angles import cosine_and_sine
from fitter.kernels.candidates import CHUNK
from fitter.kernels.grids import half_difference
from fitter.kernels.half_difference import DENSITY, OUT, ROWS, angles, placed, trilinear
from fitter.kernels.maxima import box, shares, span, window, windowed
from fitter.kernels.quadrature import WEIGHT, A, B, spread, summed

FloatArray = NDArray[np.float64]


@compiled
def integrals(
    cells: FloatArray,
    x: FloatArray,
    share: FloatArray,
    nodes: FloatArray,
    first: NDArray[np.int64],
    about: FloatArray,
    wi: tuple[float, float],
    table: FloatArray,
    found: FloatArray,
    known: NDArray[np.int64],
) -> None:
    """The field's integral over cells (K, 4) by points ``x`` (n,) in [-1, 1] along both sides and their
    weights, into ``found`` (K,), and at how many of the points it was measured, into ``known`` (K,)."""
    n = len(x)
    b = np.empty(ROWS * CHUNK)
    per = CHUNK // (n * n)
    for start in range(0, len(cells), per):
        count = min(per, len(cells) - start)
        m = spread(cells, start, count, x, share, b)
        for i in range(m):
            cosine, sine = cosine_and_sine(b[A * CHUNK + i])
            c, s = cosine_and_sine(b[B * CHUNK + i])
            b[OUT * CHUNK + i], b[(OUT + 1) * CHUNK + i] = sine * c, sine * s
            b[(OUT + 2) * CHUNK + i] = cosine
            b[WEIGHT * CHUNK + i] *= sine * cosine
        angles(about, nodes[2, 0], wi, b, m)
        placed(nodes, first, about, b, m)
        for i in range(m):
            b[DENSITY * CHUNK + i] = trilinear(table, b, i)
        summed(b, DENSITY, start, count, n * n, found, known)


@compiled
def bounds(
    cells: FloatArray,
    wi: tuple[float, float],
    nodes: FloatArray,
    about: FloatArray,
    sparse: FloatArray,
    around: FloatArray,
    count: int,
    levels: NDArray[np.float32],
    whole: FloatArray,
    slack: float,
    found: FloatArray,
) -> None:
    """:meth:`HalfDifferenceField.bound` of cells (K, 4), into ``found`` (K,); steps are numbered as there.

    nodes, about : as :func:`fitter.sampling.axes.packed` has them. sparse, around, levels, whole : of the
    maxima over boxes and windows. slack : added to every reach.
    """
    rows, columns = int(about[0, 0]), int(about[1, 0])
    for k in range(len(cells)):
        theta0, theta1, phi0, phi1 = cells[k, 0], cells[k, 1], cells[k, 2], cells[k, 3]
        # 1. The radius, and the angles at the centre.
        cosine, sine = cosine_and_sine(0.5 * (theta0 + theta1))
        c, s = cosine_and_sine(0.5 * (phi0 + phi1))
        _, sine1 = cosine_and_sine(theta1)
        _, tall = cosine_and_sine(0.25 * (theta1 - theta0))
        _, wide = cosine_and_sine(0.25 * (phi1 - phi0))
        radius = 2 * np.arcsin(np.sqrt(min(tall * tall + sine * sine1 * wide * wide, 1.0)))
        theta_h, theta_d, phi_d = half_difference(wi[0], wi[1], sine * c, sine * s, cosine)
        # 2. to 4. How far each angle may be from there.
        reach_d = 0.5 * radius + slack
        steepest = theta_d + reach_d
        safe = steepest < np.pi / 2 - 1e-6
        reach_h, reach_phi = np.pi + slack, np.inf
        if safe:
            c, _ = cosine_and_sine(steepest)
            reach_h = 0.5 * radius / c + slack
            least_h, least_d = theta_h - reach_h, theta_d - reach_d
            if least_h > 1e-6 and least_d > 1e-6:
                c, s = cosine_and_sine(least_h)
                turning = c / s
                c, s = cosine_and_sine(least_d)
                reach_phi = reach_h * (turning + c / s) * (1 + 1e-9)
        # 5. The largest value over the box.
        across = span(nodes, 0, rows, theta_h - reach_h, theta_h + reach_h)
        down = span(nodes, 1, columns, theta_d - reach_d, theta_d + reach_d)
        if across[1] - across[0] > 2 or down[1] - down[0] > 2:
            found[k] = box(sparse, across[0], across[1], down[0], down[1])
            continue
        some = window(around, count, levels, phi_d - reach_phi, phi_d + reach_phi)
        i0, i1, i2 = across[0], min(across[0] + 1, rows - 1), min(across[0] + 2, rows - 1)
        j0, j1, j2 = down[0], min(down[0] + 1, columns - 1), min(down[0] + 2, columns - 1)
        n00, n01, n02 = (
            windowed(levels, whole, some, i0, j0), windowed(levels, whole, some, i0, j1),
            windowed(levels, whole, some, i0, j2),
        )  # fmt: skip
        n10, n11, n12 = (
            windowed(levels, whole, some, i1, j0), windowed(levels, whole, some, i1, j1),
            windowed(levels, whole, some, i1, j2),
        )  # fmt: skip
        n20, n21, n22 = (
            windowed(levels, whole, some, i2, j0), windowed(levels, whole, some, i2, j1),
            windowed(levels, whole, some, i2, j2),
        )  # fmt: skip
        most = 0.0
        for p in range(3):
            a0, a1, a2 = shares(nodes, 0, rows, across, p)
            r0, r1, r2 = (
                a0 * n00 + a1 * n10 + a2 * n20,
                a0 * n01 + a1 * n11 + a2 * n21,
                a0 * n02 + a1 * n12 + a2 * n22,
            )
            for q in range(3):
                b0, b1, b2 = shares(nodes, 1, columns, down, q)
                most = max(most, b0 * r0 + b1 * r1 + b2 * r2)
        found[k] = most
