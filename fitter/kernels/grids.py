"""Tables on grids inside kernels: where on an axis a coordinate lies, and half and difference angles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import part
from fitter.kernels.angles import arc

FloatArray = NDArray[np.float64]
#: Of the steps of an even axis: what is this near to a node is at it.
ROUNDING = 1e-11


@part
def located(
    nodes: FloatArray,
    first: NDArray[np.int64],
    about: FloatArray,
    axis: int,
    x: FloatArray,
    start: int,
    measured: int,
    stride: float,
    low: int,
    step: int,
    m: int,
) -> None:
    """Coordinates ``x[start:start + m]`` on one of several axes replaced by fractions between two nodes.

    ``x[low:low + m]`` is increased by ``stride`` times the first of these, ``x[step:step + m]`` set to
    ``stride`` times how much further the other one is, and ``x[measured:measured + m]`` set to 0 where that
    was not measured: indices as floating-point numbers, which vector instructions can multiply. nodes, first,
    about : as :func:`fitter.sampling.axes.packed` has them.
    """
    n, buckets, scale = int(about[axis, 0]), about[axis, 1], about[axis, 2]
    least, most, even = about[axis, 3], about[axis, 4], about[axis, 6]
    origin, closed = nodes[axis, 0], about[axis, 5] > 0
    last = np.float64(n - 1 if closed else n - 2)
    if not closed:
        for i in range(m):
            y = x[start + i]
            x[measured + i] = 0.0 if y < least or y > most else x[measured + i]
    if n == 1:
        for i in range(m):
            x[start + i], x[step + i] = 0.0, 0.0
        return
    if even > 0:
        # Neither search nor division.
        for i in range(m):
            at = (x[start + i] - origin) * even
            # A node is at itself, not short of it by rounding: its neighbour has no say there, masked or not.
            whole = np.floor(at + 0.5)
            at = whole if abs(at - whole) < ROUNDING else at
            node = min(max(np.floor(at), 0.0), last)
            x[start + i], x[step + i] = at - node, node
    else:
        for i in range(m):
            y = x[start + i]
            if scale > 0:
                bucket = np.int64(min(max((y - origin) * scale, 0.0), buckets - 1.0))
                k = first[axis, np.uint64(bucket)]
                k += np.int64(nodes[axis, np.uint64(k + 1)] <= y)
            else:
                k = bisected(nodes, axis, n, y)
            k = np.uint64(min(k, np.int64(last)))
            below = nodes[axis, k]
            x[start + i] = (y - below) / (nodes[axis, k + np.uint64(1)] - below)
            x[step + i] = np.float64(np.int64(k))
    for i in range(m):
        k, t = x[step + i], x[start + i]
        x[start + i] = min(max(t, 0.0), 1.0)
        if closed:
            x[low + i] += k * stride
            x[step + i] = stride if k < last else -last * stride
        else:
            # Beyond an end both corners are the end node, so that its neighbour (masked or not) has no say.
            beyond = t >= 1.0
            x[low + i] += (k + 1.0 if beyond else k) * stride
            x[step + i] = 0.0 if beyond or t <= 0.0 else stride


@part
def bisected(nodes: FloatArray, axis: int, n: int, y: float) -> int:
    """The last of ``n`` nodes at or below y, 0 before the first."""
    k, beyond = 0, n
    while beyond - k > 1:
        middle = (k + beyond) >> 1
        if nodes[axis, middle] <= y:
            k = middle
        else:
            beyond = middle
    return k


@part
def half_difference(
    ix: float, iz: float, ox: float, oy: float, oz: float
) -> tuple[float, float, float]:
    """theta_h, theta_d and phi_d of :func:`fitter.directions.half_difference_from_components`, for wi at
    azimuth 0.

    Sum and difference of unit vectors are orthogonal: with h = wi + wo and d = (wi - wo)/2 the components of
    d about h are, over the same length, -d_z |h| and, across, h_x d_y - h_y d_x = -i_x o_y.
    """
    hx, hz = ix + ox, iz + oz
    flat2 = hx * hx + oy * oy
    length = np.sqrt(flat2 + hz * hz)
    dx, dz = 0.5 * (ix - ox), 0.5 * (iz - oz)
    # With both at the normal, or opposite on the horizon, h has no azimuth, and counts as at 0.
    level = flat2 > 0
    x = -dz * length if level else dx
    across = np.sqrt(dx * dx + 0.25 * (oy * oy) + dz * dz)
    return arc(np.sqrt(flat2), hz), arc(across, 0.5 * length), arc(-ix * oy, x)
