"""Masking-shadowing, returned as V = G / (4 cos_i cos_o): the quotient stays finite at grazing."""

from __future__ import annotations

import math

import jax.numpy as jnp
from jax import Array
from jax.scipy.special import erfc

from fitter.models.pair import Half, Pair


def v_groove(p: Pair, h: Half, alpha: Array, ndf: str) -> Array:
    """Torrance and Sparrow 1967: G = min(1, 2 cos_h cos_i / (h.wi), 2 cos_h cos_o / (h.wo)).

    With H unnormalised h.wi = |H|/2, so that 2 cos_h / (h.wi) = 4 H_z / |H|^2.
    """
    del alpha, ndf
    groove = 4.0 * h.z / h.squared
    shadowed = groove * jnp.minimum(p.iz, p.oz)
    return jnp.minimum(1.0, shadowed) / (4.0 * p.iz * p.oz)


def smith(p: Pair, h: Half, alpha: Array, ndf: str) -> Array:
    """Height-correlated Smith, G = 1 / (1 + Lambda_i + Lambda_o) (Heitz 2014), exact for both NDFs."""
    del h
    if ndf == "ggx":
        # Lambda = (sqrt(1 + alpha^2 tan^2) - 1)/2, times cos: no tangent that overflows at grazing.
        a2 = alpha * alpha

        def root(z: Array, s2: Array) -> Array:
            return jnp.sqrt(z * z + a2 * s2)

        ri = root(p.iz, p.ix * p.ix + p.iy * p.iy)
        ro = root(p.oz, p.ox * p.ox + p.oy * p.oy)
        return 0.5 / (p.iz * ro + p.oz * ri)
    li = _beckmann_lambda_cos(p.iz, p.ix * p.ix + p.iy * p.iy, alpha)
    lo = _beckmann_lambda_cos(p.oz, p.ox * p.ox + p.oy * p.oy, alpha)
    return 0.25 / (p.iz * p.oz + p.oz * li + p.iz * lo)


def _beckmann_lambda_cos(z: Array, s2: Array, alpha: Array) -> Array:
    """Lambda cos(theta) of the Beckmann NDF, Lambda = exp(-a^2)/(2 a sqrt(pi)) - erfc(a)/2, a = cot/alpha.

    Near the normal a -> inf and Lambda -> 0; s2 is guarded because its square root has no slope there.
    """
    s = jnp.sqrt(jnp.maximum(s2, jnp.asarray(1e-30, s2.dtype)))
    # Beyond a = 6, exp(-a^2) < 3e-16: Lambda is below the rounding of 1 + Lambda.
    a = jnp.minimum(z / (alpha * s), 6.0)
    # z/a = alpha s: written so, the first term is finite at z = 0.
    product = jnp.exp(-a * a) * alpha * s / (2.0 * math.sqrt(math.pi)) - 0.5 * z * erfc(a)
    return jnp.where(z < 6.0 * alpha * s, product, jnp.zeros_like(product))


MASKINGS = {"v_groove": v_groove, "smith": smith}
