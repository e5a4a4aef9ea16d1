"""What linear interpolation adds to an integral, estimated from how the values bend.

Between nodes a linear interpolant lies above a convex function and below a concave one. To second order the
integral gains h^2/12 times the integral of f'' along each axis of a grid, which the nodes tell: a sixth of
the sum of (what the two nodes beside say a node should be, less what it is) times what the integral depends
on it. On a triangle of area A it gains A/24 times the sum over its sides e of e . H e, H the second
derivatives.

Good where lobes are resolved; where an error of a tenth or more is stated it is only large.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.sampling.axes import Axis
from fitter.sampling.warp import Corner

FloatArray = NDArray[np.float64]


def bent(value: FloatArray, axis: Axis, along: int) -> FloatArray:
    """What neighbours along one axis of a grid say of each node, less its value; 0 at ends and beside NaN."""
    n = len(axis.nodes)
    if n < 3:
        return np.zeros_like(value)
    value = np.moveaxis(value, along, -1)
    before, after = np.roll(value, 1, axis=-1), np.roll(value, -1, axis=-1)
    step = np.diff(axis.nodes, append=axis.nodes[0] + (axis.period or 0.0))
    share = np.roll(step, 1) / (np.roll(step, 1) + step)
    found = before + share * (after - before) - value
    if axis.period is None:
        found[..., [0, -1]] = 0.0
    return np.moveaxis(np.nan_to_num(found, nan=0.0), -1, along)


def gain(value: FloatArray, axes: tuple[Axis, ...], depends: FloatArray) -> float:
    """Of the integral that depends on the nodes' values by ``depends``, both shaped as the axes."""
    return sum(float((depends * bent(value, axis, k)).sum()) for k, axis in enumerate(axes)) / 6


def gain_of_image(image: FloatArray, at: Corner, weight: FloatArray) -> float:
    """:func:`gain` of a bilinear image (H, W) on the unit square, looked up at points with these weights."""
    height, width = image.shape
    index = at.j * width + at.i
    depends = np.zeros(height * width)
    for j, y in ((0, 1 - at.y), (width, at.y)):
        for i, x in ((0, 1 - at.x), (1, at.x)):
            depends += np.bincount(index + (i + j), weight * x * y, len(depends))
    axes = tuple(Axis(name, np.linspace(0, 1, n), None) for name, n in zip("yx", image.shape, strict=True))
    return gain(image, axes, depends.reshape(image.shape))


def gain_of_triangles(points: FloatArray, value: FloatArray, triangles: NDArray[np.integer[Any]]) -> float:
    """Of values (n,) at points (n, 2), linear on triangles (T, 3).

    Second derivatives along a side from the nodes' gradients: the mean of those of the triangles around.
    """
    p, v = points[triangles], value[triangles]
    e, f = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    twice = e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]
    keep = np.abs(twice) > 1e-14
    triangles = triangles[keep]
    p, v, e, f, twice = (x[keep] for x in (p, v, e, f, twice))
    a, b = v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]
    slope = np.stack([a * f[:, 1] - b * e[:, 1], b * e[:, 0] - a * f[:, 0]], axis=1) / twice[:, None]
    area = 0.5 * np.abs(twice)
    whole = np.bincount(triangles.reshape(-1), np.repeat(area, 3), len(points))
    gradient = (
        np.stack(
            [np.bincount(triangles.reshape(-1), np.repeat(area * s, 3), len(points)) for s in slope.T], axis=1
        )
        / np.where(whole > 0, whole, 1.0)[:, None]
    )
    g = gradient[triangles]
    sides = sum(((p[:, (k + 1) % 3] - p[:, k]) * (g[:, (k + 1) % 3] - g[:, k])).sum(axis=1) for k in range(3))
    return float((area * sides).sum() / 24)
