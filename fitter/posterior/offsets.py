"""Angle offsets of the instrument: what a stage that is a little off does to all directions of a table.

Three angles have one each: theta_i, theta_o, and the azimuth between the two. A table with all directions in
the plane of incidence comes from an arm whose theta_o has a sign, and an offset moves both sides of the
normal the same way; elsewhere theta is counted from the normal. Directions are turned exactly, not to first
order.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Values = Array | FloatArray
#: The angles that can be off, in the order of their offsets. In the plane of incidence phi has no first-order
#: effect and is left out.
ANGLES = ("theta_i", "theta_o", "phi")
#: Bounds of an offset, in standard uncertainties: beyond the prior's mass, so that nothing is cut off.
FARTHEST = 8.0


def tangents(pair: FloatArray, *, signed: bool) -> FloatArray:
    """(6, n) unit derivatives of wi with theta_i and of wo with theta_o, of pairs (6, n).

    signed : theta_o counts positive on the specular side of the normal, negative on that of the light.
    """
    wi, wo = pair[:3], pair[3:]
    incident, scattered = _azimuth(wi), _azimuth(wo)
    # On the normal a direction has no azimuth: it moves in the plane of incidence, away from its partner.
    partner = np.where(np.isnan(scattered), [[1.0], [0.0]], -scattered)
    incident = np.where(np.isnan(incident), partner, incident)
    scattered = np.where(np.isnan(scattered), -incident, scattered)
    found = [_tangent(wi, incident), _tangent(wo, scattered)]
    if signed:
        found[1] = found[1] * np.where((incident * scattered).sum(axis=0) > 0, -1.0, 1.0)
    return np.concatenate(found)


def shifted(pair: Values, tangent: Values, offsets: Values) -> Array:
    """Pairs (6, n) seen with these offsets (2 or 3,) in radians; no direction comes near the horizon that was
    not."""
    cos, sin = jnp.cos(offsets), jnp.sin(offsets)
    wi = pair[:3] * cos[0] + tangent[:3] * sin[0]
    wo = pair[3:] * cos[1] + tangent[3:] * sin[1]
    x, y = wo[0], wo[1]
    if len(offsets) == 3:
        x, y = cos[2] * x - sin[2] * y, sin[2] * x + cos[2] * y
    # A measured direction is above the horizon, whatever the offset says of it.
    return jnp.stack(
        [wi[0], wi[1], jnp.maximum(wi[2], 0.5 * pair[2]), x, y, jnp.maximum(wo[2], 0.5 * pair[5])]
    )


def _azimuth(w: FloatArray) -> FloatArray:
    """(2, n) unit vectors of the azimuths, NaN on the normal."""
    length = np.hypot(w[0], w[1])
    return w[:2] / np.where(length > 1e-9, length, np.nan)


def _tangent(w: FloatArray, azimuth: FloatArray) -> FloatArray:
    return np.stack([w[2] * azimuth[0], w[2] * azimuth[1], -np.hypot(w[0], w[1])])
