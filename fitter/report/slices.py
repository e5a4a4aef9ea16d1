"""Slices through the plane of incidence: measured samples, the fitted curve, the predictive band."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.models.padded import evaluated
from fitter.report.clean import drawn
from fitter.report.fitted import Fitted, restricted, thin
from fitter.report.plane import incidence_groups, is_wide, near_plane, one_azimuth, signed_theta

if TYPE_CHECKING:
    from fitter.posterior.predictive import Predictive
    from fitter.posterior.result import Posterior

FloatArray = NDArray[np.float64]

MOST_POINTS = 600
LEVEL = 0.95


def section(
    fitted: Fitted, posterior: Posterior | None, bands: Predictive | None, seed: int, *, middle: bool = False
) -> dict[str, Any]:
    """Up to six slices, JSON-ready: theta_o signed in degrees, positive on the specular side; f in 1/sr.

    middle : only that of the middle incidence.
    """
    index, tolerance = near_plane(fitted.table, fitted.index)
    if not len(index):
        return {
            "plane_tolerance_deg": tolerance,
            "azimuth_deg": None,
            "channels": [],
            "level": None,
            "predictive_level": None,
            "slices": [],
        }
    wi, wo = fitted.table.directions(index)
    index, wi, wo, azimuth = one_azimuth(fitted.table, index, wi, wo)
    theta_i, _ = directions.spherical_from_vector(wi)
    signed = signed_theta(wi, wo)
    groups = incidence_groups(np.rad2deg(theta_i))
    if middle:
        groups = [groups[len(groups) // 2]]
    names = fitted.fit.model.channels
    shown = tuple(names[c] for c in fitted.shown)
    incidences = [float(np.median(theta_i[g])) for g in groups]
    curves = [_curve(theta, np.rad2deg(signed[g])) for theta, g in zip(incidences, groups, strict=True)]
    phi = 0.0 if azimuth is None else np.deg2rad(azimuth)
    pairs = [_pairs(theta, curve, phi) for theta, curve in zip(incidences, curves, strict=True)]
    at_i, at_o = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
    values = evaluated(fitted.fit.model, at_i, at_o)[:, fitted.shown]
    band = None if posterior is None else restricted(posterior, shown).predict(at_i, at_o, LEVEL)
    wide = None if bands is None else [edge[:, fitted.shown] for edge in bands.predict(at_i, at_o, LEVEL)]
    ends = np.cumsum([len(c) for c in curves])[:-1]
    found: list[dict[str, Any]] = []
    for k, group in enumerate(groups):
        point = thin(group, MOST_POINTS, seed)
        measured = fitted.values(index[point])[:, fitted.shown]
        fit_k = np.split(values, ends)[k]
        lower, upper, least, most = (
            None if edge is None else _by_channel(shown, np.split(edge, ends)[k])
            for edge in (*(band or (None, None)), *(wide or (None, None)))
        )
        found.append(
            {
                "theta_i_deg": float(np.rad2deg(incidences[k])),
                "samples": len(group),
                "axis": "log" if is_wide(measured) else "linear",
                "points": {
                    "theta_o_deg": drawn(np.rad2deg(signed[point])),
                    "measured": _by_channel(shown, measured),
                },
                "curve": {
                    "theta_o_deg": drawn(curves[k], 7),
                    "fit": _by_channel(shown, fit_k),
                    "lower": lower, "upper": upper,
                    "predictive_lower": least, "predictive_upper": most,
                },
            }
        )
    return {
        "plane_tolerance_deg": tolerance,
        "azimuth_deg": azimuth,
        "channels": list(shown),
        "level": None if posterior is None else LEVEL,
        "predictive_level": None if bands is None else LEVEL,
        "slices": found,
    }


def _by_channel(names: tuple[str, ...], columns: FloatArray) -> dict[str, list[float]]:
    return {name: drawn(column) for name, column in zip(names, columns.T, strict=True)}


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
