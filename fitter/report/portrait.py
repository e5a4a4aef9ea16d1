"""The portrait of a measured table: what its picture shows, as arrays. Nothing is fitted or filled in.

Slices through the plane of incidence, the scattered hemisphere at some incidences, and which polar angles
were measured at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.quality.checks import SEED
from fitter.quality.hemispheres import Hemisphere, hemispheres, of_scan
from fitter.quality.measured import AT_NORMAL, Measured, turned
from fitter.report.plane import incidence_groups, near_plane, one_azimuth, signed_theta, spread
from fitter.sampling.grid import GridInterpolant
from fitter.table import Table

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: Hemispheres that are shown.
MOST_DISKS = 3
#: Samples of a slice that lie within this of each other (degrees) are one point of its line.
BIN_DEG = 0.5
#: Steps of the raster that a grid's hemisphere is drawn with (degrees).
RASTER_DEG = 2.0
#: Width of the cells that polar angles of scattered samples are counted in (degrees).
CELL_DEG = 3.0


@dataclass(frozen=True)
class Cut:
    """In-plane samples at one incidence: theta_o (n,) in degrees, increasing, positive on the specular side.

    channels : (n, C) values in 1/sr.
    """

    theta_i_deg: float
    theta_o_deg: FloatArray
    channels: FloatArray

    @property
    def value(self) -> FloatArray:
        """(n,) mean of the channels, 1/sr."""
        return np.asarray(self.channels.mean(axis=1))


@dataclass(frozen=True)
class Disk:
    """The scattered hemisphere at one incidence; ``phi_i_deg`` is None on an isotropic surface.

    theta_o_deg, turn : (n,) polar angles, and azimuths from that of the light (radians). value : (n,) mean of
    the channels in 1/sr. mirrored : (n,) whether the point is the mirror image of a sample, which stands for
    it on an isotropic surface. masked : (m, 2) theta_o in degrees and turn of samples that are not usable;
    blind : (b, 2) the same of directions within the measured region that no usable sample covers.
    raster : whether the points are the grid's function on a raster, theta_o before turn and NaN where it was
    not measured, and not samples.
    """

    theta_i_deg: float
    phi_i_deg: float | None
    theta_o_deg: FloatArray
    turn: FloatArray
    value: FloatArray
    mirrored: BoolArray
    masked: FloatArray
    blind: FloatArray
    blind_share: float | None
    raster: bool


@dataclass(frozen=True)
class Portrait:
    """What is drawn of a table.

    plane_deg : how far from the plane of incidence the samples of a slice lie at most. azimuth_deg : the
    incident azimuth of the slices, None for an isotropic table. counts : (k, k) usable samples in cells of
    theta_i (rows) and theta_o, masked : the same of the others; edges_deg : of both. blind_share : of all
    incidences looked at, None where the samples cover no area. looked_at : samples behind the counts.
    """

    table: Table
    cuts: tuple[Cut, ...]
    plane_deg: float
    azimuth_deg: float | None
    disks: tuple[Disk, ...]
    edges_deg: tuple[FloatArray, FloatArray]
    counts: NDArray[np.int64]
    masked: NDArray[np.int64]
    blind_share: float | None
    looked_at: int


def portrait(table: Table, *, seed: int = SEED) -> Portrait:
    """What the picture of a table shows. ``seed`` draws the cells that are counted of a large grid."""
    with np.errstate(over="ignore", under="ignore"):
        usable = Measured.of(table, seed, usable=True)
        found, plane_deg, azimuth = cuts(table)
        areas = hemispheres(usable)
        shares = [one.blind for one in areas if one.kind == "area"]
        edges, counts, masked = covered(table, usable, seed)
        return Portrait(
            table, found, plane_deg, azimuth, _disks(usable, areas, azimuth), edges, counts, masked,
            float(np.mean(shares)) if shares else None, len(usable.rows),
        )  # fmt: skip


def cuts(table: Table) -> tuple[tuple[Cut, ...], float, float | None]:
    """In-plane samples of up to six incidences; ``plane_deg`` and ``azimuth_deg`` of :class:`Portrait`."""
    index, tolerance = near_plane(table, np.flatnonzero(table.mask))
    if not len(index):
        return (), tolerance, None
    wi, wo = table.directions(index)
    index, wi, wo, azimuth = one_azimuth(table, index, wi, wo)
    theta_i = np.rad2deg(directions.spherical_from_vector(wi)[0])
    signed = np.rad2deg(signed_theta(wi, wo))
    value = table.value[index]
    found: list[Cut] = []
    for group in incidence_groups(theta_i):
        cell = np.round(signed[group] / BIN_DEG).astype(np.int64)
        _, inverse = np.unique(cell, return_inverse=True)
        size = np.bincount(inverse)
        at, *level = (
            np.bincount(inverse, column) / size for column in (signed[group], *value[group].T)
        )  # fmt: skip
        found.append(Cut(float(np.median(theta_i[group])), at, np.stack(level, axis=1)))
    return tuple(found), tolerance, azimuth


def covered(
    table: Table, usable: Measured, seed: int
) -> tuple[tuple[FloatArray, FloatArray], NDArray[np.int64], NDArray[np.int64]]:
    """Edges in degrees, and samples in each cell of theta_i and theta_o: the usable ones, and the others."""
    edges = _edges(table, "theta_i"), _edges(table, "theta_o")
    others = np.flatnonzero(~table.mask)
    if len(others) > len(usable.rows):
        others = np.sort(np.random.default_rng(seed).choice(others, len(usable.rows), replace=False))
    counted: list[NDArray[np.int64]] = []
    for wi, wo in ((usable.wi, usable.wo), table.directions(others)):
        # A direction measured at 30 deg belongs to the cell that begins there, whatever its last digit.
        theta = [np.rad2deg(directions.spherical_from_vector(w)[0]) + 1e-6 for w in (wi, wo)]
        counted.append(np.histogram2d(theta[0], theta[1], bins=edges)[0].astype(np.int64))
    return edges, counted[0], counted[1]


def _edges(table: Table, name: str) -> FloatArray:
    """Cells of a polar angle: of even width, or around the nodes of a grid that has such an axis."""
    axis = None if table.grid is None else table.grid.axes.get(name)
    if axis is None or len(axis) < 2:
        return np.arange(0.0, 90.0 + CELL_DEG, CELL_DEG)
    nodes = np.rad2deg(axis)
    between = 0.5 * (nodes[1:] + nodes[:-1])
    first, last = max(2 * nodes[0] - between[0], 0.0), min(2 * nodes[-1] - between[-1], 90.0)
    return np.concatenate([[min(first, between[0] - 1e-3)], between, [max(last, between[-1] + 1e-3)]])


def _disks(usable: Measured, areas: Sequence[Hemisphere], azimuth: float | None) -> tuple[Disk, ...]:
    table = usable.table
    if table.domain.in_plane:
        return ()
    if table.grid is not None:
        shown = [one for one in areas if one.kind == "area"]
        chosen = [shown[k] for k in _middle(len(shown), MOST_DISKS)]
        interpolant = GridInterpolant(table.grid, table.value.mean(axis=1)[:, None], table.mask)
        return tuple(_raster(interpolant, one) for one in chosen)
    wi, _ = usable.turned
    scans = sorted(usable.scans, key=lambda scan: -float(wi[scan[0], 2]))
    if azimuth is not None:  # those of the slices, where there are any
        phi = [np.rad2deg(directions.spherical_from_vector(wi[scan[0]])[1]) for scan in scans]
        same = [scan for scan, a in zip(scans, phi, strict=True) if abs((a - azimuth + 180) % 360 - 180) < 1]
        scans = same or scans
    return tuple(_samples(usable, scans[k]) for k in _middle(len(scans), MOST_DISKS))


def _middle(count: int, most: int) -> tuple[int, ...]:
    """At most ``most`` of ``count`` positions, in the middle of equal shares where there are more."""
    if count <= most:
        return spread(count, most)
    return tuple(int((k + 0.5) / most * count) for k in range(most))


def _raster(interpolant: GridInterpolant, one: Hemisphere) -> Disk:
    """The grid's function at nodes of a polar raster."""
    theta = np.arange(RASTER_DEG / 2, 90.0, RASTER_DEG)
    turn = np.arange(0.0, 360.0, 2 * RASTER_DEG)
    mesh = np.meshgrid(theta, np.deg2rad(turn), indexing="ij")
    theta_o, azimuth = mesh[0].reshape(-1), mesh[1].reshape(-1)
    wo = directions.vector_from_spherical(np.deg2rad(theta_o), azimuth + one.phi_i)
    value, outside = interpolant.evaluate(one.wi[None, :], wo)
    symmetric = interpolant.grid.system != "spherical"
    return Disk(
        float(np.rad2deg(one.theta_i)), None if symmetric else float(np.rad2deg(one.phi_i)),
        theta_o, azimuth, np.where(outside, np.nan, value[:, 0]), np.zeros(len(theta_o), bool),
        np.empty((0, 2)), _polar(one.blind_at, one.wi), one.blind, True,
    )  # fmt: skip


def _samples(usable: Measured, scan: NDArray[np.intp]) -> Disk:
    wi, wo = usable.turned
    middle = wi[scan].mean(axis=0)
    middle /= np.linalg.norm(middle)
    tilted = bool(np.hypot(*middle[:2]) > AT_NORMAL)
    # At normal incidence there is no plane to turn to: the directions are shown as they were measured.
    at = _polar((wo if tilted else usable.wo)[scan], middle)
    value = usable.value[scan].mean(axis=1)
    mirrored = np.zeros(len(at), bool)
    if usable.isotropic and tilted:
        aside = np.abs(np.sin(at[:, 1])) > 1e-3
        at = np.concatenate([at, at[aside] * np.array([1.0, -1.0])])
        value = np.concatenate([value, value[aside]])
        mirrored = np.concatenate([mirrored, np.ones(int(aside.sum()), bool)])
    theta_i, phi_i = directions.spherical_from_vector(middle)
    one = of_scan(usable, scan)
    return Disk(
        float(np.rad2deg(theta_i)), None if usable.isotropic else float(np.rad2deg(phi_i)),
        at[:, 0], at[:, 1], value, mirrored, _masked(usable, middle), _polar(one.blind_at, middle),
        one.blind if one.kind == "area" else None, False,
    )  # fmt: skip


def _masked(usable: Measured, wi: FloatArray) -> FloatArray:
    """Masked samples of the incidence ``wi`` that have a direction above the horizon."""
    table = usable.table
    rows = np.flatnonzero(~table.mask & ~table.repeats)
    at_i, at_o = table.directions(rows)
    above = (at_i[:, 2] > 0) & (at_o[:, 2] > 0)  # False where a component is not finite
    at_i, at_o = at_i[above], at_o[above]
    if usable.isotropic:
        at_i, at_o = turned(at_i, at_o)
    here = np.arccos(np.clip(at_i @ wi, -1.0, 1.0)) < np.deg2rad(0.5)
    return _polar(at_o[here], wi)


def _polar(wo: FloatArray, wi: FloatArray) -> FloatArray:
    """(n, 2) polar angle in degrees, and azimuth from that of ``wi`` (radians)."""
    theta, phi = directions.spherical_from_vector(wo)
    _, phi_i = directions.spherical_from_vector(wi)
    return np.stack([np.rad2deg(theta), phi - phi_i], axis=1)
