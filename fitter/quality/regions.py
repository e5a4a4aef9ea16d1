"""Regions: which directions were measured, and where there are none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.quality.finding import Finding, counted, degrees, not_judged, percent
from fitter.quality.hemispheres import Hemisphere, grid_incidences
from fitter.quality.measured import AT_NORMAL, Measured
from fitter.sampling.grid import GridInterpolant

FloatArray = NDArray[np.float64]

#: A table that ends before this polar angle says nothing of grazing reflectance (radians).
GRAZING = float(np.deg2rad(75.0))
#: No sample within this angle (radians) of a direction: it was not seen.
BLIND = float(np.deg2rad(3.0))
#: Azimuth differences further apart than this (radians) leave a gap.
AZIMUTH_GAP = float(np.deg2rad(50.0))
_RINGS_DEG = (0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0)
_BLIND_INCIDENCES = 24
_IN_SCANS = 0.2


def domain(measured: Measured) -> Finding:
    """Polar and azimuth ranges; whether only the plane of incidence was measured."""
    name = "domain"
    theta_i, phi_i = directions.spherical_from_vector(measured.wi)
    theta_o, phi_o = directions.spherical_from_vector(measured.wo)
    plane = measured.table.domain.in_plane
    tilted = (np.sin(theta_i) > AT_NORMAL) & (np.sin(theta_o) > AT_NORMAL)
    turn = np.abs(np.mod(phi_o - phi_i + np.pi, 2 * np.pi) - np.pi)[tilted]
    marks = np.unique(np.concatenate([[0.0], np.round(turn, 4), [np.pi]]))
    gap_at = int(np.argmax(np.diff(marks)))
    gap = float(marks[gap_at + 1] - marks[gap_at])
    low_i, high_i, low_o, high_o = (float(f(t)) for t in (theta_i, theta_o) for f in (np.min, np.max))
    numbers: dict[str, Any] = {
        "theta_i_deg": [np.rad2deg(low_i), np.rad2deg(high_i)],
        "theta_o_deg": [np.rad2deg(low_o), np.rad2deg(high_o)],
        "incidences": measured.table.domain.incidences, "in_plane": plane,
        "azimuth_gap_deg": [np.rad2deg(marks[gap_at]), np.rad2deg(marks[gap_at + 1])] if len(turn) else None,
        "specular_side": bool((turn > np.pi / 2).any()), "retro_side": bool((turn < np.pi / 2).any()),
    }  # fmt: skip
    sentence = (
        f"Measured for theta_i from {degrees(low_i)} to {degrees(high_i)} and theta_o from {degrees(low_o)} "
        f"to {degrees(high_o)}"
    )
    missing: list[str] = []
    if plane:
        sides = [side for side in ("specular", "retro") if numbers[f"{side}_side"]]
        where = f", on the {sides[0]} side" if len(sides) == 1 else ""
        missing.append(f"in the plane of incidence only{where}")
    elif len(turn) and gap > AZIMUTH_GAP:
        ends = degrees(float(marks[gap_at])), degrees(float(marks[gap_at + 1]))
        missing.append(f"nothing between {ends[0]} and {ends[1]} of azimuth difference")
    if high_i < GRAZING:
        missing.append("no grazing incidence")
    if high_o < GRAZING:
        missing.append("no grazing scatter")
    sentence += f": {', '.join(missing)}." if missing else "."
    return Finding(name, "notice" if missing else "ok", sentence, numbers)


def blind_spots(measured: Measured) -> Finding:
    """Whether the directions towards the light and of mirror reflection were seen."""
    name = "blind_spots"
    pairs = _incidences(measured)
    if not len(pairs):
        return not_judged(
            name, "No incidence away from the normal has several scattered directions: blind spots can't be "
            "looked for.",
        )  # fmt: skip
    rows = [{"theta_i_deg": theta, **_distances(measured, wi, rows)} for theta, wi, rows in pairs]
    retro = [row for row in rows if row["retro_deg"] is None or row["retro_deg"] > np.rad2deg(BLIND)]
    mirror = [row for row in rows if row["mirror_deg"] is None or row["mirror_deg"] > np.rad2deg(BLIND)]
    numbers: dict[str, Any] = {
        "incidences": rows, "blind_to_retro": len(retro), "blind_to_mirror": len(mirror),
        "within_deg": float(np.rad2deg(BLIND)),
    }  # fmt: skip
    seen: list[str] = []
    for missing, what, key in (
        (retro, "direction towards the light", "retro_deg"), (mirror, "mirror direction", "mirror_deg"),
    ):  # fmt: skip
        if 2 * len(missing) > len(rows):
            of = f"{len(missing)} of {counted(len(rows), 'incidence', 'incidences')}"
            near = np.array([row[key] for row in missing], np.float64)  # None is not a number
            near = near[np.isfinite(near)]
            nearest = f" (the nearest typically {np.median(near):.2g}° away)" if len(near) else ""
            seen.append(f"the {what} at {of}{nearest}")
    if not seen:
        sentence = "The directions towards the light and of mirror reflection were measured as a rule."
        return Finding(name, "ok", sentence, numbers)
    sentence = f"Nothing was measured within {degrees(BLIND)} of {' and of '.join(seen)}."
    return Finding(name, "notice", sentence, numbers)


def holes(found: Sequence[Hemisphere]) -> Finding:
    """The largest empty region inside the measured one."""
    name = "holes"
    areas = [one for one in found if one.kind == "area"]
    if not areas:
        return not_judged(
            name, "The scattered directions do not cover an area: holes in it can't be looked for.",
        )  # fmt: skip
    rows = [
        {
            "theta_i_deg": np.rad2deg(one.theta_i), "radius_deg": np.rad2deg(one.hole),
            "spacing_deg": np.rad2deg(one.spacing), "hole": one.is_hole, "blind_share": one.blind,
        }
        for one in areas
    ]  # fmt: skip
    open_ones = [one for one in areas if one.is_hole]
    share = float(np.mean([one.blind for one in areas]))
    numbers: dict[str, Any] = {"incidences": rows, "with_holes": len(open_ones), "blind_share": share}
    if not open_ones:
        return Finding(name, "ok", "There are no holes in the measured region.", numbers)
    worst = max(open_ones, key=lambda one: one.hole)
    theta, phi = directions.spherical_from_vector(worst.hole_at)
    turn = float(np.mod(phi - worst.phi_i + np.pi, 2 * np.pi) - np.pi)
    light = float(np.arccos(np.clip(worst.hole_at @ worst.wi, -1.0, 1.0))) < worst.hole
    numbers["largest"] = {
        "theta_i_deg": np.rad2deg(worst.theta_i), "theta_o_deg": np.rad2deg(float(theta)),
        "dphi_deg": np.rad2deg(turn), "radius_deg": np.rad2deg(worst.hole),
    }  # fmt: skip
    place = f"theta_o = {degrees(float(theta))}, dphi = {degrees(turn)}"
    sentence = (
        f"The measured region has holes at {len(open_ones)} of {len(areas)} incidences looked at, "
        f"{percent(share)} of it (cosine-weighted); the largest is {degrees(worst.hole)} in radius, at "
        f"theta_i = {degrees(worst.theta_i)} around {'the direction towards the light' if light else place}."
    )
    return Finding(name, "notice", sentence, numbers)


def _incidences(measured: Measured) -> list[tuple[float, FloatArray, NDArray[np.intp] | None]]:
    """``(theta_i in degrees, wi, its samples or None for a grid)`` away from the normal."""
    grid = measured.table.grid
    found: list[tuple[float, FloatArray, NDArray[np.intp] | None]] = []
    if grid is not None:
        found = [(0.0, wi, None) for wi in grid_incidences(measured, grid)]
    else:
        full = measured.scans[:_BLIND_INCIDENCES]
        if sum(len(scan) for scan in measured.scans) < _IN_SCANS * len(measured.rows):
            full = []  # hardly two samples have an incidence in common: there are no scans
        found = [(0.0, _middle(measured.turned[0][scan]), scan) for scan in full]
    away = [(wi, group) for _, wi, group in found if np.hypot(wi[0], wi[1]) > np.sin(2 * BLIND)]
    named = [(float(np.rad2deg(np.arctan2(np.hypot(w[0], w[1]), w[2]))), w, group) for w, group in away]
    return sorted(named, key=lambda item: item[0])


def _middle(wi: FloatArray) -> FloatArray:
    mean = wi.mean(axis=0)
    return mean / np.linalg.norm(mean)


def _distances(
    measured: Measured, wi: FloatArray, group: NDArray[np.intp] | None
) -> dict[str, float | None]:
    """Degrees from the directions of retro-reflection and of the mirror to the nearest measured one."""
    wanted = {"retro_deg": wi, "mirror_deg": directions.mirror(wi)}
    if group is not None:
        wo = measured.turned[1][group]
        return {
            name: float(np.rad2deg(2 * np.arcsin(min(0.5 * np.linalg.norm(wo - w, axis=1).min(), 1.0))))
            for name, w in wanted.items()
        }
    grid = measured.table.grid
    assert grid is not None
    table = GridInterpolant(grid, measured.table.value[:, :1], measured.keep)
    return {name: _first_ring(table, wi, w) for name, w in wanted.items()}


def _first_ring(table: GridInterpolant, wi: FloatArray, around: FloatArray) -> float | None:
    """Smallest radius (degrees) at which a circle around a direction was measured, None beyond 30."""
    theta, phi = directions.spherical_from_vector(around)
    frame = np.stack(
        [
            directions.vector_from_spherical(theta + np.pi / 2, phi),
            directions.vector_from_spherical(np.pi / 2, phi + np.pi / 2),
        ]
    )
    angle = np.arange(8) * np.pi / 4
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1) @ frame
    for radius in (0.0, *_RINGS_DEG):
        r = np.deg2rad(radius)
        w = np.cos(r) * around + np.sin(r) * ring
        w = w[w[:, 2] > 0]
        if len(w) and not table.evaluate(wi[None, :], w)[1].all():
            return radius
    return None
