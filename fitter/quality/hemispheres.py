"""Hemispheres: what was measured over the scattered directions at one incidence, and what it integrates to.

The directional-hemispherical reflectance is rho(wi) = integral of f_r cos(theta_o) over the hemisphere. On
the projected disk, whose points are (x, y) of wo, that is the plain integral of f_r over the area: the share
of the disk that was measured is the share of the cosine-weighted hemisphere (F. E. Nicodemus et al. 1977,
"Geometrical considerations and nomenclature for reflectance", NBS Monograph 160).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, KDTree

from fitter import directions
from fitter.grid import Grid
from fitter.quality.measured import Measured
from fitter.sampling.grid import GridInterpolant
from fitter.sampling.scans import FEWEST, Scan

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]

#: So many incidences of a scattered table, and of a grid, are looked at, spread over those measured.
MOST_SCANS, MOST_INCIDENCES = 24, 12
#: Of an incidence so many scattered directions are used, drawn with the seed.
MOST_DIRECTIONS = 10_000
#: Sides of triangles longer than this on the unit disk span what was not measured.
LONG_SIDE = 0.6
#: An empty circle of this radius (radians), and so many times as wide as samples are apart, is a hole.
HOLE, HOLE_OVER_SPACING = float(np.deg2rad(8.0)), 3.5
#: Unmeasured directions get the largest value among so many nearest samples.
_NEAREST = 3
#: Points spread evenly over the disk.
_PROBES = 3000


@dataclass(frozen=True)
class Hemisphere:
    """One incidence.

    kind : "area", "line" (in the plane of incidence only) or "points" (too few directions).
    coverage : measured share of the cosine-weighted hemisphere. lower, upper : (c,) reflectance with
    unmeasured directions counted as 0, and filled with the largest of the nearest measured values;
    least : (c,) the lower one with the smallest corner of every triangle instead of its mean.
    hole : radius (radians) of the largest empty circle inside the measured region, around ``hole_at`` (3,);
    spacing : median distance (radians) to the nearest sample there; blind : cosine-weighted share of that
    region that lies in empty circles so large that they are holes; blind_at : (b, 3) directions there, evenly
    spread over the projected disk.
    """

    wi: FloatArray
    kind: Literal["area", "line", "points"]
    coverage: float
    lower: FloatArray
    upper: FloatArray
    least: FloatArray
    hole: float
    hole_at: FloatArray
    spacing: float
    blind: float
    blind_at: FloatArray

    @classmethod
    def without_area(
        cls, wi: FloatArray, kind: Literal["line", "points"], coverage: float, lower: FloatArray,
        upper: FloatArray,
    ) -> Hemisphere:  # fmt: skip
        """One whose scattered directions cover no area."""
        return cls(wi, kind, coverage, lower, upper, lower, 0.0, wi, np.nan, np.nan, np.empty((0, 3)))

    @property
    def is_hole(self) -> bool:
        """Whether the largest empty circle is a hole, not the usual gap between samples."""
        return self.hole > HOLE and self.hole > HOLE_OVER_SPACING * self.spacing

    @property
    def theta_i(self) -> float:
        return float(directions.spherical_from_vector(self.wi)[0])

    @property
    def phi_i(self) -> float:
        return float(directions.spherical_from_vector(self.wi)[1])


def hemispheres(measured: Measured) -> list[Hemisphere]:
    """Of up to ``MOST_INCIDENCES`` incidences, in order of theta_i."""
    grid = measured.table.grid
    if grid is None:
        return _of_scans(measured)
    part = measured.table.value[:, measured.channels]
    table = GridInterpolant(grid, part, measured.keep)
    return [_of_grid(table, grid, wi) for wi in grid_incidences(measured, grid)]


def grid_incidences(measured: Measured, grid: Grid) -> FloatArray:
    """(k, 3) incidences of a grid to look at."""
    if grid.system == "half_difference":
        theta, _ = directions.spherical_from_vector(measured.wi)
        low, high = np.quantile(theta, [0.01, 0.99])
        chosen = np.arange(0.0, 81.0, 10.0)
        inside = np.deg2rad(chosen[(np.deg2rad(chosen) >= low - 0.02) & (np.deg2rad(chosen) <= high)])
        return directions.vector_from_spherical(inside, 0.0)
    shape = grid.shape
    usable = measured.keep.reshape(shape[0], -1).any(axis=1)
    theta = np.asarray(grid.axes["theta_i"])[usable]
    if grid.system == "spherical_isotropic":
        return directions.vector_from_spherical(_spread(theta, MOST_INCIDENCES), 0.0)
    phi = _spread(np.asarray(grid.axes["phi_i"]), 2)
    theta = _spread(theta, MOST_INCIDENCES // len(phi))
    mesh = np.meshgrid(theta, phi, indexing="ij")
    return directions.vector_from_spherical(mesh[0].reshape(-1), mesh[1].reshape(-1))


def _of_scans(measured: Measured) -> list[Hemisphere]:
    wi, _ = measured.turned
    full = sorted(measured.scans, key=lambda scan: -float(wi[scan[0], 2]))
    chosen = _spread(np.arange(len(full)), MOST_SCANS)
    return [of_scan(measured, full[k]) for k in chosen]


def of_scan(measured: Measured, group: IndexArray) -> Hemisphere:
    """Of the samples at the positions ``group`` of a scattered table, which have an incidence in common."""
    wi, wo = (w[group] for w in measured.turned)
    if len(group) > MOST_DIRECTIONS:
        kept = np.random.default_rng(measured.seed).choice(len(group), MOST_DIRECTIONS, replace=False)
        wi, wo, group = wi[kept], wo[kept], group[kept]
    points, value = wo[:, :2], measured.value[group][:, measured.channels]
    if measured.isotropic:
        # An isotropic surface is mirror-symmetric: what was seen on one side stands for the other.
        points = np.concatenate([points, points * np.array([1.0, -1.0])])
        value = np.concatenate([value, value])
    middle = wi.mean(axis=0)
    middle /= np.linalg.norm(middle)
    scan = Scan.build(middle[:2], points, value)
    nothing = np.full(value.shape[1], np.nan)
    if scan.kind != "area" or len(scan.points) < FEWEST:
        kind = "points" if scan.kind == "area" else scan.kind
        return Hemisphere.without_area(middle, kind, 0.0, nothing, nothing)
    corners = scan.triangulation.simplices
    at = scan.points[corners]
    sides = at - np.roll(at, 1, axis=1)
    cross = (at[:, 1] - at[:, 0])[:, 0] * (at[:, 2] - at[:, 0])[:, 1]
    cross -= (at[:, 1] - at[:, 0])[:, 1] * (at[:, 2] - at[:, 0])[:, 0]
    short = np.hypot(sides[..., 0], sides[..., 1]).max(axis=1) <= LONG_SIDE
    area = np.where(short, 0.5 * np.abs(cross), 0.0)
    lower = area @ scan.value[corners].mean(axis=1)
    least = area @ scan.value[corners].min(axis=1)
    probes = _disk(_PROBES)
    edges = ConvexHull(scan.points).equations
    hull = (probes @ edges[:, :2].T + edges[:, 2] <= 0).all(axis=1)
    inside = hull & ~_within(probes, at[~short])
    tree = KDTree(scan.points)
    _, near = tree.query(probes[~inside], k=_NEAREST)
    missing = max(np.pi - float(area.sum()), 0.0)
    fill = scan.value[np.asarray(near, np.intp)].max(axis=1)
    upper = lower + (missing * fill.mean(axis=0) if len(fill) else 0.0)
    region = _lifted(probes[hull])
    hole, place, spacing, blind = _emptiness(_lifted(scan.points), region)
    coverage, share = min(float(area.sum()) / np.pi, 1.0), len(blind) / len(region)
    return Hemisphere(
        middle, "area", coverage, lower, upper, least, hole, place, spacing, share, blind
    )  # fmt: skip


def _of_grid(table: GridInterpolant, grid: Grid, wi: FloatArray) -> Hemisphere:
    wo, weight = _nodes(grid, wi)
    values, outside = table.evaluate(wi[None, :], wo)
    count = values.shape[1]
    lower = weight[~outside] @ values[~outside]
    upper = lower + weight[outside] @ values[outside]
    coverage = float(weight[~outside].sum() / np.pi)
    if table.in_plane:
        nothing = np.full(count, np.nan)
        return Hemisphere.without_area(wi, "line", 0.0, nothing, nothing)
    probes = _lifted(_disk(_PROBES))
    _, missing = table.evaluate(wi[None, :], probes)
    known = probes[~missing]
    if not len(known):
        return Hemisphere.without_area(wi, "points", coverage, lower, upper)
    # Only what lies nearer to the normal than the measured directions can be a hole in them.
    edge = np.quantile(known[:, 2], 0.01)
    unseen = probes[missing & (probes[:, 2] > edge)]
    spacing = float(np.sqrt(4.0 / _PROBES))
    hole, place, _, blind = _emptiness(known, unseen, spacing)
    share = len(blind) / (len(known) + len(unseen))
    return Hemisphere(wi, "area", coverage, lower, upper, lower, hole, place, spacing, share, blind)


def _nodes(grid: Grid, wi: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Directions (m, 3) and weights (m,) of cos(theta_o) d(omega_o), made for the cells of the grid."""
    if grid.system == "half_difference":
        # d(omega_o) = 4 (wi . h) d(omega_h): nodes where the table has them, whatever the lobe's width.
        theta, across = _gauss(grid.axes["theta_h"], np.pi / 2)
        phi = (np.arange(180) + 0.5) / 180 * 2 * np.pi
        h = directions.vector_from_spherical(theta[:, None], phi[None, :]).reshape(-1, 3)
        cos_d = h @ wi
        wo = 2 * cos_d[:, None] * h - wi
        weight = np.repeat(across * np.sin(theta), len(phi)) * (2 * np.pi / len(phi))
        weight = weight * 4 * cos_d * wo[:, 2]
        up = (cos_d > 0) & (wo[:, 2] > 1e-6)
        return wo[up] / np.linalg.norm(wo[up], axis=1, keepdims=True), weight[up]
    theta, across = _gauss(grid.axes["theta_o"], np.pi / 2)
    name = "dphi" if grid.system == "spherical_isotropic" else "phi_o"
    _, phi_i = directions.spherical_from_vector(wi)
    edges = np.mod(grid.axes[name], 2 * np.pi)
    if name == "dphi":
        edges = np.concatenate([edges, np.mod(-edges, 2 * np.pi)]) + phi_i
    edges = np.unique(np.round(np.mod(edges, 2 * np.pi), 9))
    edges = np.append(edges, edges[0] + 2 * np.pi)
    wide = np.diff(edges)
    pieces = np.maximum(np.ceil(wide / np.deg2rad(10.0)), 1).astype(int)
    edges = np.append(
        np.concatenate([e + w * np.arange(p) / p for e, w, p in zip(edges, wide, pieces, strict=False)]),
        edges[-1],
    )
    phi, width = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    wo = directions.vector_from_spherical(theta[:, None], phi[None, :]).reshape(-1, 3)
    weight = (across * np.sin(theta) * np.cos(theta))[:, None] * width[None, :]
    return wo, weight.reshape(-1)


def _gauss(nodes: FloatArray, end: float) -> tuple[FloatArray, FloatArray]:
    """Two Gauss points in each cell between ``nodes``, from 0 to ``end``: points and weights."""
    edges = np.unique(np.clip(np.concatenate([[0.0], nodes, [end]]), 0.0, end))
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    points = np.stack([middle - half / np.sqrt(3.0), middle + half / np.sqrt(3.0)], axis=1)
    return points.reshape(-1), np.repeat(half, 2)


def _within(points: FloatArray, triangles: FloatArray) -> BoolArray:
    """(m,) whether points (m, 2) lie in any of the triangles (t, 3, 2)."""
    found = np.zeros(len(points), bool)
    for corners in triangles:
        away = corners[None, :, :] - points[:, None, :]
        beside = np.roll(away, -1, axis=1)
        side = away[..., 0] * beside[..., 1] - away[..., 1] * beside[..., 0]
        found |= (side >= 0).all(axis=1) | (side <= 0).all(axis=1)
    return found


def _emptiness(
    samples: FloatArray, probes: FloatArray, spacing: float | None = None
) -> tuple[float, FloatArray, float, FloatArray]:
    """Radius and centre of the emptiest place among ``probes``, the usual distance, and those in holes.

    spacing : usual distance to a sample, by default the median of the probes'.
    """
    if not len(probes):
        return 0.0, samples[0], float("nan"), probes
    found, _ = KDTree(samples).query(probes)
    distance = np.asarray(found)
    angle = 2 * np.arcsin(np.clip(0.5 * distance, 0.0, 1.0))
    at = int(np.argmax(angle))
    spacing = float(np.median(angle)) if spacing is None else spacing
    blind = np.zeros(len(probes), bool)
    tree = KDTree(probes)
    for k in np.flatnonzero(angle > max(HOLE, HOLE_OVER_SPACING * spacing)):
        blind[tree.query_ball_point(probes[k], distance[k])] = True
    return float(angle[at]), probes[at], spacing, probes[blind]


def _disk(count: int) -> FloatArray:
    """(count, 2) points spread evenly over the unit disk, on a spiral of golden angles."""
    k = np.arange(count) + 0.5
    radius, angle = np.sqrt(k / count), k * np.pi * (3.0 - np.sqrt(5.0))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def _lifted(points: FloatArray) -> FloatArray:
    """(n, 3) directions above points (n, 2) of the projected disk."""
    z = np.sqrt(np.maximum(1.0 - (points**2).sum(axis=1), 0.0))
    return np.concatenate([points, z[:, None]], axis=1)


def _spread(items: NDArray[np.generic], most: int) -> NDArray[np.generic]:
    """At most ``most`` of ``items``, evenly, the first and the last among them."""
    if len(items) <= most:
        return items
    return items[np.unique(np.linspace(0, len(items) - 1, most).round().astype(int))]
