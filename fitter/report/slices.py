"""Slices through the plane of incidence: measured samples, the fitted curve, the predictive band."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.models.padded import evaluated
from fitter.report.clean import drawn
from fitter.report.fitted import Fitted, IndexArray, restricted, spread, thin
from fitter.table import Table

if TYPE_CHECKING:
    from fitter.posterior.result import Posterior

FloatArray = NDArray[np.float64]

MOST_SLICES = 6
MOST_POINTS = 600
#: Distances from the plane of incidence (degrees) that are tried until enough samples lie within.
PLANE_DEG = (0.25, 0.5, 1.0, 2.0, 5.0)
ENOUGH = 60
#: Incidences closer than this (degrees) are one slice.
SAME_INCIDENCE_DEG = 1.0
#: Largest over smallest positive value from which on the axis is logarithmic.
LOG_RANGE = 30.0
LEVEL = 0.95
CHUNK = 250_000


def section(fitted: Fitted, posterior: Posterior | None, seed: int) -> dict[str, Any]:
    """Up to six slices, JSON-ready: theta_o signed in degrees, positive on the specular side; f in 1/sr."""
    index, tolerance = _near_plane(fitted)
    if not len(index):
        return {
            "plane_tolerance_deg": tolerance,
            "azimuth_deg": None,
            "channels": [],
            "level": None,
            "slices": [],
        }
    wi, wo = fitted.table.directions(index)
    index, wi, wo, azimuth = _one_azimuth(fitted.table, index, wi, wo)
    theta_i, _ = directions.spherical_from_vector(wi)
    signed = _signed(wi, wo)
    groups = _incidences(np.rad2deg(theta_i))
    names = fitted.fit.model.channels
    shown = tuple(names[c] for c in fitted.shown)
    incidences = [float(np.median(theta_i[g])) for g in groups]
    curves = [_curve(theta, np.rad2deg(signed[g])) for theta, g in zip(incidences, groups, strict=True)]
    phi = 0.0 if azimuth is None else np.deg2rad(azimuth)
    pairs = [_pairs(theta, curve, phi) for theta, curve in zip(incidences, curves, strict=True)]
    at_i, at_o = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
    values = evaluated(fitted.fit.model, at_i, at_o)[:, fitted.shown]
    band = None if posterior is None else restricted(posterior, shown).predict(at_i, at_o, LEVEL)
    ends = np.cumsum([len(c) for c in curves])[:-1]
    found: list[dict[str, Any]] = []
    for k, group in enumerate(groups):
        point = thin(group, MOST_POINTS, seed)
        measured = fitted.values(index[point])[:, fitted.shown]
        fit_k = np.split(values, ends)[k]
        lower, upper = (None, None) if band is None else (np.split(edge, ends)[k] for edge in band)
        found.append(
            {
                "theta_i_deg": float(np.rad2deg(incidences[k])),
                "samples": len(group),
                "axis": _axis(measured),
                "points": {
                    "theta_o_deg": drawn(np.rad2deg(signed[point])),
                    "measured": _by_channel(shown, measured),
                },
                "curve": {
                    "theta_o_deg": drawn(curves[k], 7),
                    "fit": _by_channel(shown, fit_k),
                    "lower": None if lower is None else _by_channel(shown, lower),
                    "upper": None if upper is None else _by_channel(shown, upper),
                },
            }
        )
    return {
        "plane_tolerance_deg": tolerance,
        "azimuth_deg": azimuth,
        "channels": list(shown),
        "level": None if posterior is None else LEVEL,
        "slices": found,
    }


def _by_channel(names: tuple[str, ...], columns: FloatArray) -> dict[str, list[float]]:
    return {name: drawn(column) for name, column in zip(names, columns.T, strict=True)}


def _near_plane(fitted: Fitted) -> tuple[IndexArray, float]:
    """Rows near the plane of incidence, and the distance from it (degrees) that had to be allowed."""
    off: list[FloatArray] = []
    for start in range(0, len(fitted.index), CHUNK):
        off.append(_off_plane(*fitted.table.directions(fitted.index[start : start + CHUNK])))
    distance = np.rad2deg(np.concatenate(off))
    enough = min(ENOUGH, len(distance))
    tolerance = next((t for t in PLANE_DEG if np.sum(distance <= t) >= enough), PLANE_DEG[-1])
    return fitted.index[distance <= tolerance], tolerance


def _off_plane(wi: FloatArray, wo: FloatArray) -> FloatArray:
    """Angle in radians of ``wo`` from the plane of ``wi`` and the normal."""
    axis = _azimuth_axis(wi, wo)
    return np.arcsin(np.clip(np.abs(axis[:, 0] * wo[:, 1] - axis[:, 1] * wo[:, 0]), 0.0, 1.0))


def _signed(wi: FloatArray, wo: FloatArray) -> FloatArray:
    """Polar angle of ``wo`` (radians), positive on the specular side of the normal."""
    theta_o, _ = directions.spherical_from_vector(wo)
    towards_light = np.einsum("ij,ij->i", _azimuth_axis(wi, wo), wo[:, :2])
    return np.where(towards_light > 0, -theta_o, theta_o)


def _azimuth_axis(wi: FloatArray, wo: FloatArray) -> FloatArray:
    """(n, 2) unit vectors along the azimuth of ``wi``; one common azimuth at normal incidence."""
    length = np.hypot(wi[:, 0], wi[:, 1])
    tilted = length > 1e-6
    along = wi[:, :2] / np.where(tilted, length, 1.0)[:, None]
    return np.where(tilted[:, None], along, _reference(wi, wo))


def _reference(wi: FloatArray, wo: FloatArray) -> FloatArray:
    """(2,) the azimuth that stands for the plane of incidence where the incidence is normal."""
    for w in (wi, wo):
        length = np.hypot(w[:, 0], w[:, 1])
        if length.max() > 1e-6:
            xy = w[int(np.argmax(length)), :2]
            return xy / np.hypot(*xy)
    return np.array([1.0, 0.0])


def _one_azimuth(
    table: Table, index: IndexArray, wi: FloatArray, wo: FloatArray
) -> tuple[IndexArray, FloatArray, FloatArray, float | None]:
    """Of an anisotropic table, the incident azimuth (degrees) with the most samples near the plane."""
    if table.symmetry == "isotropic":
        return index, wi, wo, None
    phi = np.rad2deg(np.arctan2(wi[:, 1], wi[:, 0]))
    tilted = np.hypot(wi[:, 0], wi[:, 1]) > 1e-6
    if not tilted.any():
        return index, wi, wo, None
    rounded = np.mod(np.round(phi), 360)
    azimuths, counts = np.unique(rounded[tilted], return_counts=True)
    best = float(azimuths[np.argmax(counts)])
    keep = tilted & (rounded == best)
    return index[keep], wi[keep], wo[keep], best


def _incidences(theta_i: FloatArray) -> list[IndexArray]:
    """Positions of the samples of up to six incidences, evenly spread over those that have enough."""
    nodes, which = np.unique(np.round(theta_i, 2), return_inverse=True)
    start, label, labels = nodes[0], 0, np.zeros(len(nodes), np.intp)
    for k, node in enumerate(nodes):
        if node - start > SAME_INCIDENCE_DEG:
            start, label = node, label + 1
        labels[k] = label
    group = labels[which]
    counts = np.bincount(group)
    least = min(int(counts.max()), max(3, int(counts.max()) // 10))
    usable = np.flatnonzero(counts >= least)
    chosen = spread(len(usable), MOST_SLICES)
    if len(usable) > 2 * MOST_SLICES:  # a grid: the middle of equal shares, not its most grazing cells
        chosen = tuple(int((k + 0.5) / MOST_SLICES * len(usable)) for k in range(MOST_SLICES))
    return [np.flatnonzero(group == usable[k]) for k in chosen]


def _curve(theta_i: float, measured: FloatArray) -> FloatArray:
    """Where the curve is drawn (degrees): the measured range, denser around the specular direction."""
    low, high = max(float(measured.min()) - 2.0, -89.5), min(float(measured.max()) + 2.0, 89.5)
    near = np.geomspace(0.02, 12.0, 28)
    specular = np.rad2deg(theta_i)
    nodes = np.concatenate([np.linspace(low, high, 121), specular - near, [specular], specular + near])
    return np.unique(nodes[(nodes >= low) & (nodes <= high)])


def _pairs(theta_i: float, curve: FloatArray, phi: float) -> tuple[FloatArray, FloatArray]:
    wi = directions.vector_from_spherical(np.full(len(curve), theta_i), phi)
    # A positive angle lies opposite to the light.
    wo = directions.vector_from_spherical(np.deg2rad(curve), phi + np.pi)
    return wi, wo


def _axis(measured: FloatArray) -> str:
    positive = measured[measured > 0]
    return "log" if len(positive) > 2 and positive.max() / positive.min() > LOG_RANGE else "linear"
