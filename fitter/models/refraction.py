"""Refraction at an interface of two transparent media: what ideal and rough dielectrics share.

The surface has the medium of index 1 above (+z) and of index eta below (-z). All cosines are positive,
indices are those of the side of wi (n_i) and of the side of wo (n_o). With both cosines known the transmitted
share needs neither the root of Snell's law nor a difference (from t_s = 1 + r_s, t_p = (1 + r_p) n_i/n_o):

    T = 1 - F = 2 n_i n_o c_i c_o [1/(n_i c_i + n_o c_o)^2 + 1/(n_o c_i + n_i c_o)^2].

It is the share of *power*; the same for light on the way back. M. Born and E. Wolf, Principles of Optics,
section 1.5.3.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from fitter.models.pair import Half, Pair
from fitter.models.parameters import Parameter

ETA = Parameter("eta", "1", 0.4, 2.5, 1.5, "refractive index below the surface over that above it")
KT = Parameter("kt", "1", 0.0, math.inf, 1.0, "scale of what is transmitted; 1 is lossless", linear=True)
KS = Parameter("ks", "1", 0.0, math.inf, 1.0, "scale of what is reflected; 1 is lossless", linear=True)

#: By how much the ladder of :func:`opposed_masking` climbs, and Stirling's series from there:
#: B_2k / (2k (2k - 1)), whose first term left out is 2e-17 at 9.
_RUNGS = 7
_STIRLING = (
    1 / 12, -1 / 360, 1 / 1260, -1 / 1680, 1 / 1188, -691 / 360360, 1 / 156, -3617 / 122400,
)  # fmt: skip


def indices(above: Array, eta: Array) -> tuple[Array, Array]:
    """(n_i, n_o) of what crosses the surface from above (True) or from below."""
    one = jnp.ones_like(eta)
    return jnp.where(above, one, eta), jnp.where(above, eta, one)


def transmittance(ci: Array, co: Array, ni: Array, no: Array) -> Array:
    """The share of power that a smooth facet transmits, of its cosines with wi and wo; not both 0."""
    across, along = ni * ci + no * co, no * ci + ni * co
    return 2.0 * ni * no * ci * co * (1.0 / (across * across) + 1.0 / (along * along))


def refracted_cosine(c: Array, s2: Array, ni: Array, no: Array) -> tuple[Array, Array]:
    """Snell's law: the cosine beyond the interface, for cosine c and sin^2 s2 before it, and if there is one.

    1 where reflection is total: the root is kept out of the gradient.
    """
    # By whichever sum doesn't cancel as n_i -> n_o.
    root2 = jnp.where(c * c > 0.5, no * no - ni * ni * s2, (no - ni) * (no + ni) + ni * ni * c * c)
    partial = root2 > 0
    return jnp.where(partial, jnp.sqrt(jnp.where(partial, root2, 1.0)) / no, 1.0), partial


def opposed_masking(li: Array, lo: Array, times: Array | float = 1.0) -> Array:
    """Joint over separable masking of directions on *opposite* sides of Smith's surface.

    With uncorrelated heights a point of height quantile u is seen from above with probability u^L_i and from
    below with (1 - u)^L_o: G = B(1 + L_i, 1 + L_o) (E. Heitz et al. 2016, "Multiple-scattering microfacet
    BSDFs with the Smith model"), where directions on one side have 1/(1 + L_i + L_o). Returned is
    G (1 + L_i) (1 + L_o) = Gamma(2 + L_i) Gamma(2 + L_o) / Gamma(2 + L_i + L_o), in (0, 1], times a factor (a
    large one belongs inside: the product may be a normal number where G underflows).

    Differences of log Gamma lose all digits at Lambda = 1e6 (grazing): Stirling's formula with its
    logarithms combined doesn't. Relative error below 1e-14 in float64 where the result is above 1e-30.
    """
    large, small = jnp.maximum(li, lo), jnp.minimum(li, lo)
    x, y = 2.0 + _RUNGS + large, 2.0 + _RUNGS + small
    total = x + small
    log = (
        -(x - 0.5) * jnp.log1p(small / x)
        - small * jnp.log1p(large / y)
        + (_RUNGS + 1.5) * jnp.log(y)
        + (0.5 * math.log(2.0 * math.pi) - (2.0 + _RUNGS))
        + stirling(x) + stirling(y) - stirling(total)
    )  # fmt: skip
    # Gamma(z) = Gamma(z + rungs) / (z (z + 1) ...), one quotient at a time: none over- or underflows.
    root = jnp.exp(0.5 * log)
    ratio = root
    for k in range(_RUNGS):
        ratio = ratio * (2.0 + k + large + small) / ((2.0 + k + large) * (2.0 + k + small))
    return ratio * times * root


def stirling(x: Array) -> Array:
    """log Gamma(x) - ((x - 1/2) log x - x + log(2 pi)/2), x >= 9."""
    z = 1.0 / (x * x)
    total = jnp.full_like(x, _STIRLING[-1])
    for coefficient in reversed(_STIRLING[:-1]):
        total = total * z + coefficient
    return total / x


def seen_from_above(p: Pair) -> tuple[Pair, Array]:
    """The pair mirrored in the surface where wi lies below it, and whether wi lay above."""
    above = p.iz > 0
    return Pair(p.ix, p.iy, jnp.abs(p.iz), p.ox, p.oy, jnp.where(above, p.oz, -p.oz)), above


class Crossing(NamedTuple):
    """The facet that refracts wi (above) into wo (below), all harmless where ``ok`` is False.

    h : its normal, turned up, not normalised; ci, co : cosines of wi and wo with it, positive.
    jacobian : d omega_h / d omega_o = n_o^2 |wo.h| / (n_i wi.h + n_o wo.h)^2 (Walter et al. 2007, eq. 17).
    """

    ok: Array
    h: Half
    ci: Array
    co: Array
    jacobian: Array

    @staticmethod
    def of(p: Pair, ni: Array, no: Array) -> Crossing:
        # n_i wi + n_o wo: for indices near 1 the small difference is between stored numbers, thus exact.
        contrast = ni - no
        x, y, z = (
            contrast * i + no * (i + o) for i, o in ((p.ix, p.ox), (p.iy, p.oy), (p.iz, p.oz))
        )  # fmt: skip
        squared = x * x + y * y + z * z
        x, y = (jnp.where(z >= 0, w, -w) for w in (x, y))
        z = jnp.abs(z)
        ci, co = p.ix * x + p.iy * y + p.iz * z, -(p.ox * x + p.oy * y + p.oz * z)
        ok = (p.iz > 0) & (p.oz < 0) & (z != 0) & (ci > 0) & (co > 0)
        pick = lambda value, harmless: jnp.where(ok, value, jnp.full_like(value, harmless))  # noqa: E731
        h = Half(pick(x, 0.0), pick(y, 0.0), pick(z, 1.0), pick(squared, 1.0))
        length = jnp.sqrt(h.squared)
        ci, co = pick(ci, 1.0) / length, pick(co, 1.0) / length
        return Crossing(ok, h, ci, co, no * no * co / h.squared)
