"""Draws from tables in an adaptive parameterisation, see :mod:`fitter.sampling.adaptive`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled, part
from fitter.kernels.angles import cosine_and_sine
from fitter.kernels.candidates import ABOVE, CHANCE, CHUNK, REJECTED, U, V, collected, proposed
from fitter.kernels.uniform import left, resumed

FloatArray = NDArray[np.float64]

# Rows of a chunk; the last two are of f+ and of what the data are to be multiplied by for it.
_U, _WIDTH, _V, _HEIGHT, _MAJORANT = 3, 4, 5, 6, 7
_OUT, _FACTOR, _S, _T, _DENSITY, _LOBE = 8, 12, 13, 14, 15, 16
_ROWS = 17

#: Where a point lies on an image: the flat index of the corner below, and fractions in its cell.
Corner = tuple[int, float, float]


@part
def corner(height: int, width: int, x: float, y: float) -> Corner:
    """Of a point of the unit square on an image (height, width)."""
    across, down = x * (width - 1), y * (height - 1)
    i, j = min(max(int(across), 0), width - 2), min(max(int(down), 0), height - 2)
    return j * width + i, across - i, down - j


@part
def looked_up(image: FloatArray, width: int, at: Corner) -> float:
    """The bilinear image, flat."""
    a, x, y = at
    b = a + width
    low, high = image[a] + x * (image[a + 1] - image[a]), image[b] + x * (image[b + 1] - image[b])
    return low + y * (high - low)


@part
def inverse(
    density: FloatArray, along_x: FloatArray, along_y: FloatArray, width: int, x: float, y: float
) -> tuple[float, float]:
    """As :meth:`fitter.sampling.warp.Warp.inverse_of_one`, of a point of the unit square, for a flat
    density."""
    height = len(along_y)
    across, down = x * (width - 1), y * (height - 1)
    i, j = min(max(int(across), 0), width - 2), min(max(int(down), 0), height - 2)
    x, y, a = across - i, down - j, j * width + i
    b = a + width
    inside = x * (1 / (width - 1))
    low = along_x[a] + (density[a] + 0.5 * (density[a + 1] - density[a]) * x) * inside
    high = along_x[b] + (density[b] + 0.5 * (density[b + 1] - density[b]) * x) * inside
    low_row, high_row = along_x[(j + 1) * width - 1], along_x[(j + 2) * width - 1]
    t = along_y[j] + (low_row + 0.5 * (high_row - low_row) * y) * y * (1 / (height - 1))
    mix = y if (1 - y) * low_row + y * high_row > 0 else 0.5
    row = (1 - mix) * low_row + mix * high_row
    # Rows without density have no conditional distribution: nothing is ever mapped there.
    s = ((1 - mix) * low + mix * high) / row if row > 0 else 0.0
    return min(max(s, 0.0), 1.0), min(max(t, 0.0), 1.0)


@compiled
def fill(
    share: FloatArray,
    alias: NDArray[np.int32],
    cells: FloatArray,
    density: FloatArray,
    along_x: FloatArray,
    along_y: FloatArray,
    columns: int,
    data: FloatArray,
    shape: tuple[int, int],
    channels: FloatArray,
    ndf: FloatArray,
    lobes: tuple[int, int],
    factor: float,
    cosined: bool,
    wi: tuple[float, float, float],
    sign: tuple[float, float, float],
    turn: float,
    integral: float,
    state: NDArray[np.uint64],
    every: bool,
    wo: FloatArray,
    pdf: FloatArray,
    weight: FloatArray,
    budget: int,
) -> tuple[int, int]:
    """Draws into ``wo`` (n, 3), ``pdf`` (n,) and ``weight`` (n, C) from at most ``budget`` candidates.

    cells : (K, 5) u and its width, v and its height, majorant. data, ndf : images, flat, channels (H W C,),
    whose product times ``factor`` is f+, or f+ cos(theta_o) where ``cosined``. wi : on the stored copy of
    the surface; sign : what takes a component back to the sample; turn : what the half vector's azimuth
    counts from. every : keep rejected candidates, too, with a pdf of -1.

    Returns how many candidates were tried, -1 where one exceeded its bound, and how many draws were made.
    """
    r = resumed(state)
    over = 1.0 / integral
    height, width = shape
    rows, across = lobes
    b, items, taken = np.empty(_ROWS * CHUNK), np.empty(CHUNK, np.int64), np.empty(CHUNK + 1, np.int64)
    tried = filled = 0
    while filled < len(pdf) and tried < budget:
        m = min(CHUNK, budget - tried)
        r = proposed(r, share, alias, cells, 5, items, b, m)
        for i in range(m):
            u = b[_U * CHUNK + i] + b[U * CHUNK + i] * b[_WIDTH * CHUNK + i]
            v = b[_V * CHUNK + i] + b[V * CHUNK + i] * b[_HEIGHT * CHUNK + i]
            cos_m, sin_m = cosine_and_sine(u * u * (np.pi / 2))
            x, y = cosine_and_sine((2 * np.pi) * v + (turn - np.pi))
            x, y = sin_m * x, sin_m * y
            along = x * wi[0] + y * wi[1] + cos_m * wi[2]
            b[U * CHUNK + i], b[V * CHUNK + i] = u, v
            b[_OUT * CHUNK + i] = (2 * along * x - wi[0]) * sign[0]
            b[(_OUT + 1) * CHUNK + i] = (2 * along * y - wi[1]) * sign[1]
            b[(_OUT + 2) * CHUNK + i] = 2 * along * cos_m - wi[2]
            # Per unit of the chart's measure; nothing below the horizon.
            b[_FACTOR * CHUNK + i] = (8 * np.pi**2) * along * u * sin_m if along > 0 else 0.0
        for i in range(m):
            u, v = b[U * CHUNK + i], b[V * CHUNK + i]
            b[_S * CHUNK + i], b[_T * CHUNK + i] = inverse(density, along_x, along_y, columns, u, v)
            b[_LOBE * CHUNK + i] = looked_up(ndf, across, corner(rows, across, u, v)) * factor
        for i in range(m):
            at = corner(height, width, b[_S * CHUNK + i], b[_T * CHUNK + i])
            b[_DENSITY * CHUNK + i] = looked_up(data, width, at)
        for i in range(m):
            z, majorant = b[(_OUT + 2) * CHUNK + i], b[_MAJORANT * CHUNK + i]
            up = z > 0
            lobe = b[_LOBE * CHUNK + i] / z if cosined and up else b[_LOBE * CHUNK + i]
            value = b[_DENSITY * CHUNK + i] * lobe
            field = value * z * b[_FACTOR * CHUNK + i] if up else 0.0
            # False where it is NaN: not measured there.
            found = value * z * over if b[CHANCE * CHUNK + i] * majorant < field else REJECTED
            b[(_OUT + 3) * CHUNK + i] = ABOVE if field > majorant else found
            b[_LOBE * CHUNK + i], b[_DENSITY * CHUNK + i] = lobe, value
        before = filled
        used, filled = collected(b, _OUT, m, every, wo, pdf, taken, filled)
        if used < 0:
            return -1, filled
        tried += used
        if weight.shape[1]:
            for k in range(before, filled):
                i = int(taken[k - before])
                a, x, y = corner(height, width, b[_S * CHUNK + i], b[_T * CHUNK + i])
                # f cos / pdf = f / f+ x integral: the cosine cancels, so this stays exact at the horizon.
                mine = b[_LOBE * CHUNK + i] * integral / b[_DENSITY * CHUNK + i]
                count = weight.shape[1]
                for c in range(count):
                    j = a * count + c
                    low = channels[j] + x * (channels[j + count] - channels[j])
                    j += width * count
                    high = channels[j] + x * (channels[j + count] - channels[j])
                    weight[k, c] = (low + y * (high - low)) * mine
    left(state, r)
    return tried, filled
