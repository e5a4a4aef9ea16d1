"""Fresnel reflectance of a facet, unpolarised: Schlick's approximation, exact dielectric, exact conductor.

All are functions of c, the cosine between a direction and the facet's normal (cos theta_d of a pair). The
exact terms are written with n^2 - 1 factored out of the amplitudes (from c^2 - g^2 = 1 - n^2), so that they
keep their digits as n -> 1, where c - g cancels; g = sqrt(n^2 - 1 + c^2) = n cos(theta_t):

    r_s = (1 - n^2) / (c + g)^2,    r_p = (n^2 - 1) (c^2 (n^2 + 1) - 1) / (n^2 c + g)^2.

M. Born and E. Wolf, Principles of Optics, sections 1.5.2 and 14.2. F = (|r_s|^2 + |r_p|^2) / 2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import jax.numpy as jnp
import numpy as np
from jax import Array

from fitter.models.pair import Half, Pair
from fitter.models.parameters import Parameter

F0 = Parameter("f0", "1", 0.0, 1.0, 0.04, "Fresnel reflectance at normal incidence (Schlick)", linear=True)
ETA = Parameter("eta", "1", 1.0, 4.0, 1.5, "refractive index of a dielectric relative to its surroundings")
METAL_ETA = Parameter(
    "eta", "1", 0.01, 10.0, 1.0, "real part of a metal's refractive index", search="log", per_channel=True
)
KAPPA = Parameter(
    "kappa", "1", 0.0, 20.0, 3.0, "extinction coefficient, the index's imaginary part", per_channel=True
)

#: The nonlinear parameters of each term; Schlick's F0 is linear and belongs to the family.
PARAMETERS: Mapping[str, tuple[Parameter, ...]] = {
    "none": (), "schlick": (), "dielectric": (ETA,), "conductor": (METAL_ETA, KAPPA),
}  # fmt: skip

_AVERAGE_NODES = 32


def facet_cosine(h: Half) -> Array:
    """cos theta_d = |H|/2 of a pair of unit vectors."""
    return 0.5 * jnp.sqrt(h.squared)


def schlick_weighted(lobe: Array, p: Pair, h: Half) -> Array:
    """``lobe`` times (1 - cos theta_d)^5 of Schlick 1994, F = F0 + (1 - F0) (1 - c)^5.

    The power by itself leaves float32's range near retro-reflection where its product with a narrow lobe
    does not.
    """
    m = _one_minus_cosine(p, h)
    m2 = m * m
    return lobe * m2 * m2 * m


def schlick_rest(p: Pair, h: Half) -> Array:
    """1 - (1 - c)^5 as c times a sum without differences: 1 - F = (1 - F0) of it."""
    m = _one_minus_cosine(p, h)
    return facet_cosine(h) * (1.0 + m * (1.0 + m * (1.0 + m * (1.0 + m))))


def schlick_average(f0: Array) -> Array:
    """The cosine average 2 int_0^1 F(c) c dc of Schlick's term."""
    return f0 + (1.0 - f0) / 21.0


def _one_minus_cosine(p: Pair, h: Half) -> Array:
    """sin^2/(1 + c) with sin^2(theta_d) = |wi - wo|^2/4: no cancellation near retro-reflection."""
    dx, dy, dz = p.ix - p.ox, p.iy - p.oy, p.iz - p.oz
    return 0.25 * (dx * dx + dy * dy + dz * dz) / (1.0 + facet_cosine(h))


def dielectric(c: Array, eta: Array) -> Array:
    """F of a facet between transparent media; 1 where reflection is total.

    c : cosine between the incident direction and the facet's normal, > 0.
    eta : index of the medium beyond the facet over that of the incident side; may be below 1.
    """
    return _dielectric(c, eta)[0]


def conductor(c: Array, eta: Array, kappa: Array) -> Array:
    """F of a facet of a metal, index eta + i kappa relative to the incident side; c as in :func:`dielectric`.

    kappa = 0 is the dielectric.
    """
    return _conductor(c, eta, kappa)[0]


def exact(fresnel: str | None, values: Mapping[str, Array], c: Array) -> Array:
    """The exact term that a specification names, of a model's nonlinear parameters."""
    return exact_split(fresnel, values, c)[0]


def exact_split(fresnel: str | None, values: Mapping[str, Array], c: Array) -> tuple[Array, Array]:
    """F as :func:`exact` and 1 - F, each with its own digits."""
    if fresnel == "conductor":
        return _conductor(c, values["eta"], values["kappa"])
    assert fresnel == "dielectric", fresnel
    return _dielectric(c, values["eta"])


def _dielectric(c: Array, eta: Array) -> tuple[Array, Array]:
    contrast = (eta - 1.0) * (eta + 1.0)
    eta2 = eta * eta
    g2 = _root_argument(c, eta)
    partial = g2 > 0
    # At the critical angle the root's slope is infinite: total reflection is kept out of it.
    g = jnp.sqrt(jnp.where(partial, g2, 1.0))
    across, along = c + g, eta2 * c + g
    r_s = (contrast / across) / across
    r_p = (contrast / along) * ((c * c * (eta2 + 1.0) - 1.0) / along)
    transmitted = 2.0 * c * g * (1.0 / (across * across) + eta2 / (along * along))
    reflected = jnp.where(partial, _larger(0.5 * (r_s * r_s + r_p * r_p), transmitted), 1.0)
    return reflected, jnp.where(partial, transmitted, 0.0)


def _conductor(c: Array, eta: Array, kappa: Array) -> tuple[Array, Array]:
    """The complex root g = a + ib takes its smaller part from the product a b = eta kappa, since the
    difference of squares that gives it cancels."""
    product = eta * kappa
    k2 = kappa * kappa
    n2_real, n2_imag = (eta - kappa) * (eta + kappa), 2.0 * product
    q = _root_argument(c, eta) - k2
    m2 = q * q + n2_imag * n2_imag
    # m = 0 at the critical angle of a transparent medium alone: there the root has no slope.
    root = m2 > 0
    modulus = jnp.where(root, jnp.sqrt(jnp.where(root, m2, 1.0)), 0.0)
    larger = jnp.sqrt(jnp.where(root, 0.5 * (modulus + jnp.abs(q)), 1.0))
    smaller = jnp.where(root, product / larger, 0.0)
    larger = jnp.where(root, larger, 0.0)
    a, b = jnp.where(q >= 0, larger, smaller), jnp.where(q >= 0, smaller, larger)
    c2 = c * c
    across2 = _modulus2(c + a, b)
    along2 = _modulus2(c * n2_real + a, c * n2_imag + b)
    brewster2 = _modulus2(c2 * (n2_real + 1.0) - 1.0, c2 * n2_imag)
    # Amplitudes, squared last: at grazing as n -> 1 the slopes of their quotients' squares overflow.
    across, along = jnp.sqrt(across2), jnp.sqrt(along2)
    r_s = _modulus2((eta - 1.0) / across, kappa / across) * _modulus2((eta + 1.0) / across, kappa / across)
    r_p = _modulus2((eta - 1.0) / along, kappa / along) * _modulus2((eta + 1.0) / along, kappa / along)
    reflected = 0.5 * (r_s + r_p * brewster2)
    # Re(n^2 conj(g)) = a (|g|^2 + sin^2): without a difference.
    transmitted = 2.0 * c * a * (1.0 / across2 + (modulus + _sin2(c)) / along2)
    return _larger(reflected, transmitted), transmitted


def _sin2(c: Array) -> Array:
    return (1.0 - c) * (1.0 + c)


def _root_argument(c: Array, eta: Array) -> Array:
    """eta^2 - sin^2 by the sum that doesn't cancel: as it stands for c -> 1, (eta^2 - 1) + c^2 for c -> 0."""
    return jnp.where(c * c > 0.5, eta * eta - _sin2(c), (eta - 1.0) * (eta + 1.0) + c * c)


def _larger(reflected: Array, transmitted: Array) -> Array:
    """F from whichever of F and 1 - F is small: the slope of F near 1 is that of 1 - F, as digits go."""
    return jnp.where(transmitted < 0.5, 1.0 - transmitted, reflected)


def cosine_average(reflectance: Callable[[Array], Array], like: Array) -> Array:
    """2 int_0^1 F(c) c dc, in the shape and dtype of the parameter ``like``.

    32-point Gauss-Legendre; to 1e-5 or better (the square root at the critical angle is what limits it).
    """
    nodes, weights = np.polynomial.legendre.leggauss(_AVERAGE_NODES)
    shape = (_AVERAGE_NODES,) + (1,) * jnp.ndim(like)
    c = jnp.asarray(0.5 * (1.0 + nodes), like.dtype).reshape(shape)
    w = jnp.asarray(0.5 * weights, like.dtype).reshape(shape)
    return jnp.sum(2.0 * w * c * reflectance(c), axis=0)


def _modulus2(real: Array, imaginary: Array) -> Array:
    return real * real + imaginary * imaginary
