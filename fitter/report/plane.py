"""The plane of incidence: which samples lie near it, at which incidences, and on which side of the normal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.table import Table

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

MOST_SLICES = 6
#: Distances from the plane of incidence (degrees) that are tried until enough samples lie within.
PLANE_DEG = (0.25, 0.5, 1.0, 2.0, 5.0)
ENOUGH = 60
#: sin(theta_o) from which on a sample counts for that: near the normal everything is near the plane.
FAR = 0.5
#: Incidences closer than this (degrees) are one slice.
SAME_INCIDENCE_DEG = 1.0
#: Largest over smallest positive value from which on the axis is logarithmic.
LOG_RANGE = 30.0
CHUNK = 250_000


def near_plane(table: Table, rows: IndexArray) -> tuple[IndexArray, float]:
    """Those of ``rows`` near the plane of incidence, and the distance (degrees) that had to be allowed."""
    off: list[FloatArray] = []
    high: list[FloatArray] = []
    for start in range(0, len(rows), CHUNK):
        wi, wo = table.directions(rows[start : start + CHUNK])
        off.append(_off_plane(wi, wo))
        high.append(np.hypot(wo[:, 0], wo[:, 1]))
    distance = np.rad2deg(np.concatenate([np.empty(0), *off]))
    far = np.concatenate([np.empty(0), *high]) >= FAR
    counted = distance[far] if far.any() else distance
    enough = min(ENOUGH, len(counted))
    tolerance = next((t for t in PLANE_DEG if np.sum(counted <= t) >= enough), PLANE_DEG[-1])
    return rows[distance <= tolerance], tolerance


def _off_plane(wi: FloatArray, wo: FloatArray) -> FloatArray:
    """Angle in radians of ``wo`` from the plane of ``wi`` and the normal."""
    axis = _azimuth_axis(wi, wo)
    return np.arcsin(np.clip(np.abs(axis[:, 0] * wo[:, 1] - axis[:, 1] * wo[:, 0]), 0.0, 1.0))


def signed_theta(wi: FloatArray, wo: FloatArray) -> FloatArray:
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


def one_azimuth(
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


def incidence_groups(theta_i: FloatArray) -> list[IndexArray]:
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


def is_wide(measured: FloatArray) -> bool:
    """Whether the values span so much that only a logarithmic axis shows them."""
    positive = measured[measured > 0]
    return len(positive) > 2 and bool(positive.max() / positive.min() > LOG_RANGE)


def spread(count: int, most: int) -> tuple[int, ...]:
    """At most ``most`` of the positions 0 to ``count`` - 1, the ends among them, evenly spaced."""
    return tuple(np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)).tolist())
