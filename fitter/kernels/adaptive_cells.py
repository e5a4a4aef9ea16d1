"""Cells of tables in an adaptive parameterisation: integrals, see :mod:`fitter.sampling.adaptive`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled
from fitter.kernels.adaptive import corner, inverse, looked_up
from fitter.kernels.angles import cosine_and_sine
from fitter.kernels.candidates import CHUNK
from fitter.kernels.quadrature import A, B, spread, summed

FloatArray = NDArray[np.float64]

# Rows of a chunk after the points and their weights.
_FACTOR, _S, _T, _LOBE, _VALUE = 3, 4, 5, 6, 7
_ROWS = 8


@compiled
def integrals(
    cells: FloatArray,
    x: FloatArray,
    share: FloatArray,
    density: FloatArray,
    along_x: FloatArray,
    along_y: FloatArray,
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
    b = np.empty(_ROWS * CHUNK)
    per = CHUNK // (n * n)
    for start in range(0, len(cells), per):
        count = min(per, len(cells) - start)
        m = spread(cells, start, count, x, share, b)
        for i in range(m):
            u = b[A * CHUNK + i]
            cos_m, sin_m = cosine_and_sine(u * u * (np.pi / 2))
            c, s = cosine_and_sine((2 * np.pi) * b[B * CHUNK + i] + (turn - np.pi))
            along = sin_m * (c * wi[0] + s * wi[1]) + cos_m * wi[2]
            z = 2 * along * cos_m - wi[2]
            up = z > 0 and along > 0
            b[_FACTOR * CHUNK + i] = (
                (8 * np.pi**2) * along * u * sin_m * (1.0 if cosined else z) if up else np.nan
            )
        for i in range(m):
            u, v = b[A * CHUNK + i], b[B * CHUNK + i]
            b[_S * CHUNK + i], b[_T * CHUNK + i] = inverse(density, along_x, along_y, columns, u, v)
            b[_LOBE * CHUNK + i] = looked_up(ndf, lobes[1], corner(lobes[0], lobes[1], u, v)) * factor
        for i in range(m):
            at = corner(shape[0], shape[1], b[_S * CHUNK + i], b[_T * CHUNK + i])
            b[_VALUE * CHUNK + i] = (
                looked_up(data, shape[1], at) * b[_LOBE * CHUNK + i] * b[_FACTOR * CHUNK + i]
            )
        summed(b, _VALUE, start, count, n * n, found, known)
