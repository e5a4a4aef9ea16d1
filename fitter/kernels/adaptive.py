"""Draws from tables in an adaptive parameterisation, see :mod:`fitter.sampling.adaptive`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled, part
from fitter.kernels.angles import cosine_and_sine, short_cosine, short_sine
from fitter.kernels.candidates import ABOVE, CHANCE, CHUNK, OWN, REJECTED, U, V, collected, proposed

FloatArray = NDArray[np.float64]

#: Rows of a chunk after those of a kernel's own: where a point lies on an image, as the flat index of the
#: corner below and fractions in its cell, of the warp and of the lobe's image; what is looked up there; and
#: what comes of it: the point's place on the data, and the lobe.
INDEX, X, Y, ROW, LOBE_INDEX, LOBE_X, LOBE_Y, FOUND, S, T, LOBE, VALUE = (
    0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19,
)  # fmt: skip
LOOKED_UP = 20

_U, _WIDTH, _V, _HEIGHT, _MAJORANT, _COSINE, _SINE = range(OWN, OWN + 7)
_OUT, _FACTOR, _AT = OWN + 7, OWN + 11, OWN + 12
_ROWS = _AT + LOOKED_UP

_ONE, _TWO = np.uint64(1), np.uint64(2)


@part
def cornered(
    b: FloatArray, u: int, v: int, height: int, width: int, index: int, x: int, y: int, row: int
) -> None:
    """Of points of the unit square, in the rows ``u`` and ``v``, on an image (height, width): the flat index
    of the corner below, fractions in its cell, and the number of its row, each into a row of that number."""
    across, down = np.float64(width - 1), np.float64(height - 1)
    for i in range(CHUNK):
        p, q = b[u * CHUNK + i] * across, b[v * CHUNK + i] * down
        k, j = min(max(np.floor(p), 0.0), across - 1.0), min(max(np.floor(q), 0.0), down - 1.0)
        b[index * CHUNK + i], b[x * CHUNK + i], b[y * CHUNK + i] = j * width + k, p - k, q - j
        b[row * CHUNK + i] = j


@part
def gathered(image: FloatArray, width: int, b: FloatArray, index: int, found: int) -> None:
    """The four corners of cells of a flat image, into rows from ``found`` on."""
    below = np.uint64(width)
    for i in range(CHUNK):
        a = np.uint64(np.int64(b[index * CHUNK + i]))
        b[found * CHUNK + i], b[(found + 1) * CHUNK + i] = image[a], image[a + _ONE]
        b[(found + 2) * CHUNK + i], b[(found + 3) * CHUNK + i] = image[a + below], image[a + below + _ONE]


@part
def blended(b: FloatArray, found: int, x: int, y: int, i: int) -> float:
    """What is bilinear between corners in rows from ``found`` on."""
    s = b[x * CHUNK + i]
    low = b[found * CHUNK + i] + s * (b[(found + 1) * CHUNK + i] - b[found * CHUNK + i])
    high = b[(found + 2) * CHUNK + i] + s * (b[(found + 3) * CHUNK + i] - b[(found + 2) * CHUNK + i])
    return low + b[y * CHUNK + i] * (high - low)


@part
def looked_up(
    warp: FloatArray, along: FloatArray, columns: int, data: FloatArray, shape: tuple[int, int],
    ndf: FloatArray, lobes: tuple[int, int], b: FloatArray, u: int, v: int, at: int,
) -> None:  # fmt: skip
    """Data and lobe at points of the unit square in the rows ``u`` and ``v``, into rows from ``at`` on; what
    is known of the table is as in :func:`fill`. Loops that look up do nothing else, so that one look-up need
    not wait for another; the others are vector instructions."""
    found = at + FOUND
    cornered(b, u, v, lobes[0], lobes[1], at + LOBE_INDEX, at + LOBE_X, at + LOBE_Y, found)
    gathered(ndf, lobes[1], b, at + LOBE_INDEX, found)
    for i in range(CHUNK):
        b[(at + LOBE) * CHUNK + i] = blended(b, found, at + LOBE_X, at + LOBE_Y, i)
    unwarped(warp, along, columns, b, u, v, at)
    cornered(b, at + S, at + T, shape[0], shape[1], at + INDEX, at + X, at + Y, at + ROW)
    gathered(data, shape[1], b, at + INDEX, found)
    for i in range(CHUNK):
        b[(at + VALUE) * CHUNK + i] = blended(b, found, at + X, at + Y, i)


@part
def unwarped(
    warp: FloatArray, along: FloatArray, columns: int, b: FloatArray, u: int, v: int, at: int
) -> None:
    """As :meth:`fitter.sampling.warp.Warp.inverse_of_one`, of points in the rows ``u`` and ``v``, into rows
    ``S`` and ``T`` from ``at`` on."""
    height, found = len(along) >> 1, at + FOUND
    cornered(b, u, v, height, columns, at + INDEX, at + X, at + Y, at + ROW)
    below = np.uint64(2 * columns)
    for i in range(CHUNK):
        a = np.uint64(2 * np.int64(b[(at + INDEX) * CHUNK + i]))
        row = np.uint64(2 * np.int64(b[(at + ROW) * CHUNK + i]))
        b[found * CHUNK + i], b[(found + 1) * CHUNK + i] = warp[a], warp[a + _ONE]
        b[(found + 2) * CHUNK + i], b[(found + 3) * CHUNK + i] = warp[a + _TWO], warp[a + below]
        b[(found + 4) * CHUNK + i] = warp[a + below + _ONE]
        b[(found + 5) * CHUNK + i] = warp[a + below + _TWO]
        b[(found + 6) * CHUNK + i], b[(found + 7) * CHUNK + i] = along[row], along[row + _ONE]
        b[(found + 8) * CHUNK + i] = along[row + _TWO]
    wide, tall = 1 / (columns - 1), 1 / (height - 1)
    for i in range(CHUNK):
        x, y = b[(at + X) * CHUNK + i], b[(at + Y) * CHUNK + i]
        p, q = b[found * CHUNK + i], b[(found + 3) * CHUNK + i]
        inside = x * wide
        low = b[(found + 1) * CHUNK + i] + (p + 0.5 * (b[(found + 2) * CHUNK + i] - p) * x) * inside
        high = b[(found + 4) * CHUNK + i] + (q + 0.5 * (b[(found + 5) * CHUNK + i] - q) * x) * inside
        low_row, high_row = b[(found + 6) * CHUNK + i], b[(found + 8) * CHUNK + i]
        t = b[(found + 7) * CHUNK + i] + (low_row + 0.5 * (high_row - low_row) * y) * y * tall
        mix = y if (1 - y) * low_row + y * high_row > 0 else 0.5
        whole = (1 - mix) * low_row + mix * high_row
        # Rows without density have no conditional distribution: nothing is ever mapped there.
        s = ((1 - mix) * low + mix * high) / (whole if whole > 0 else 1.0)
        b[(at + S) * CHUNK + i] = min(max(s if whole > 0 else 0.0, 0.0), 1.0)
        b[(at + T) * CHUNK + i] = min(max(t, 0.0), 1.0)


@compiled
def fill(
    share: FloatArray,
    alias: NDArray[np.int32],
    cells: FloatArray,
    warp: FloatArray,
    along: FloatArray,
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
    integral: float,
    state: NDArray[np.uint64],
    every: bool,
    wo: FloatArray,
    pdf: FloatArray,
    weight: FloatArray,
    budget: int,
) -> tuple[int, int]:
    """Draws into ``wo`` (n, 3), ``pdf`` (n,) and ``weight`` (n, C) from at most ``budget`` candidates.

    cells : (K, 8) u and its width, v and its height, majorant, cosine and sine of the middle of the half
    vectors' azimuths, nothing. warp, along, columns : as :attr:`fitter.sampling.warp.Warp.packed` has them.
    data, ndf : images, flat, channels (H W C,), whose product times ``factor`` is f+, or f+ cos(theta_o)
    where ``cosined``. wi : on the stored copy of the surface; sign : what takes a component back to the
    sample. every : keep rejected candidates, too, with a pdf of -1.

    Returns how many candidates were tried, -1 where one exceeded its bound, and how many draws were made.
    """
    over = 1.0 / integral
    width = shape[1]
    bits = np.empty(_ROWS * CHUNK, np.uint64)
    b = bits.view(np.float64)
    items, taken = np.empty(CHUNK, np.int64), np.empty(CHUNK + 1, np.int64)
    tried = filled = 0
    while filled < len(pdf) and tried < budget:
        m = min(CHUNK, budget - tried)
        proposed(state, share, alias, bits, b, items)
        for i in range(CHUNK):
            item = np.uint64(items[i])
            b[_U * CHUNK + i], b[_WIDTH * CHUNK + i] = cells[item, 0], cells[item, 1]
            b[_V * CHUNK + i], b[_HEIGHT * CHUNK + i] = cells[item, 2], cells[item, 3]
            b[_MAJORANT * CHUNK + i], b[_COSINE * CHUNK + i] = cells[item, 4], cells[item, 5]
            b[_SINE * CHUNK + i] = cells[item, 6]
        for i in range(CHUNK):
            u = b[_U * CHUNK + i] + b[U * CHUNK + i] * b[_WIDTH * CHUNK + i]
            v = b[_V * CHUNK + i] + b[V * CHUNK + i] * b[_HEIGHT * CHUNK + i]
            cos_m, sin_m = cosine_and_sine(u * u * (np.pi / 2))
            d = (2 * b[V * CHUNK + i] - 1) * (np.pi * b[_HEIGHT * CHUNK + i])
            c, s = short_cosine(d), short_sine(d)
            x = sin_m * (b[_COSINE * CHUNK + i] * c - b[_SINE * CHUNK + i] * s)
            y = sin_m * (b[_SINE * CHUNK + i] * c + b[_COSINE * CHUNK + i] * s)
            along_m = x * wi[0] + y * wi[1] + cos_m * wi[2]
            b[U * CHUNK + i], b[V * CHUNK + i] = u, v
            b[_OUT * CHUNK + i] = (2 * along_m * x - wi[0]) * sign[0]
            b[(_OUT + 1) * CHUNK + i] = (2 * along_m * y - wi[1]) * sign[1]
            b[(_OUT + 2) * CHUNK + i] = 2 * along_m * cos_m - wi[2]
            # Per unit of the chart's measure; nothing below the horizon.
            b[_FACTOR * CHUNK + i] = (8 * np.pi**2) * along_m * u * sin_m if along_m > 0 else 0.0
        looked_up(warp, along, columns, data, shape, ndf, lobes, b, U, V, _AT)
        for i in range(CHUNK):
            z, majorant = b[(_OUT + 2) * CHUNK + i], b[_MAJORANT * CHUNK + i]
            up = z > 0
            lobe = b[(_AT + LOBE) * CHUNK + i] * factor
            lobe = lobe / (z if up else 1.0) if cosined else lobe
            value = b[(_AT + VALUE) * CHUNK + i] * lobe
            field = value * z * b[_FACTOR * CHUNK + i] if up else 0.0
            # False where it is NaN: not measured there.
            found = value * z * over if b[CHANCE * CHUNK + i] * majorant < field else REJECTED
            b[(_OUT + 3) * CHUNK + i] = ABOVE if field > majorant else found
            b[(_AT + LOBE) * CHUNK + i], b[(_AT + VALUE) * CHUNK + i] = lobe, value
        before = filled
        used, filled = collected(b, _OUT, m, every, wo, pdf, taken, filled)
        if used < 0:
            return -1, filled
        tried += used
        if weight.shape[1]:
            for k in range(before, filled):
                i = int(taken[k - before])
                a = np.uint64(np.int64(b[(_AT + INDEX) * CHUNK + i]))
                x, y = b[(_AT + X) * CHUNK + i], b[(_AT + Y) * CHUNK + i]
                # f cos / pdf = f / f+ x integral: the cosine cancels, so this stays exact at the horizon.
                mine = b[(_AT + LOBE) * CHUNK + i] * integral / b[(_AT + VALUE) * CHUNK + i]
                count = np.uint64(weight.shape[1])
                beside, below = a * count, (a + np.uint64(width)) * count
                for c in range(count):
                    p, q = channels[beside + c], channels[below + c]
                    low = p + x * (channels[beside + count + c] - p)
                    high = q + x * (channels[below + count + c] - q)
                    weight[k, c] = (low + y * (high - low)) * mine
    return tried, filled
