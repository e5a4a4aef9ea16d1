"""Views of a table's interpolant at one incidence: the slice in the plane of incidence, and the lobe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.table import Table

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: Polar angles (degrees) up to which a view goes.
HORIZON_DEG = 89.5
#: Distances (degrees) from the mirror direction at which a lobe has nodes of its own: peaks are narrow.
NEAR_DEG = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0)


@dataclass(frozen=True)
class InPlane:
    """The interpolant in the plane of incidence.

    theta_o_deg : (n,), positive on the specular side. values : (n, C) in 1/sr. extrapolated : (n,) where
    nothing was measured.
    """

    theta_o_deg: FloatArray
    values: FloatArray
    extrapolated: BoolArray


@dataclass(frozen=True)
class Lobe:
    """The interpolant over the hemisphere of ``wo``.

    theta_o_deg : (m,), turn_deg : (k,) azimuths from that of the light, so that 180 is the specular side;
    the first and the last are the same direction. values : (m, k, C) in 1/sr. extrapolated : (m, k) where
    nothing was measured.
    """

    theta_o_deg: FloatArray
    turn_deg: FloatArray
    values: FloatArray
    extrapolated: BoolArray


def in_plane(table: Table, theta_i_deg: float, phi_i_deg: float = 0.0, *, n: int = 180) -> InPlane:
    """The slice of a table at one incidence, at ``n`` evenly spaced polar angles."""
    theta_o = np.linspace(-HORIZON_DEG, HORIZON_DEG, n)
    # The specular side is half a turn from the incident azimuth.
    wo = directions.vector_from_spherical(np.deg2rad(theta_o), np.deg2rad(phi_i_deg) + np.pi)
    values, extrapolated = table.evaluate(np.broadcast_to(_incident(theta_i_deg, phi_i_deg), (n, 3)), wo)
    return InPlane(theta_o, values, extrapolated)


def lobe(table: Table, theta_i_deg: float, phi_i_deg: float = 0.0, *, step_deg: float = 3.0) -> Lobe:
    """The lobe of a table at one incidence: nodes ``step_deg`` apart, denser around the mirror direction."""
    theta_o = _nodes(0.0, HORIZON_DEG, step_deg, theta_i_deg)
    turn = _nodes(0.0, 360.0, 2 * step_deg, 180.0)
    mesh = np.meshgrid(np.deg2rad(theta_o), np.deg2rad(turn + phi_i_deg), indexing="ij")
    wo = directions.vector_from_spherical(mesh[0].reshape(-1), mesh[1].reshape(-1))
    values, extrapolated = table.evaluate(_incident(theta_i_deg, phi_i_deg), wo)
    shape = len(theta_o), len(turn)
    return Lobe(theta_o, turn, values.reshape(*shape, -1), extrapolated.reshape(shape))


def _incident(theta_i_deg: float, phi_i_deg: float) -> FloatArray:
    return directions.vector_from_spherical(np.deg2rad(theta_i_deg), np.deg2rad(phi_i_deg))


def _nodes(low: float, high: float, step: float, specular: float) -> FloatArray:
    """Evenly spaced from ``low`` to ``high``, and some around ``specular``."""
    even = np.linspace(low, high, int(np.ceil((high - low) / step)) + 1)
    near = np.array(NEAR_DEG)
    every = np.concatenate([even, specular - near, [specular], specular + near])
    # Rounded first: two nodes that differ by rounding are one.
    inside = every[(every >= low) & (every <= high)]
    return np.unique(np.rint(inside * 1e6) / 1e6)
