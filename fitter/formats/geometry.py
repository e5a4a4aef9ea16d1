"""Geometry of a text table: declared angles or vectors to the internal frame, checked for plausibility."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.formats.source import Source
from fitter.grid import GRID_AXES, Grid
from fitter.parts import in_parts

FloatArray = NDArray[np.float64]

#: Within this of the horizon (in cos theta) a direction is taken to be on it: 90 deg written to 6 digits.
HORIZON = 1e-6
#: Fewer rows or distinct polar angles than this are no evidence of a wrong unit.
_EVIDENCE_ROWS, _EVIDENCE_ANGLES = 20, 5


@dataclass(frozen=True)
class Geometry:
    """Directions of every row, and how they were read.

    wi, wo : (n, 3). coordinates : system of ``GRID_AXES`` -> its (n,) coordinates, for the systems the
    rows can be expressed in, the natural one first. symmetric : whether the incident azimuth never varies.
    """

    wi: FloatArray
    wo: FloatArray
    convention: str
    notes: tuple[str, ...] = ()
    coordinates: Mapping[str, tuple[FloatArray, ...]] = field(
        default_factory=dict[str, tuple[FloatArray, ...]]
    )
    symmetric: bool = False


def to_radians(
    source: Source,
    angles: Mapping[str, FloatArray],
    units: Mapping[str, str],
    names: Mapping[str, str],
    rows: NDArray[np.intp] | range,
) -> dict[str, FloatArray]:
    """Angle columns (role -> (n,)) in radians, not finite ones as NaN.

    Raises TableError for angles no direction has, and where the values plainly are in the other unit.
    """
    turned: dict[str, FloatArray] = {}
    finite = {role: _finite(angle) for role, angle in angles.items()}
    for role, angle in angles.items():
        degrees = units[role] == "deg"
        polar = role.startswith("theta")
        largest = (180.0 if polar else 720.0) if degrees else (np.pi if polar else 4 * np.pi) + 1e-6
        if _largest(finite[role]) > largest:
            magnitude = np.abs(np.where(np.isfinite(angle), angle, 0.0))
            k = int(np.argmax(magnitude > largest))
            in_degrees = not degrees and magnitude.max() <= 720
            raise source.error(
                f"{names[role]} is {angle[k]:g} {units[role]}, which no direction has", "table-angle-range",
                row=int(rows[k]), column=names[role],
                cause="the angles are in degrees" if in_degrees else "a wrong column or unit",
                remedy=f"declare the column as {role}_{'deg' if in_degrees else 'rad'} or mend the value",
            )  # fmt: skip
        turned[role] = _radians(angle) if degrees else angle
        if finite[role] is not angle:
            turned[role] = np.where(np.isfinite(angle), turned[role], np.nan)
    _refuse_radians(source, finite, units, names)
    return turned


def _radians(degrees: FloatArray) -> FloatArray:
    turned = np.empty_like(degrees)

    def turn(part: slice) -> None:
        np.deg2rad(degrees[part], out=turned[part])

    in_parts(turn, len(turned))
    return turned


def _refuse_radians(
    source: Source, finite: Mapping[str, FloatArray], units: Mapping[str, str], names: Mapping[str, str]
) -> None:
    polar = [role for role in finite if role.startswith("theta")]
    if not polar or any(units[role] != "deg" for role in finite):
        return
    if any(_largest(angle) > (1.6 if role in polar else 6.3) for role, angle in finite.items()):
        return
    values = np.concatenate([finite[role] for role in polar])
    if values.size >= _EVIDENCE_ROWS * len(polar) and len(np.unique(values)) >= _EVIDENCE_ANGLES:
        raise source.error(
            f"all polar angles are within {np.abs(values).max():.3g} deg of the normal", "table-angle-unit",
            column=", ".join(names[role] for role in polar), cause="the angles are in radians",
            remedy="declare the columns as _rad (if they really are so small, convert them to radians first)",
        )  # fmt: skip


def from_angles(source: Source, angles: Mapping[str, FloatArray], convention: str | None) -> Geometry:
    """Geometry from polar angles and azimuths (role -> (n,) radians) under a declared convention.

    A negative polar angle is the opposite side: (theta, phi) is (-theta, phi + pi). One absent
    azimuth is 0 when the other varies; with none, ``convention`` must name the side.
    """
    theta_i, theta_o = angles["theta_i"], angles["theta_o"]
    notes: list[str] = []
    phi_i = angles["phi_i"] if "phi_i" in angles else np.zeros_like(theta_i)
    stated = "dphi" in angles or "phi_o" in angles
    if "dphi" in angles:
        phi_o = phi_i + angles["dphi"]
    elif "phi_o" in angles:
        phi_o = angles["phi_o"]
        if "phi_i" not in angles:
            notes.append("The file has no incident azimuth: it was taken as 0.")
    elif _varies(phi_i):
        phi_o, stated = np.zeros_like(theta_i), True
        notes.append("The file has no outgoing azimuth: it was taken as 0.")
    else:
        phi_o = np.zeros_like(theta_i)
    if stated:
        if convention in ("forward", "back"):
            raise source.error(
                f"convention {convention!r} is for tables without azimuths, and this one has them",
                "table-convention", parameter="convention",
                remedy="use phi_specular_180 or phi_specular_0, or leave it out",
            )  # fmt: skip
        convention = convention or "phi_specular_180"
        if convention == "phi_specular_0":
            phi_o = phi_o + np.pi
        side = "180" if convention == "phi_specular_180" else "0"
        notes.append(f"Azimuths were read so that mirror reflection is at phi_o - phi_i = {side} deg.")
    else:
        if convention not in ("forward", "back"):
            raise source.error(
                "the table has no azimuths and does not say on which side theta_o is",
                "table-convention", parameter="convention",
                remedy="give convention='forward' when mirror reflection is at theta_o = theta_i, 'back' "
                "when it looks back to the light; or add a column phi_o_deg or dphi_deg",
            )  # fmt: skip
        if convention == "forward":
            phi_o = phi_o + np.pi
        sides = "the specular side" if convention == "forward" else "the side of the light"
        notes.append(f"In-plane table without azimuths: theta_o of the sign of theta_i was read as {sides}.")
    folded = int(np.count_nonzero((theta_i < 0) | (theta_o < 0)))
    if folded:
        notes.append(f"{folded} rows have a negative polar angle: read as the opposite azimuth.")
    turns = _varies(phi_i)
    systems: dict[str, tuple[FloatArray, ...]] = {}
    if not folded:
        systems = {} if turns else {"spherical_isotropic": (theta_i, theta_o, phi_o - phi_i)}
        systems["spherical"] = (theta_i, phi_i, theta_o, phi_o)
    wi = _snap(directions.vector_from_spherical(theta_i, phi_i))
    wo = _snap(directions.vector_from_spherical(theta_o, phi_o))
    return Geometry(wi, wo, convention, tuple(notes), systems, not turns)


def refuse_convention(source: Source, convention: str | None) -> None:
    """Raise TableError where a convention about azimuths is given for directions that need none."""
    if convention not in (None, "phi_specular_180"):
        raise source.error(
            f"convention {convention!r} means nothing for vectors or half-difference angles",
            "table-convention", parameter="convention", remedy="leave it out",
        )  # fmt: skip


def from_half_difference(angles: Mapping[str, FloatArray]) -> Geometry:
    """Geometry from Rusinkiewicz angles theta_h, theta_d, phi_d and optionally phi_h (radians)."""
    phi_h = angles.get("phi_h")
    c = (angles["theta_h"], angles["theta_d"], angles["phi_d"])
    wi, wo = directions.vectors_from_half_difference(*c, 0.0 if phi_h is None else phi_h)
    return Geometry(
        _snap(wi), _snap(wo), "half_difference",
        ("Directions were computed from half-difference (Rusinkiewicz) angles.",),
        {"half_difference": c} if phi_h is None else {}, phi_h is None,
    )  # fmt: skip


def from_vectors(
    source: Source, wi: FloatArray, wo: FloatArray, rows: NDArray[np.intp] | range, names: tuple[str, str]
) -> Geometry:
    """Geometry from vector components (n, 3). Rounded ones are scaled to unit length; others are refused."""
    notes: list[str] = []
    pair: list[FloatArray] = []
    for name, given in zip(names, (wi, wo), strict=True):
        with np.errstate(over="ignore", invalid="ignore"):
            length: FloatArray = np.sqrt((given * given).sum(axis=1))
        wrong = np.isfinite(given).all(axis=1) & ~(np.abs(length - 1.0) < 1e-2)
        if wrong.any():
            k = int(np.argmax(wrong))
            raise source.error(
                f"the vector has length {length[k]:g}", "table-not-unit", row=int(rows[k]), column=name,
                cause="the columns are not components of a direction", remedy="give unit vectors",
            )  # fmt: skip
        # Only what rounding has spoilt is touched, so that full-precision tables come back bit by bit.
        rounded: NDArray[np.bool_] = np.abs(length - 1.0) > 1e-9
        if rounded.any():
            notes.append(f"{int(rounded.sum())} vectors of {name} were scaled to unit length.")
            given = np.where(rounded[:, None], given / np.where(rounded, length, 1.0)[:, None], given)
        known = np.logical_and.reduce(np.isfinite(given), axis=1)
        pair.append(np.where(known[:, None], given, np.nan))
    return Geometry(pair[0], pair[1], "vectors", tuple(notes))


def from_directions(wi: FloatArray, wo: FloatArray, convention: str, *, symmetric: bool) -> Geometry:
    """Geometry of unit vectors (n, 3) that a reader computed itself."""
    return Geometry(_snap(wi), _snap(wo), convention, symmetric=symmetric)


def find_grid(
    geometry: Geometry,
    *,
    system: str | None = None,
    periodic: Mapping[str, float] | None = None,
    smallest: int = 2,
) -> tuple[Grid, NDArray[np.intp]] | None:
    """The product grid the rows fill completely and once, with the row of each cell in storage order.

    None when they don't. ``system`` None is the natural one of the geometry; ``smallest`` is how many nodes
    every axis must have; ``periodic`` overrides the periods that are found from azimuth axes that close
    on themselves.
    """
    system = system or next(iter(geometry.coordinates), None)
    if system is None or system not in geometry.coordinates:
        return None
    coordinates = geometry.coordinates[system]
    n = len(coordinates[0])
    # Axes have at least the nodes that some of the rows have: few scattered rows show that there is no grid.
    some = slice(None, None, n // 4096 + 1)
    if math.prod(len(np.unique(_rounded(c[some]))) for c in coordinates) > n:
        return None
    axes: dict[str, FloatArray] = {}
    places: list[NDArray[np.intp]] = []
    for name, c in zip(GRID_AXES[system], coordinates, strict=True):
        if not np.isfinite(c).all():
            return None
        first, place = _nodes(_rounded(c))
        if len(first) < smallest or (name.startswith("theta") and c.min() < 0):
            return None
        node = c[first]
        if name.startswith("theta_") and system != "half_difference":
            node = np.where(np.abs(node - np.pi / 2) < HORIZON, np.pi / 2, node)
        axes[name] = node
        places.append(place)
    shape = tuple(len(axis) for axis in axes.values())
    if math.prod(shape) != n:
        return None
    cell = np.ravel_multi_index(tuple(places), shape)
    order = np.full(n, -1, np.intp)
    order[cell] = np.arange(n)
    if (order < 0).any():  # a cell without a row: another has several
        return None
    return Grid(system, axes, _periods(system, axes) if periodic is None else dict(periodic)), order


def _rounded(c: FloatArray) -> FloatArray:
    """Differences of azimuths carry rounding: nodes are told apart at 1e-9 rad."""
    return np.round(c, 9)


def _nodes(c: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """For ``c`` (n,): where each of its values first stands, in increasing order, and which one a row has."""
    # Those of some of the rows are nearly always all, and looking each row up among them beats sorting.
    known = np.unique(c[:: len(c) // 65_536 + 1])
    place = np.minimum(np.searchsorted(known, c), len(known) - 1)
    if not np.array_equal(known[place], c):
        _, first, place = np.unique(c, return_index=True, return_inverse=True)
        return first, place.reshape(-1)
    first = np.empty(len(known), np.intp)
    first[place[::-1]] = np.arange(len(c))[::-1]  # the last one written is the first row
    return first, place


def _periods(system: str, axes: Mapping[str, FloatArray]) -> dict[str, float]:
    found: dict[str, float] = {}
    for name, axis in axes.items():
        if name.startswith("theta") or len(axis) < 3:
            continue
        turn = (axis[-1] - axis[0]) * len(axis) / (len(axis) - 1)
        for period in (np.pi, 2 * np.pi) if system == "half_difference" else (2 * np.pi,):
            if abs(turn - period) < 1e-6:
                found[name] = period
    return found


def _varies(angle: FloatArray) -> bool:
    known = _finite(angle)
    return known.size > 0 and float(np.ptp(known)) > 1e-9


def _finite(angle: FloatArray) -> FloatArray:
    """The finite ones of ``angle`` (n,): itself where all are."""
    known = np.isfinite(angle)
    return angle if known.all() else angle[known]


def _largest(angle: FloatArray) -> float:
    """The largest magnitude, 0 of none."""
    return max(float(angle.max()), -float(angle.min())) if angle.size else 0.0


def _snap(w: FloatArray) -> FloatArray:
    """Directions within ``HORIZON`` of the horizon set exactly on it, so that 90 deg is never 'above'."""
    z = w[..., 2].reshape(-1)  # a view: components of a direction stand side by side

    def snap(part: slice) -> None:
        near = np.flatnonzero(np.abs(z[part]) < HORIZON)
        z[part.start + near] = 0.0

    in_parts(snap, len(z))
    return w
