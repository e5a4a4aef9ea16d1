"""Peaks in the plane of incidence: on which side they sit, and whether the receiver resolves them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.formats.describe import in_plane_peaks
from fitter.grid import Grid
from fitter.quality.finding import Finding, not_judged
from fitter.quality.measured import AT_NORMAL, Measured
from fitter.sampling.grid import GridInterpolant

FloatArray = NDArray[np.float64]

#: One side is larger than the other by this factor: there is a peak.
_SIDE = 1.3
#: A peak belongs to the mirror or retro direction within this many degrees.
_NEAR_DEG = 8.0
#: Incidences (degrees) between which a peak can be told from the normal and from the horizon.
_FROM_DEG, _TO_DEG = 10.0, 75.5
#: Growth of a peak from the steepest to the most grazing incidence that Fresnel reflection explains.
_RISE = 1.2
#: Peak over the median level of the table: below it there is none to speak of.
_CONTRAST = 2.0
#: Lobe width over aperture below which the aperture shows, and below which it is mostly what was measured.
WIDE, NARROW = 3.0, 1.5
#: A lobe of so few samples may be cut short by noise.
_FEW = 5
_MOST_SCANS = 50
_IN_PLANE = float(np.deg2rad(1.5))
_FINE = np.deg2rad(np.arange(-89.75, 89.8, 0.25))
_OTHER = {
    "phi_specular_180": "phi_specular_0", "phi_specular_0": "phi_specular_180",
    "forward": "back", "back": "forward",
}  # fmt: skip


def convention(measured: Measured) -> Finding:
    """Whether the in-plane peaks sit where mirror reflection belongs in the declared convention."""
    name = "convention"
    declared = measured.table.metadata.convention
    level = float(np.median(measured.level))
    rows = [r for r in in_plane_peaks(measured.table) if _FROM_DEG <= r["theta_i_deg"] <= _TO_DEG]
    kinds = [_kind(row, level) for row in rows]
    numbers: dict[str, Any] = {
        "declared": declared, "suggested": None,
        "incidences": [{**row, "peak": kind} for row, kind in zip(rows, kinds, strict=True)],
    }  # fmt: skip
    clear = [(row, kind) for row, kind in zip(rows, kinds, strict=True) if kind != "none"]
    if not clear or 2 * len(clear) < len(rows):
        why = "There is no clear peak" if rows else "Nothing was measured"
        sentence = f"{why} in the plane of incidence that would confirm the convention of the angles."
        return not_judged(name, sentence, **numbers)
    count = {kind: sum(k == kind for _, k in clear) for kind in ("specular", "retro", "normal", "elsewhere")}
    most = max(count, key=lambda kind: count[kind])
    of = f"at {count[most]} of {len(clear)} incidences"
    if most == "specular":
        sentence = f"The in-plane peaks sit near or beyond the mirror direction {of}, as they should."
        return Finding(name, "ok", sentence, numbers)
    if most == "retro":
        peaks = [row["retro_side"] for row, kind in clear if kind == "retro"]
        rises = len(peaks) > 1 and peaks[-1]["value_per_sr"] > _RISE * peaks[0]["value_per_sr"]
        told = f" ({declared})" if declared else ""
        if not rises:
            sentence = (
                f"The in-plane peaks sit towards the light {of}: a retro-reflector or backward scatter; for "
                f"an ordinary surface the azimuths would be half a turn off the declared convention{told}."
            )
            return Finding(name, "notice", sentence, numbers)
        numbers["suggested"] = _OTHER.get(declared, "azimuths turned by half a turn")
        sentence = (
            f"The in-plane peaks sit towards the light {of} and rise towards grazing, as mirror reflection "
            f"does: the declared convention{told} is probably half a turn off, try {numbers['suggested']}."
        )
        return Finding(name, "warning", sentence, numbers)
    if most == "normal":
        numbers["suggested"] = "angles counted from the specular direction"
        sentence = (
            f"The in-plane peaks stay at the normal {of}: the scattering angles are probably counted from "
            "the specular direction, not from the normal."
        )
        return Finding(name, "warning", sentence, numbers)
    sentence = f"The in-plane peaks sit neither at the mirror direction nor towards the light {of}."
    return Finding(name, "notice", sentence, numbers)


def _kind(row: dict[str, Any], level: float) -> str:
    """Where the peak of one incidence belongs: specular, retro, normal, elsewhere or none."""
    theta_i = row["theta_i_deg"]
    specular, retro = row["specular_side"], row["retro_side"]
    high = [side["value_per_sr"] for side in (specular, retro) if side is not None]
    if not high or max(high) <= max(_CONTRAST * level, 0.0):
        return "none"
    if specular is not None and (retro is None or specular["value_per_sr"] >= _SIDE * retro["value_per_sr"]):
        # Beyond the mirror direction counts: masking and the cosine shift the peak of a rough surface there.
        return "specular" if specular["theta_o_deg"] > theta_i - _NEAR_DEG else "elsewhere"
    if retro is not None and (specular is None or retro["value_per_sr"] >= _SIDE * specular["value_per_sr"]):
        return "retro" if abs(retro["theta_o_deg"] - theta_i) <= _NEAR_DEG else "elsewhere"
    assert specular is not None
    if specular["theta_o_deg"] < 0.25 * theta_i:
        return "normal"
    # As large on both sides: a surface that reflects and retro-reflects alike is as declared.
    return "specular" if abs(specular["theta_o_deg"] - theta_i) <= _NEAR_DEG else "none"


def lobe_width(measured: Measured) -> Finding:
    """Full width at half maximum of the narrowest in-plane lobe against the receiver's aperture."""
    name = "lobe_width"
    aperture = measured.table.metadata.aperture or None
    found: list[tuple[float, int | None]] = [
        one for one in (_width(theta, value) for theta, value in _profiles(measured)) if one is not None
    ]
    if measured.table.grid is not None and "theta_o" not in measured.table.grid.axes:
        found = [(width, None) for width, _ in found]  # of interpolated values the number says nothing
    if not found:
        return not_judged(
            name, "No in-plane lobe falls to half of its maximum on both sides: there is no width to compare "
            "with the receiver's aperture.", fwhm_deg=None,
            aperture_deg=None if aperture is None else np.rad2deg(aperture),
        )  # fmt: skip
    width, samples = min(found, key=lambda one: one[0])
    numbers: dict[str, Any] = {
        "fwhm_deg": np.rad2deg(width), "lobes": len(found), "samples_in_fwhm": samples,
        "aperture_deg": None if aperture is None else np.rad2deg(aperture),
        "fwhm_over_aperture": None if aperture is None else width / aperture,
    }  # fmt: skip
    shown = f"The narrowest in-plane lobe is {np.rad2deg(width):.3g}° wide (full width at half maximum)"
    coarse = samples is not None and samples < 3
    tail = " and has fewer than three samples across" if coarse else ""
    if aperture is None:
        sentence = f"{shown}{tail}; the table states no aperture to compare it with."
        return Finding(name, "notice" if coarse else "ok", sentence, numbers, judged=coarse)
    ratio = width / aperture
    against = f"{shown}{tail}, {ratio:.2g} times the receiver's aperture of {np.rad2deg(aperture):.3g}°"
    if ratio < 1.0:
        end = "no instrument shows that: the aperture or the angles are wrong, or the peak is noise"
        return Finding(name, "warning", f"{against}; {end}.", numbers)
    if ratio < NARROW:
        return Finding(name, "warning", f"{against}: its width is mostly the instrument's.", numbers)
    if ratio < WIDE:
        return Finding(name, "notice", f"{against}: the aperture broadens it visibly.", numbers)
    return Finding(name, "notice" if coarse else "ok", f"{against}.", numbers)


def _profiles(measured: Measured) -> list[tuple[FloatArray, FloatArray]]:
    """In-plane ``(theta_o signed, positive on the specular side, level)`` of some incidences, in order."""
    grid = measured.table.grid
    if grid is not None:
        table = GridInterpolant(grid, measured.table.value, measured.keep)
        signed = _FINE
        if "theta_o" in grid.axes:  # its own nodes, so that they can be counted
            nodes = grid.axes["theta_o"]
            signed = np.unique(np.concatenate([-nodes, nodes]))
        wo = directions.vector_from_spherical(signed, np.pi)
        found: list[tuple[FloatArray, FloatArray]] = []
        for theta in _grid_incidences(grid):
            value, outside = table.evaluate(directions.vector_from_spherical(theta, 0.0)[None, :], wo)
            found.append((signed[~outside], value[~outside].mean(axis=1)))
        return found
    wi, wo = measured.turned
    theta_i, phi_i = directions.spherical_from_vector(wi)
    theta_o, phi_o = directions.spherical_from_vector(wo)
    turn = np.abs(np.mod(phi_o - phi_i + np.pi, 2 * np.pi) - np.pi)
    at_normal = theta_o < AT_NORMAL
    forward, back = (np.pi - turn < _IN_PLANE), turn < _IN_PLANE
    signed = np.where(back & ~at_normal, -theta_o, theta_o)
    plane = (forward | back | at_normal) & (theta_i < np.deg2rad(_TO_DEG))
    lines: list[tuple[FloatArray, FloatArray]] = []
    for scan in measured.scans[:_MOST_SCANS]:
        mine = scan[plane[scan]]
        angle, inverse = np.unique(np.round(signed[mine], 6), return_inverse=True)
        size = np.bincount(inverse.reshape(-1), minlength=len(angle))
        total = np.bincount(inverse.reshape(-1), measured.level[mine], minlength=len(angle))
        lines.append((angle.astype(np.float64), np.asarray(total / np.maximum(size, 1))))
    return lines


def _grid_incidences(grid: Grid) -> FloatArray:
    """Some theta_i of a grid: its nodes between peaks at the normal and at the horizon, or usual ones."""
    nodes = grid.axes.get("theta_i")
    if nodes is None:
        return np.deg2rad([10.0, 30.0, 45.0, 60.0])
    inside = nodes[(nodes > np.deg2rad(_FROM_DEG) - 1e-6) & (nodes < np.deg2rad(_TO_DEG))]
    return inside[np.unique(np.linspace(0, max(len(inside) - 1, 0), 6).round().astype(int))[: len(inside)]]


def _width(theta: FloatArray, value: FloatArray) -> tuple[float, int] | None:
    """Full width at half maximum (radians) and the samples within; None unless both sides fall to half.

    A dip of one sample beside a peak of few is noise and no end of the lobe: medians of three tell.
    """
    if len(theta) < 5:
        return None
    found = _full_width(theta, value)
    if found is None or found[1] > _FEW:
        return found
    calm = np.median(np.stack([value[:-2], value[1:-1], value[2:]]), axis=0)
    # A peak of one sample is all there is of a narrow lobe on a coarse raster.
    return found if calm.max() < 0.5 * value.max() else _full_width(theta[1:-1], calm)


def _full_width(theta: FloatArray, value: FloatArray) -> tuple[float, int] | None:
    top = int(np.argmax(value))
    if value[top] <= 0:
        return None
    low = value < 0.5 * value[top]
    left, right = np.flatnonzero(low[:top]), np.flatnonzero(low[top:])
    if not len(left) or not len(right):
        return None
    ends: list[float] = []
    for outer, step in ((int(left[-1]), 1), (top + int(right[0]), -1)):
        inner = outer + step
        t = (0.5 * value[top] - value[outer]) / (value[inner] - value[outer])
        ends.append(float(theta[outer] + t * (theta[inner] - theta[outer])))
    inside = top + int(right[0]) - int(left[-1]) - 1
    width = ends[1] - ends[0]
    return (width, inside) if width > 0 else None
