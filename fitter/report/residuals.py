"""Residuals against angle: relative, per channel, with binned medians, a map, and how systematic they are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.models.padded import evaluated
from fitter.report.clean import drawn
from fitter.report.fitted import MOST_POINTS, MOST_SAMPLES, Fitted, IndexArray, thin

FloatArray = NDArray[np.float64]

ANGLES = {
    "theta_h": "half angle θ_h",
    "theta_i": "incidence θ_i",
    "theta_o": "scattering θ_o",
    "theta_d": "difference angle θ_d",
}
DEFINITION = (
    "(measured − fit) / (|measured| + floor), the floor being 1 % of the channel's median |measured| value"
)
BINS = 18
MAP_BINS = 24
#: A table with no more incidences than this gets one column of the map for each.
MOST_SCANS = 15
#: Below this many samples the systematic share says nothing.
FEWEST = 40


def section(fitted: Fitted, seed: int) -> dict[str, Any]:
    """The residuals of a fit, JSON-ready. Angles in degrees."""
    index = fitted.subsample(MOST_SAMPLES, seed)
    wi, wo = fitted.table.directions(index)
    measured = fitted.values(index)
    difference, relative = of_rows(fitted, index, wi, wo)
    angles = _angles(wi, wo)
    in_plane = fitted.table.domain.in_plane
    # One pair of angles leaves something out: the others show misfit that it averages away.
    (x, y), *further = [("theta_i", "theta_o_signed"), ("theta_h", "theta_d")]
    if not in_plane:
        (x, y), further = further[0], [(x, y), ("phi", "theta_o")]
    sigma = fitted.sigma(index)
    names = fitted.fit.model.channels
    free = len(fitted.fit.labels) / len(names)
    point = thin(np.arange(len(index)), MOST_POINTS, seed)
    return {
        "definition": DEFINITION,
        "samples": len(index),
        "of": len(fitted.index),
        "points_shown": len(point),
        "seed": seed,
        "per_channel": [
            {
                "channel": names[c],
                "median_value": float(np.median(measured[:, c])),
                "rmse": float(np.sqrt(np.mean(difference[:, c] ** 2))),
                "relative_rmse": float(np.sqrt(np.mean(relative[:, c] ** 2))),
                "relative_bias": float(np.median(relative[:, c])),
                "birge_ratio": None if sigma is None else _birge(difference[:, c] / sigma[:, c], free),
                "systematic_share": _systematic_share(relative[:, c], angles[x], angles[y]),
            }
            for c in range(len(names))
        ],
        "shown": [names[c] for c in fitted.shown],
        "angles": {
            name: {
                "label": label,
                "points": drawn(angles[name][point]),
                "binned": {names[c]: binned(angles[name], relative[:, c]) for c in fitted.shown},
            }
            for name, label in ANGLES.items()
        },
        "relative": {names[c]: drawn(relative[point, c]) for c in fitted.shown},
        "map": _one_map(angles, relative, x, y, [(c, names[c]) for c in fitted.shown]),
        "further_maps": [
            _one_map(angles, relative, x, y, [(c, names[c]) for c in fitted.shown]) for x, y in further
        ],
    }  # fmt: skip


def of_rows(
    fitted: Fitted, index: IndexArray, wi: FloatArray, wo: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(n, C) residuals of rows ``index`` of directions ``wi``, ``wo``: in 1/sr, and relative (DEFINITION)."""
    measured = fitted.values(index)
    difference = measured - evaluated(fitted.fit.model, wi, wo)
    magnitude = np.abs(fitted.values(fitted.index))
    floor = 0.01 * np.array([np.median(m) or m.mean() for m in magnitude.T])
    # An all-zero channel has no scale: nothing relative can be said of it.
    return difference, difference / (np.abs(measured) + np.where(floor > 0, floor, np.nan))


def signed_theta_o(wi: FloatArray, wo: FloatArray) -> FloatArray:
    """Polar angle of ``wo`` in radians, positive on the side of the specular direction."""
    theta_o, _ = directions.spherical_from_vector(wo)
    forward = -(wi[:, 0] * wo[:, 0] + wi[:, 1] * wo[:, 1])
    # At normal incidence there is no specular side: +x stands for it.
    side = np.where(np.hypot(wi[:, 0], wi[:, 1]) > 1e-6, forward, wo[:, 0] + 1e-9 * wo[:, 1])
    return np.where(side < 0, -theta_o, theta_o)


def _angles(wi: FloatArray, wo: FloatArray) -> dict[str, FloatArray]:
    theta_h, _, theta_d, _ = directions.half_difference_from_vectors(wi, wo)
    theta_i, _ = directions.spherical_from_vector(wi)
    theta_o, _ = directions.spherical_from_vector(wo)
    found = {
        "theta_h": theta_h, "theta_i": theta_i, "theta_o": theta_o, "theta_d": theta_d,
        "theta_o_signed": signed_theta_o(wi, wo), "phi": _away(wi, wo),
    }  # fmt: skip
    return {name: np.rad2deg(angle) for name, angle in found.items()}


def _away(wi: FloatArray, wo: FloatArray) -> FloatArray:
    """Azimuth of ``wo`` from that of the mirror direction, 0 to pi; 0 at normal incidence."""
    cross, along = wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0], wi[:, 0] * wo[:, 0] + wi[:, 1] * wo[:, 1]
    return np.where(np.hypot(wi[:, 0], wi[:, 1]) > 1e-6, np.abs(np.arctan2(cross, -along)), 0.0)


def _one_map(
    angles: dict[str, FloatArray], relative: FloatArray, x: str, y: str, channels: list[tuple[int, str]]
) -> dict[str, Any]:
    """Median residuals over two angles, by channel."""
    edges_x, edges_y = _map_edges(angles[x], x), _map_edges(angles[y], y)
    return {
        "x": x, "y": y, "x_edges": drawn(edges_x), "y_edges": drawn(edges_y),
        "median": {
            name: _map(angles[x], angles[y], relative[:, c], edges_x, edges_y) for c, name in channels
        },
    }  # fmt: skip


def _birge(standardised: FloatArray, free: float) -> float | None:
    """Root of chi squared per degree of freedom: 1 where the stated noise explains the residuals."""
    degrees = len(standardised) - free
    return float(np.sqrt(np.sum(standardised**2) / degrees)) if degrees > 0 else None


def _systematic_share(relative: FloatArray, x: FloatArray, y: FloatArray) -> float | None:
    """Share of the residual variance that position alone explains (adjusted R squared over cells).

    Noise that is independent from sample to sample gives 0, a smooth misfit of the model 1. The cells
    hold about ten samples, so that what varies within them is counted as noise: a lower bound.
    """
    good = np.isfinite(relative)
    n = int(good.sum())
    if n < FEWEST:
        return None
    # A single outlier must not pass for noise.
    low, high = np.quantile(relative[good], [0.01, 0.99])
    r = np.clip(relative[good], low, high)
    per_axis = int(np.clip(np.sqrt(n / 10), 2, 24))
    cell = np.zeros(n, np.intp)
    for angle in (x[good], y[good]):
        edges = np.unique(np.quantile(angle, np.linspace(0, 1, per_axis + 1)[1:-1]))
        cell = cell * (per_axis + 1) + np.searchsorted(edges, angle, side="right")
    _, cell = np.unique(cell, return_inverse=True)
    cells = int(cell.max()) + 1
    total = float(np.sum((r - r.mean()) ** 2))
    if total == 0 or n - cells < FEWEST // 2:
        return None
    means = np.bincount(cell, r) / np.bincount(cell)
    within = float(np.sum((r - means[cell]) ** 2))
    return float(np.clip(1 - (within / (n - cells)) / (total / (n - 1)), 0.0, 1.0))


def binned(angle: FloatArray, relative: FloatArray) -> dict[str, Any]:
    """Median and central 90 % of the residual in bins of an angle: its nodes, or equally full bins."""
    good = np.isfinite(relative)
    angle, relative = angle[good], relative[good]
    if not len(angle):
        return {"angle": [], "median": [], "lower": [], "upper": [], "count": []}
    nodes = np.unique(np.round(angle, 2))
    if len(nodes) <= BINS:
        # A scanned angle has few values: one bin each, or the worst scan hides in its neighbour's.
        inner = 0.5 * (nodes[1:] + nodes[:-1])
    else:
        inner = np.unique(np.quantile(angle, np.linspace(0, 1, min(BINS, max(1, len(angle) // 8)) + 1)))[1:-1]
    which = np.searchsorted(inner, angle, side="right")
    rows = [(angle[which == k], relative[which == k]) for k in np.unique(which)]
    low, mid, high = np.array([np.quantile(r, [0.05, 0.5, 0.95]) for _, r in rows]).T
    return {
        "angle": drawn([np.median(a) for a, _ in rows]),
        "median": drawn(mid), "lower": drawn(low), "upper": drawn(high),
        "count": [len(a) for a, _ in rows],
    }  # fmt: skip


def _map_edges(angle: FloatArray, name: str) -> FloatArray:
    """Cell edges in degrees: one column per scan where there are few, finer near the lobe in theta_h."""
    low, high = float(angle.min()), float(angle.max())
    if high - low < 1e-3:
        return np.array([low - 0.5, high + 0.5])
    nodes = np.unique(np.round(angle, 2))
    if name == "theta_i" and len(nodes) <= MOST_SCANS:
        inner = 0.5 * (nodes[1:] + nodes[:-1])
        return np.concatenate([[1.5 * nodes[0] - 0.5 * nodes[1]], inner, [1.5 * nodes[-1] - 0.5 * nodes[-2]]])
    if name == "theta_h":
        return np.linspace(np.sqrt(low), np.sqrt(high), MAP_BINS + 1) ** 2
    return np.linspace(low, high, MAP_BINS + 1)


def _map(x: FloatArray, y: FloatArray, r: FloatArray, edges_x: FloatArray, edges_y: FloatArray) -> list[Any]:
    """Rows (y) of columns (x) of median residuals, NaN where there is no sample."""
    shape = (len(edges_y) - 1, len(edges_x) - 1)
    column = np.clip(np.searchsorted(edges_x, x, side="right") - 1, 0, shape[1] - 1)
    row = np.clip(np.searchsorted(edges_y, y, side="right") - 1, 0, shape[0] - 1)
    found = np.full(shape, np.nan)
    cell = row * shape[1] + column
    order = np.argsort(cell, kind="stable")
    cells, start = np.unique(cell[order], return_index=True)
    for k, part in zip(cells, np.split(r[order], start[1:]), strict=True):
        found.flat[k] = np.median(part)
    return drawn(found)
