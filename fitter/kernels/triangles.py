"""Draws from linear densities on triangles of the projected disk, see :mod:`fitter.sampling.triangles`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled
from fitter.kernels.candidates import ABOVE, CHANCE, CHUNK, REJECTED, U, V, collected, proposed
from fitter.kernels.uniform import left, resumed

FloatArray = NDArray[np.float64]

_X, _Y, _F = 3, 6, 9
_OUT = 12
_ROWS = 16


@compiled
def fill(
    share: FloatArray,
    alias: NDArray[np.int32],
    items: FloatArray,
    slack: float,
    exact: bool,
    turn: tuple[float, float],
    integral: float,
    state: NDArray[np.uint64],
    every: bool,
    wo: FloatArray,
    pdf: FloatArray,
    weight: FloatArray,
    budget: int,
) -> tuple[int, int]:
    """Draws into ``wo`` (n, 3), ``pdf`` (n,) and ``weight`` (n, C) from at most ``budget`` candidates.

    items : (K, 3 (3 + C)) x, y, density and channels of each item, at the first corner and their changes to
    the other two. exact : by inversion; then every candidate is a draw. slack : what rounding may put the
    density above its largest corner by, as a factor. turn : cosine and sine of the slice's azimuth. every :
    keep rejected candidates, too, with a pdf of -1.

    Returns how many candidates were tried, -1 where one exceeded its bound, and how many draws were made.
    """
    r = resumed(state)
    over = 1.0 / integral
    b, chosen, taken = np.empty(_ROWS * CHUNK), np.empty(CHUNK, np.int64), np.empty(CHUNK + 1, np.int64)
    tried = filled = 0
    while filled < len(pdf) and tried < budget:
        m = min(CHUNK, budget - tried)
        r = proposed(r, share, alias, items, 9, chosen, b, m)
        for i in range(m):
            u, v, w = b[V * CHUNK + i], b[CHANCE * CHUNK + i], b[U * CHUNK + i]
            low, high = min(v, w), max(v, w)
            # Spacings of three ordered uniform numbers are Dirichlet(1, 1, 1, 1); two added: (2, 1, 1).
            top = max(high, u) if exact else high
            second, third = top - (max(low, min(high, u)) if exact else low), 1.0 - top
            f, f1, f2 = b[_F * CHUNK + i], b[(_F + 1) * CHUNK + i], b[(_F + 2) * CHUNK + i]
            density = f + second * f1 + third * f2
            bound = max(f, max(f + f1, f + f2)) * slack
            x = b[_X * CHUNK + i] + second * b[(_X + 1) * CHUNK + i] + third * b[(_X + 2) * CHUNK + i]
            y = b[_Y * CHUNK + i] + second * b[(_Y + 1) * CHUNK + i] + third * b[(_Y + 2) * CHUNK + i]
            # Rounding may put a draw from a sliver at the rim outside the disk, by a part in 1e16.
            z = np.sqrt(max((1.0 - x) * (1.0 + x) - y * y, 0.0))
            found = density * z * over if exact or u * bound < density else REJECTED
            b[(_OUT + 3) * CHUNK + i] = ABOVE if density > bound else found
            b[_OUT * CHUNK + i] = turn[0] * x - turn[1] * y
            b[(_OUT + 1) * CHUNK + i] = turn[1] * x + turn[0] * y
            b[(_OUT + 2) * CHUNK + i] = z
            b[U * CHUNK + i], b[V * CHUNK + i], b[CHANCE * CHUNK + i] = second, third, density
        before = filled
        used, filled = collected(b, _OUT, m, every, wo, pdf, taken, filled)
        if used < 0:
            return -1, filled
        tried += used
        if weight.shape[1]:
            for k in range(before, filled):
                i = int(taken[k - before])
                item, second, third = int(chosen[i]), b[U * CHUNK + i], b[V * CHUNK + i]
                # f cos / pdf = f / f+ x integral: the cosine cancels, so this stays exact at the horizon.
                factor = integral / b[CHANCE * CHUNK + i]
                for c in range(weight.shape[1]):
                    j = 9 + 3 * c
                    value = items[item, j] + second * items[item, j + 1] + third * items[item, j + 2]
                    weight[k, c] = value * factor
    left(state, r)
    return tried, filled
