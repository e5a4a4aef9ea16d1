"""Tables on grids inside kernels: where on an axis a coordinate lies, and half and difference angles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import part
from fitter.kernels.angles import arc

FloatArray = NDArray[np.float64]


@part
def located(
    nodes: FloatArray,
    first: NDArray[np.int64],
    about: FloatArray,
    axis: int,
    x: FloatArray,
    start: int,
    low: NDArray[np.int64],
    step: NDArray[np.int64],
    at: int,
    m: int,
    measured: int,
) -> None:
    """Coordinates ``x[start:start + m]`` on one of several axes replaced by fractions between the nodes
    ``low`` and ``low + step``, from ``at`` on; ``x[measured:measured + m]`` set to 0 where that was not
    measured.

    nodes, first, about : as :func:`fitter.sampling.axes.packed` has them.
    """
    n, buckets, scale = np.int64(about[axis, 0]), about[axis, 1], about[axis, 2]
    least, most = about[axis, 3], about[axis, 4]
    origin, closed = nodes[axis, 0], about[axis, 5] > 0
    for i in range(m):
        y = x[start + i]
        if not closed and (y < least or y > most):
            x[measured + i] = 0.0
    if n == 1:
        for i in range(m):
            x[start + i], low[at + i], step[at + i] = 0.0, 0, 0
        return
    if scale > 0:
        for i in range(m):
            bucket = np.int64(min(max((x[start + i] - origin) * scale, 0.0), buckets - 1.0))
            k = first[axis, bucket]
            low[at + i] = k + np.int64(nodes[axis, k + 1] <= x[start + i])
    else:
        for i in range(m):
            k, beyond = 0, n
            while beyond - k > 1:
                middle = (k + beyond) >> 1
                if nodes[axis, middle] <= x[start + i]:
                    k = middle
                else:
                    beyond = middle
            low[at + i] = k
    last = n - 1 if closed else n - 2
    for i in range(m):
        k = min(low[at + i], last)
        t = (x[start + i] - nodes[axis, k]) / (nodes[axis, k + 1] - nodes[axis, k])
        # Beyond an end both corners are the end node, so that its neighbour (masked or not) has no say.
        above, below = np.int64(t >= 1.0), np.int64(t <= 0.0)
        x[start + i] = min(max(t, 0.0), 1.0)
        if closed:
            low[at + i], step[at + i] = k, (1 if k + 1 < n else -k)
        else:
            low[at + i], step[at + i] = k + above, 1 - above - below


@part
def half_difference(
    ix: float, iy: float, iz: float, ox: float, oy: float, oz: float
) -> tuple[float, float, float]:
    """As :func:`fitter.directions.half_difference_from_components`, without phi_h."""
    hx, hy, hz = ix + ox, iy + oy, iz + oz
    flat2 = hx * hx + hy * hy
    flat, length = np.sqrt(flat2), np.sqrt(flat2 + hz * hz)
    dx, dy, dz = 0.5 * (ix - ox), 0.5 * (iy - oy), 0.5 * (iz - oz)
    cos_p, sin_p = (hx / flat, hy / flat) if flat > 0 else (1.0, 0.0)
    cos_h, sin_h = (hz / length, flat / length) if length > 0 else (1.0, 0.0)
    x = cos_h * (cos_p * dx + sin_p * dy) - sin_h * dz
    y = cos_p * dy - sin_p * dx
    return arc(flat, hz), arc(np.sqrt(dx * dx + dy * dy + dz * dz), 0.5 * length), arc(y, x)
