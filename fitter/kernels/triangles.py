"""Draws from linear densities on triangles of the projected disk, see :mod:`fitter.sampling.triangles`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled, part
from fitter.kernels.candidates import ABOVE, CHANCE, CHUNK, OWN, REJECTED, U, V, collected, proposed

FloatArray = NDArray[np.float64]

# Rows of a chunk: the largest corner, the density, the direction and pdf.
_MOST, _DENSITY, _OUT = OWN, OWN + 1, OWN + 2
_ROWS = _OUT + 4


@part
def placed(item: int, count: int, each: int) -> tuple[np.uint64, np.uint64, np.uint64]:
    """Where the corners of an item's triangle begin, the item's own first, in a flat array of ``count``
    triangles and ``each`` numbers a corner. No branches: which corner it is can't be foreseen."""
    corner = np.int64(item >= count) + np.int64(item >= 2 * count)
    start = (item - corner * count) * 3
    second = corner + 1 - 3 * (corner >> 1)
    return (
        np.uint64((start + corner) * each),
        np.uint64((start + second) * each),
        np.uint64((start + 3 - corner - second) * each),
    )


@compiled
def fill(
    share: FloatArray,
    alias: NDArray[np.int32],
    corners: FloatArray,
    slack: float,
    exact: bool,
    state: NDArray[np.uint64],
    every: bool,
    wo: FloatArray,
    pdf: FloatArray,
    weight: FloatArray,
    budget: int,
) -> tuple[int, int]:
    """Draws into ``wo`` (n, 3), ``pdf`` (n,) and ``weight`` (n, C) from at most ``budget`` candidates.

    corners : (T, 3, 3 + C) x, y, density and channels at the corners of each triangle, in the sample's frame
    and over the integral of the density. exact : by inversion; then every candidate is a draw, and an item is
    a triangle's first corner, or its second one, ..., those of all triangles together; else an item is a
    triangle. slack : what rounding may put the density above its largest corner by, as a factor. every : keep
    rejected candidates, too, with a pdf of -1.

    Returns how many candidates were tried, -1 where one exceeded its bound, and how many draws were made.
    """
    count, each = len(corners), corners.shape[2]
    flat = corners.reshape(-1)
    one, two = np.uint64(1), np.uint64(2)
    bits = np.empty(_ROWS * CHUNK, np.uint64)
    b = bits.view(np.float64)
    chosen, taken = np.empty(CHUNK, np.int64), np.empty(CHUNK + 1, np.int64)
    tried = filled = 0
    while filled < len(pdf) and tried < budget:
        m = min(CHUNK, budget - tried)
        proposed(state, share, alias, bits, b, chosen)
        if exact:
            for i in range(CHUNK):
                u, v, w = b[CHANCE * CHUNK + i], b[V * CHUNK + i], b[U * CHUNK + i]
                low, high = min(v, w), max(v, w)
                # Spacings of three ordered uniform numbers are Dirichlet(1, 1, 1, 1); two added: (2, 1, 1).
                top = max(high, u)
                b[U * CHUNK + i], b[V * CHUNK + i] = top - max(low, min(high, u)), 1.0 - top
        else:
            for i in range(CHUNK):
                v, w = b[V * CHUNK + i], b[U * CHUNK + i]
                b[U * CHUNK + i], b[V * CHUNK + i] = max(v, w) - min(v, w), 1.0 - max(v, w)
        for i in range(CHUNK):
            p, q, r = placed(chosen[i], count, each)
            second, third = b[U * CHUNK + i], b[V * CHUNK + i]
            first = 1.0 - second - third
            b[_OUT * CHUNK + i] = first * flat[p] + second * flat[q] + third * flat[r]
            b[(_OUT + 1) * CHUNK + i] = first * flat[p + one] + second * flat[q + one] + third * flat[r + one]
            f, g, h = flat[p + two], flat[q + two], flat[r + two]
            b[_DENSITY * CHUNK + i] = first * f + second * g + third * h
            b[_MOST * CHUNK + i] = max(f, max(g, h))
        for i in range(CHUNK):
            x, y, density = b[_OUT * CHUNK + i], b[(_OUT + 1) * CHUNK + i], b[_DENSITY * CHUNK + i]
            bound = b[_MOST * CHUNK + i] * slack
            # Rounding may put a draw from a sliver at the rim outside the disk, by a part in 1e16.
            z = np.sqrt(max((1.0 - x) * (1.0 + x) - y * y, 0.0))
            found = density * z if exact or b[CHANCE * CHUNK + i] * bound < density else REJECTED
            b[(_OUT + 3) * CHUNK + i] = ABOVE if density > bound else found
            b[(_OUT + 2) * CHUNK + i] = z
        before = filled
        used, filled = collected(b, _OUT, m, every or exact, wo, pdf, taken, filled)
        if used < 0:
            return -1, filled
        tried += used
        if weight.shape[1]:
            for k in range(before, filled):
                i = int(taken[k - before])
                p, q, r = placed(int(chosen[i]), count, each)
                second, third = b[U * CHUNK + i], b[V * CHUNK + i]
                first = 1.0 - second - third
                # f cos / pdf = f / f+ x integral: the cosine cancels, so this stays exact at the horizon.
                factor = 1.0 / b[_DENSITY * CHUNK + i]
                for c in range(np.uint64(3), np.uint64(3 + weight.shape[1])):
                    value = first * flat[p + c] + second * flat[q + c] + third * flat[r + c]
                    weight[k, c - np.uint64(3)] = value * factor
    return tried, filled
