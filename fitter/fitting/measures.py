"""How much of the space of directions a sample stands for, so that a table's spacing does not decide a fit.

The measure is that of pairs of directions, d omega_i d omega_o (the cosine that a metric may have is the
metric's). On a grid a sample has its cell, from midpoint to midpoint of the axes and at the ends half a
spacing on, as far as the hemisphere goes:

    in/out            sin theta_i dtheta_i [dphi_i] sin theta_o dtheta_o dphi
    half/difference   4 cos theta_d sin theta_h dtheta_h sin theta_d dtheta_d dphi_d

(d omega_o = 4 cos theta_d d omega_h for a given wi.) Scattered samples have to lie in scans, several viewing
directions for each incidence: a sample has its share of its scan, the area of its Voronoi cell on the
hemisphere or, in plane, its arc; and the scan has that of its incidence, by polar angle where the table is
isotropic and by Voronoi cells otherwise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.errors import SpecError
from fitter.grid import Grid
from fitter.table import Table

FloatArray = NDArray[np.float64]
HALF_PI = 0.5 * np.pi
#: Directions whose components agree to this are one incidence.
SAME = 1e-4
#: Samples a scan has on average, at least.
SCAN = 4.0
#: How far out of the plane of a scan counts as in it.
IN_PLANE = 1e-3
#: A cell at the edge of what was measured is no larger than a disc through its k-th neighbour.
NEIGHBOURS = 4


def measures(table: Table, used: NDArray[np.bool_]) -> FloatArray:
    """(N,) the measures of the samples ``used`` (N,), in proportion: their mean is 1. 0 for the others.

    Raises SpecError where scattered samples lie in no scans.
    """
    if table.grid is not None:
        found = _grid(table.grid)
        found *= used
    else:
        wi, wo = table.directions(np.flatnonzero(used))
        found = np.zeros(len(used))
        found[used] = _scattered(wi, wo, table.symmetry == "anisotropic")
    found *= np.count_nonzero(used) / found.sum()
    return found


def _grid(grid: Grid) -> FloatArray:
    total = np.ones(())
    for name, axis in grid.axes.items():
        if name.startswith("theta"):
            low, high = _cells(axis, 0.0, HALF_PI)
            # The integral of sin, or of 4 cos sin.
            weight = np.cos(low) - np.cos(high)
            if name == "theta_d":
                weight = 2.0 * (np.sin(high) ** 2 - np.sin(low) ** 2)
        else:
            weight = _azimuths(axis, grid.periodic.get(name))
        total = np.multiply.outer(total, weight)
    return total.reshape(-1)


def _cells(axis: FloatArray, least: float, most: float) -> tuple[FloatArray, FloatArray]:
    """Both ends of the cell of each node."""
    if len(axis) == 1:
        return np.array([least]), np.array([most])
    middle = 0.5 * (axis[1:] + axis[:-1])
    first, last = axis[0] - (middle[0] - axis[0]), axis[-1] + (axis[-1] - middle[-1])
    edges = np.clip(np.concatenate([[first], middle, [last]]), least, most)
    return edges[:-1], edges[1:]


def _azimuths(axis: FloatArray, period: float | None) -> FloatArray:
    """What each node of an azimuth axis stands for. One that does not close ends on mirror planes."""
    if len(axis) == 1:
        return np.ones(1)
    if period is None:
        low, high = _cells(axis, float(axis[0]), float(axis[-1]))
        return high - low
    ahead = np.append(np.diff(axis), axis[0] + period - axis[-1])
    return 0.5 * (ahead + np.roll(ahead, 1))


def _scattered(wi: FloatArray, wo: FloatArray, anisotropic: bool) -> FloatArray:
    key = np.round((wi if anisotropic else wi[:, 2:]) / SAME).astype(np.int64)
    _, first, scan = np.unique(key, axis=0, return_index=True, return_inverse=True)
    scan = scan.reshape(-1)
    if len(wi) < SCAN * len(first):
        raise SpecError(
            f"{len(wi)} samples of {len(first)} incidences don't say what solid angle each stands for",
            code="no-scans", parameter="weighting",
            cause="scattered samples that lie neither on a grid nor in scans of the viewing direction",
            remedy="use weighting 'samples'",
        )  # fmt: skip
    total = np.empty(len(wi))
    of_scan = _incidences(wi[first], anisotropic)
    order = np.argsort(scan, kind="stable")
    for k, rows in enumerate(np.split(order, np.cumsum(np.bincount(scan))[:-1])):
        own = _scan(wi[rows], wo[rows])
        total[rows] = of_scan[k] * own / own.sum()
    return total


def _incidences(wi: FloatArray, anisotropic: bool) -> FloatArray:
    """(S,) the measure of each scan's incidence."""
    if not anisotropic:
        theta = np.arctan2(np.hypot(wi[:, 0], wi[:, 1]), wi[:, 2])
        order = np.argsort(theta)
        low, high = _cells(theta[order], 0.0, HALF_PI)
        found = np.empty(len(wi))
        found[order] = np.cos(low) - np.cos(high)
        return found
    return _areas(wi)


def _scan(wi: FloatArray, wo: FloatArray) -> FloatArray:
    """(n,) the share of each viewing direction of one scan."""
    if len(wo) == 1:
        return np.ones(1)
    # The plane of incidence; on the normal that of the view furthest from it.
    lean = bool(np.hypot(wi[:, 0], wi[:, 1]).min() > 1e-3)
    across = wi[0] if lean else wo[np.argmin(wo[:, 2])]
    side = np.array([-across[1], across[0]]) / max(np.hypot(across[0], across[1]), 1e-300)
    # Seen from the light: isotropic scans may come with the light at any azimuth.
    turned = wo
    if lean:
        c, s = wi[:, 0], wi[:, 1]
        r = np.hypot(c, s)
        along = (wo[:, 0] * c + wo[:, 1] * s) / r
        off = (wo[:, 1] * c - wo[:, 0] * s) / r
        turned = np.stack([along, off, wo[:, 2]], axis=1)
        side = np.array([0.0, 1.0])
    out = turned[:, :2] @ side
    if np.abs(out).max() > IN_PLANE:
        return _areas(turned)
    within = turned[:, 0] * side[1] - turned[:, 1] * side[0]
    theta = np.arctan2(within, turned[:, 2])
    order = np.argsort(theta)
    low, high = _cells(theta[order], -HALF_PI, HALF_PI)
    found = np.empty(len(wo))
    found[order] = high - low
    return np.maximum(found, 1e-12)


def _areas(w: FloatArray) -> FloatArray:
    """(n,) areas of the Voronoi cells of distinct directions on the hemisphere, which their mirror images in
    the horizon close. Where the samples themselves end, cells are cut to discs."""
    from scipy.spatial import KDTree, SphericalVoronoi  # a tenth of a second, and grids need none of it

    points, place, times = np.unique(np.round(w, 9), axis=0, return_inverse=True, return_counts=True)
    place = place.reshape(-1)
    count = len(points)
    if count < NEIGHBOURS + 1:
        return np.ones(len(w))
    points = points / np.linalg.norm(points, axis=1, keepdims=True)
    above = points[:, 2] > 1e-6
    images = points[above] * [1.0, 1.0, -1.0]
    areas = SphericalVoronoi(np.concatenate([points, images])).calculate_areas()[:count]
    areas = np.where(above, areas, 0.5 * areas)
    distance = KDTree(points).query(points, NEIGHBOURS + 1)[0][:, -1]
    areas = np.minimum(areas, np.pi * np.square(distance))
    return (areas / times)[place]
