"""Quadrature over the slopes of microfacets: their densities, and rules that grade towards small slopes."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
from jax import Array


def density(kind: str, rho2: Array) -> Array:
    """Density of slopes in units of the roughness, rho^2 their square: alpha^2 D cos^4 of the NDF."""
    if kind == "beckmann":
        return jnp.exp(-rho2) / math.pi
    if kind != "ggx":
        raise ValueError(f"the slopes of {kind!r} are not known")
    inverse = 1.0 / (1.0 + rho2)
    return inverse * inverse / math.pi


def gauss(count: int, like: Array) -> tuple[Array, Array]:
    """Nodes and weights (count,) of Gauss and Legendre on [0, 1], in the dtype of ``like``."""
    x, w = np.polynomial.legendre.leggauss(count)
    return jnp.asarray(0.5 * (x + 1.0), like.dtype), jnp.asarray(0.5 * w, like.dtype)


def clustered(count: int, like: Array) -> tuple[Array, Array]:
    """As :func:`gauss`, closer together at both ends, for azimuths: near grazing all happens within an
    angle of about cos(theta) of a right angle."""
    x, w = np.polynomial.legendre.leggauss(count)
    x = 0.5 * (x + 1.0)
    return jnp.asarray(x * x * (3.0 - 2.0 * x), like.dtype), jnp.asarray(3.0 * x * (1.0 - x) * w, like.dtype)


def graded(start: Array, end: Array, x: Array, w: Array) -> tuple[Array, Array]:
    """Nodes and weights on [start, end] of a rule on [0, 1], even in asinh: even up to 1, then geometric."""
    low = jnp.arcsinh(start)
    width = jnp.arcsinh(end) - low
    at = low + width * x
    return jnp.sinh(at), width * w * jnp.cosh(at)
