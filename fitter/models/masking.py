"""Masking-shadowing, returned as V = G / (4 cos_i cos_o): the quotient stays finite at grazing."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import jax.numpy as jnp
from jax import Array

from fitter.models.ndf import GGX, NDF, Beckmann
from fitter.models.pair import Half, Pair
from fitter.models.roughness import Isotropic


def v_groove(p: Pair, h: Half, ndf: NDF) -> Array:
    """Torrance and Sparrow 1967: G = min(1, 2 cos_h cos_i / (h.wi), 2 cos_h cos_o / (h.wo)).

    With H unnormalised h.wi = |H|/2, so that 2 cos_h / (h.wi) = 4 H_z / |H|^2.
    """
    del ndf
    shadowed = 4.0 * h.z * jnp.minimum(p.iz, p.oz) < h.squared
    # G's own min(cos_i, cos_o) is cancelled against the denominator: at grazing their slopes would.
    lit = 0.25 / jnp.where(shadowed, 1.0, p.iz * p.oz)
    return jnp.where(shadowed, h.z / (h.squared * jnp.maximum(p.iz, p.oz)), lit)


def smith(p: Pair, h: Half, ndf: NDF) -> Array:
    """Height-correlated Smith, G = 1 / (1 + Lambda_i + Lambda_o) (Heitz 2014)."""
    del h
    li, lo = ndf.lambda_cos(p.ix, p.iy, p.iz), ndf.lambda_cos(p.ox, p.oy, p.oz)
    return 0.25 / (p.iz * p.oz + p.oz * li + p.iz * lo)


def smith_separable(p: Pair, h: Half, ndf: NDF) -> Array:
    """Separable Smith, G = 1 / ((1 + Lambda_i) (1 + Lambda_o)) (B. Smith 1967; Walter et al. 2007)."""
    del h
    li, lo = ndf.lambda_cos(p.ix, p.iy, p.iz), ndf.lambda_cos(p.ox, p.oy, p.oz)
    return 0.25 / ((p.iz + li) * (p.oz + lo))


def schlick_ggx(p: Pair, h: Half, ndf: NDF) -> Array:
    """C. Schlick 1994 with the k of B. Karis 2013: G = prod c / (c (1 - k) + k), k = alpha/2 of GGX."""
    del h
    alpha = _isotropic(ndf)
    return 0.25 / (alpha * alpha * _schlick(p.iz, alpha) * _schlick(p.oz, alpha))


def _schlick(c: Array, alpha: Array) -> Array:
    """(c (1 - k) + k) / alpha."""
    return c / alpha + 0.5 * (1.0 - c)


def _isotropic(ndf: NDF) -> Array:
    assert isinstance(ndf, GGX), ndf
    assert isinstance(ndf.roughness, Isotropic), ndf
    return ndf.roughness.alpha


def rational(p: Pair, h: Half, ndf: NDF) -> Array:
    """Walter et al. 2007, eq. 27, for Beckmann, separable: with a = cos/(alpha sin),

    G1 = (3.535 a + 2.181 a^2) / (1 + 2.276 a + 2.577 a^2) for a < 1.6, else 1: a step of 6e-5 there.
    """
    del h
    assert isinstance(ndf, Beckmann), ndf
    return 0.25 * _rational(p.ix, p.iy, p.iz, ndf) * _rational(p.ox, p.oy, p.oz, ndf)


def _rational(x: Array, y: Array, z: Array, ndf: Beckmann) -> Array:
    """G1 / cos."""
    p2 = ndf.roughness.projected2(x, y)
    p = jnp.sqrt(jnp.maximum(p2, float(jnp.finfo(p2.dtype).tiny)))
    lit = z >= 1.6 * p
    p = jnp.where(lit, 1.0, p)
    a = jnp.where(lit, 1.0, z) / p
    # a/cos = 1/p: finite at grazing.
    return jnp.where(
        lit, 1.0 / jnp.where(lit, z, 1.0), (3.535 + 2.181 * a) / (p * (1.0 + a * (2.276 + 2.577 * a)))
    )


MASKINGS: Mapping[str, Callable[[Pair, Half, NDF], Array]] = {
    "v_groove": v_groove, "smith": smith, "smith_separable": smith_separable, "schlick_ggx": schlick_ggx,
    "rational": rational,
}  # fmt: skip


def facets(masking: str | None, p: Pair, h: Half, ndf: NDF) -> Array:
    """D G / (4 cos_i cos_o), finite at grazing; masking None is that of V-grooves.

    At grazing D of GGX rises as the square of the roughness and Smith's G / (4 cos_i cos_o) falls so: the
    powers are cancelled here, since in the slope with respect to the roughness their digits would be.
    """
    if isinstance(ndf, GGX) and masking in ("smith", "smith_separable"):
        unit, scaled = ndf.scaled(p)
        return ndf.scaled_density(h) * MASKINGS[masking](scaled, h, unit)
    if masking == "schlick_ggx" and isinstance(ndf, GGX):
        alpha = _isotropic(ndf)
        return ndf.scaled_density(h) * (0.25 / (_schlick(p.iz, alpha) * _schlick(p.oz, alpha)))
    return ndf.density(h, MASKINGS[masking or "v_groove"](p, h, ndf))
