"""Fresnel reflectance of a facet, as the weights of the terms it splits into."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from fitter.models.pair import Half, Pair


def schlick_weight(p: Pair, h: Half) -> Array:
    """(1 - cos theta_d)^5 of Schlick 1994, F = F0 + (1 - F0) (1 - c)^5.

    1 - c is sin^2/(1 + c) with sin^2(theta_d) = |wi - wo|^2/4: no cancellation near retro-reflection.
    """
    dx, dy, dz = p.ix - p.ox, p.iy - p.oy, p.iz - p.oz
    c = 0.5 * jnp.sqrt(h.squared)
    m = 0.25 * (dx * dx + dy * dy + dz * dz) / (1.0 + c)
    m2 = m * m
    return m2 * m2 * m
