"""Description of a table: what was read, how, and where its peaks are, for people and for JSON."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.table import Table

#: Half-widths (radians) within which a sample counts as in the plane and at an incidence.
_IN_PLANE, _AT_INCIDENCE = np.deg2rad(1.5), np.deg2rad(1.0)
_INCIDENCES_SHOWN = 8
#: Values that count as many; those of them that say about where the median lies, and the root of that number.
_MANY, _SAMPLED, _ROOT = 100_000, 4096, 64


def describe(table: Table) -> dict[str, Any]:
    """JSON-ready facts: format, quantity, channels, counts, grid, domain (deg), values (1/sr), peaks."""
    meta = table.metadata
    # Neither holds the interpreter's lock: with a core to spare the hash costs no time.
    with ThreadPoolExecutor(2) as beside:
        hashed = beside.submit(lambda: table.hash)
        waiting = beside.map(lambda k: _channel(table, k), range(len(table.channels)))
        peaks, domain = in_plane_peaks(table), table.domain
        channels, hash = list(waiting), hashed.result()
    return {
        "name": meta.name,
        "format": meta.source_format,
        "quantity": meta.quantity,
        "convention": meta.convention,
        "angle_unit": meta.angle_unit,
        "symmetry": table.symmetry,
        "samples": len(table),
        "usable": int(table.mask.sum()),
        "masked": dict(meta.masked),
        "channels": channels,
        "sigma": table.sigma is not None,
        "grid": _grid(table),
        "domain": domain.to_dict(),
        "peaks": peaks,
        "scale_uncertainty": meta.scale_uncertainty,
        "angle_uncertainty_deg": _degrees(meta.angle_uncertainty),
        "aperture_deg": _degrees(meta.aperture),
        "hash": hash,
        "sha256": meta.sha256,
        "provenance": dict(meta.provenance),
        "notes": list(meta.notes),
    }


def _channel(table: Table, k: int) -> dict[str, Any]:
    column = table.value[:, k][table.mask]
    return {
        "name": table.channels[k].name,
        "wavelength_nm": table.channels[k].wavelength_nm,
        "min_per_sr": float(column.min()) + 0.0,  # -0 is 0
        "median_per_sr": _median(column),
        "max_per_sr": float(column.max()),
    }


def _median(x: NDArray[np.float64]) -> float:
    """The median: of many values by a sort of those about it only, in a quarter of the time."""
    n = len(x)
    if n >= _MANY:
        sampled = np.sort(x[:: n // _SAMPLED])
        middle = len(sampled) // 2
        # Six standard deviations of a sample's rank to either side.
        low, high = sampled[[middle - 3 * _ROOT, middle + 3 * _ROOT]]
        near = x >= low
        below = n - np.count_nonzero(near)
        near &= x <= high
        some = x[near]
        first, second = (n - 1) // 2 - below, n // 2 - below
        if first >= 0 and second < len(some):
            some.partition((first, second))
            return float(0.5 * (some[first] + some[second]))
    return float(np.median(x, overwrite_input=True))


def in_plane_peaks(table: Table) -> list[dict[str, Any]]:
    """Where the largest in-plane values sit, for up to eight incidences away from the normal.

    Each entry has ``theta_i_deg`` and, for the ``specular_side`` and the ``retro_side``, the ``theta_o_deg``
    of the largest value (mean of the channels, 1/sr), or None where nothing was measured on that side. A
    specular peak belongs at theta_o near theta_i on the specular side, a retro-reflector's on the other.
    """
    index = _candidates(table)
    wi, wo = table.directions(index)
    theta_i, phi_i = directions.spherical_from_vector(wi)
    theta_o, phi_o = directions.spherical_from_vector(wo)
    turn = np.abs(np.mod(phi_o - phi_i + np.pi, 2 * np.pi) - np.pi)
    normal = theta_o < 1e-3
    sides = {"specular_side": normal | (np.pi - turn < _IN_PLANE), "retro_side": normal | (turn < _IN_PLANE)}
    level = table.value[index].mean(axis=1)
    tilted = (theta_i > np.deg2rad(2.0)) & (sides["specular_side"] | sides["retro_side"])
    found = np.unique(np.round(np.rad2deg(theta_i[tilted])))
    if len(found) > _INCIDENCES_SHOWN:
        found = found[np.unique(np.linspace(0, len(found) - 1, _INCIDENCES_SHOWN).round().astype(int))]
    peaks: list[dict[str, Any]] = []
    for incidence in np.deg2rad(found):
        # 22.5 deg is rounded to 22 and lies at the very edge: rounding must not put it outside.
        near = np.abs(theta_i - incidence) <= _AT_INCIDENCE / 2 + 1e-9
        entry: dict[str, Any] = {"theta_i_deg": float(np.rad2deg(np.mean(theta_i[near & tilted])))}
        for side, here in sides.items():
            at = np.flatnonzero(near & here)
            best = at[np.argmax(level[at])] if len(at) else None
            entry[side] = None if best is None else {
                "theta_o_deg": float(np.rad2deg(theta_o[best])), "value_per_sr": float(level[best])
            }  # fmt: skip
        peaks.append(entry)
    return peaks


def _candidates(table: Table) -> NDArray[np.intp]:
    """Usable samples that can be in plane: of a half-difference grid, those of the fitting phi_d."""
    if table.grid is None or table.grid.system != "half_difference":
        return np.flatnonzero(table.mask)
    axis = table.grid.axes["phi_d"]
    off = np.abs(np.mod(axis + np.pi / 2, np.pi) - np.pi / 2)
    keep = off <= off.min() + 1e-9
    return np.flatnonzero(table.mask.reshape(table.grid.shape) & keep)


def _grid(table: Table) -> dict[str, Any] | None:
    if table.grid is None:
        return None
    return {
        "system": table.grid.system,
        "shape": list(table.grid.shape),
        "axes_deg": {
            name: [float(np.rad2deg(axis[0])), float(np.rad2deg(axis[-1]))]
            for name, axis in table.grid.axes.items()
        },
    }


def _degrees(angle: float | None) -> float | None:
    return None if angle is None else float(np.rad2deg(angle))
