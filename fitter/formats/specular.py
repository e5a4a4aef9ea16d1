"""Polar coordinates about the specular direction, as Zemax, Integra and SSDD files use them.

``radial`` is the angle from the specular direction; ``azimuth`` turns about it, 0 where the way leads from
the specular direction to the surface normal, counter-clockwise as seen from outside (R. Rykowski, "BSDF data
interchange file format specification", 2008). The light is at (theta_i, phi_i), so the specular direction is
at phi_i + pi. All angles are radians.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitter import directions

FloatArray = NDArray[np.float64]


def outgoing(theta_s: ArrayLike, phi_i: ArrayLike, radial: ArrayLike, azimuth: ArrayLike) -> FloatArray:
    """Unit vectors (..., 3); ``theta_s`` is the specular direction's polar angle, theta_i for a mirror."""
    pole, zero, quarter = _frame(theta_s, phi_i)
    radial, azimuth = np.asarray(radial, np.float64)[..., None], np.asarray(azimuth, np.float64)[..., None]
    return np.cos(radial) * pole + np.sin(radial) * (np.cos(azimuth) * zero + np.sin(azimuth) * quarter)


def coordinates(theta_s: ArrayLike, phi_i: ArrayLike, wo: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``(radial, azimuth)`` of directions ``wo`` (..., 3), azimuth in (-pi, pi]; inverse of ``outgoing``."""
    pole, zero, quarter = ((axis * wo).sum(axis=-1) for axis in _frame(theta_s, phi_i))
    return np.arctan2(np.hypot(zero, quarter), pole), np.arctan2(quarter, zero)


def _frame(theta_s: ArrayLike, phi_i: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    theta, phi = np.broadcast_arrays(np.asarray(theta_s, np.float64), np.asarray(phi_i, np.float64) + np.pi)
    pole = directions.vector_from_spherical(theta, phi)
    # At normal incidence the limit of tilting the light towards phi_i.
    zero = directions.vector_from_spherical(theta - np.pi / 2, phi)
    quarter = directions.vector_from_spherical(np.pi / 2, phi - np.pi / 2)
    return pole, zero, quarter
