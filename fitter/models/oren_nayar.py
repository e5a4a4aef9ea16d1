"""Oren-Nayar: a rough surface of Lambertian facets, four forms.

With xx = xi xo + yi yo, sin theta = sqrt(x^2 + y^2), cos theta = z, a and b the larger and the smaller of the
two polar angles and dphi the difference of azimuths, so that cos dphi sin a sin b = xx:

qualitative (M. Oren and S. Nayar 1994, eq. 30), sigma in rad, s2 = sigma^2, no angles needed:
    rho/pi (A + B max(0, xx)/max(zi, zo)),  A = 1 - 0.5 s2/(s2 + 0.33),  B = 0.45 s2/(s2 + 0.09).
    Exceeds an albedo of 1 by up to 1.5 % at grazing for rho = 1.

full (same paper, eqs 27 to 29, with one interreflection): L1 + L2,
    L1 = rho/pi [A + cos dphi C2 tan b + (1 - |cos dphi|) C3 tan((a + b)/2)]
    C2 = B (sin a - (2b/pi)^3 [cos dphi < 0]),  C3 = 0.125 s2/(s2 + 0.09) (4ab/pi^2)^2
    L2 = 0.17 rho^2/pi s2/(s2 + 0.13) (1 - cos dphi (2b/pi)^2).
    Exceeds 1 by up to 5.1 %. As published, L1 is negative between opposed directions near grazing for sigma
    above 0.67 rad: it is not clamped here.

fujii (Y. Fujii's improvement, 2012), sigma dimensionless in 0..1:
    rho/pi A_F (1 + sigma xx/t),  t = max(zi, zo) where xx > 0 and 1 elsewhere,
    A_F = 1/(1 + k1 sigma),  k1 = 1/2 - 2/(3 pi).  Loses energy: up to 22 % at rho = sigma = 1.

eon (J. Portsmouth, P. Kutz, S. Hill, JCGT 14(1), 2025): fujii plus what it loses,
    rho_ms/pi (1 - E(wi))(1 - E(wo))/(1 - <E>),  rho_ms = rho^2 <E>/(1 - rho (1 - <E>)),
    E = A_F (1 + sigma G/pi) the exact albedo of fujii at rho = 1, <E> = A_F (1 + k2 sigma) its cosine
    average, k2 = 2/3 - 28/(15 pi), G = sin (theta - sin cos) + 2/3 (sin (1 - sin^3)/cos - sin).
    An albedo of exactly 1 for rho = 1; at most 1 for rho up to 1.

All are reciprocal, continuous, with kinks at a = b, xx = 0 and, in full, dphi = 0 or pi.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from fitter.models.base import SeparableModel
from fitter.models.lobes import CosineLobe, Lobe
from fitter.models.pair import Pair
from fitter.models.parameters import Parameter
from fitter.models.span import Span
from fitter.spec import ModelSpec

RHO = Parameter("rho", "1", 0.0, math.inf, 0.5, "albedo of the facets", linear=True)
RHO_BOUNDED = Parameter("rho", "1", 0.0, 1.0, 0.5, "albedo of the facets, at most 1", linear=True)
SIGMA = Parameter(
    "sigma", "rad", 0.0, math.pi / 2, 0.3, "standard deviation of the facets' slope angle; 0 is Lambertian"
)
ROUGHNESS = Parameter("sigma", "1", 0.0, 1.0, 0.3, "roughness of the facets; 0 is Lambertian")

_K1 = 1 / 2 - 2 / (3 * math.pi)
_K2 = 2 / 3 - 28 / (15 * math.pi)


class OrenNayar(SeparableModel):
    family: ClassVar[str] = "oren_nayar"

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        return (
            RHO_BOUNDED if spec.variant == "eon" else RHO,
            ROUGHNESS if spec.variant in ("fujii", "eon") else SIGMA,
        )

    @staticmethod
    def terms(spec: ModelSpec, nonlinear: Mapping[str, Array], p: Pair) -> tuple[Array, ...]:
        above = p.above
        p = p.lifted()
        sigma = nonlinear["sigma"]
        found: tuple[Array, ...]
        if spec.variant == "full":
            found = _full(sigma, p)
        elif spec.variant == "fujii":
            found = (_fujii(sigma, p),)
        elif spec.variant == "eon":
            found = (_fujii(sigma, p), _compensation(sigma, p))
        else:
            found = (_qualitative(sigma, p),)
        return tuple(jnp.where(above, term, 0.0) for term in found)

    @classmethod
    def coefficients(
        cls, spec: ModelSpec, linear: Mapping[str, Array], nonlinear: Mapping[str, Array]
    ) -> tuple[Array, ...]:
        rho = linear["rho"]
        if spec.variant == "full":
            return rho, rho * rho
        if spec.variant == "eon":
            sigma = nonlinear["sigma"]
            scale = 1.0 / (1.0 + _K1 * sigma)
            # 1 - <E> as its own product: the difference has no digits left at sigma = 0.
            average, missing = scale * (1.0 + _K2 * sigma), scale * (_K1 - _K2) * sigma
            return rho, rho * rho * average / (1.0 - rho * missing)
        return (rho,)

    @classmethod
    def linear_from(
        cls, spec: ModelSpec, coefficients: Sequence[Array], nonlinear: Mapping[str, Array]
    ) -> dict[str, Array]:
        return {"rho": coefficients[0]}

    @staticmethod
    def coefficients_are_free(spec: ModelSpec) -> bool:
        return spec.variant not in ("full", "eon")

    @staticmethod
    def span(spec: ModelSpec) -> Span | None:
        # Every term is c(sigma) + d(sigma) times a function of the directions, or one of the two: the normal,
        # and straight back at 45 deg, tell them apart.
        smooth, rough = (((SIGMA.name, value),) for value in (0.0, 1.0))
        return Span("all", ((0.0, 0.0, 0.0), (math.pi / 4, 0.0, 0.0)), (smooth, rough))

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        return [(CosineLobe(), jnp.ones((), values["sigma"].dtype))]


def _qualitative(sigma: Array, p: Pair) -> Array:
    s2 = sigma * sigma
    inner = p.ix * p.ox + p.iy * p.oy
    # where, not maximum: at the kinks its slope is that of one side, not the mean of both.
    forward = jnp.where(inner > 0, inner, 0.0) / jnp.where(p.iz > p.oz, p.iz, p.oz)
    return (_level(s2) + 0.45 * s2 / (s2 + 0.09) * forward) / math.pi


def _level(s2: Array) -> Array:
    return 1.0 - 0.5 * s2 / (s2 + 0.33)


def _full(sigma: Array, p: Pair) -> tuple[Array, Array]:
    """L1/rho and L2/rho^2."""
    s2 = sigma * sigma
    q = s2 / (s2 + 0.09)
    sin_i, sin_o = _sine(p.ix, p.iy), _sine(p.ox, p.oy)
    # tan_i > tan_o: z can't tell two directions near the normal apart, nor the angles two near grazing.
    i_is_a = sin_i * p.oz > sin_o * p.iz
    sin_a, sin_b = jnp.where(i_is_a, sin_i, sin_o), jnp.where(i_is_a, sin_o, sin_i)
    cos_a, cos_b = jnp.where(i_is_a, p.iz, p.oz), jnp.where(i_is_a, p.oz, p.iz)
    a, b = jnp.arctan2(sin_a, cos_a), jnp.arctan2(sin_b, cos_b)
    inner = p.ix * p.ox + p.iy * p.oy

    # cos dphi C2 tan b; where cos dphi < 0 C2 takes sin a - (2b/pi)^3 for sin a, at grazing by complements.
    sine = jnp.where(sin_a > 0, sin_a, 1.0)
    rest = 2 / math.pi * jnp.arctan2(cos_b, sin_b)
    shortfall = jnp.where(
        cos_b < 0.5,
        rest * (3.0 - rest * (3.0 - rest)) - cos_a * cos_a / (1.0 + sin_a),
        sin_a - (2 * b / math.pi) ** 3,
    )
    plane = 0.45 * q * inner * jnp.where(inner < 0, shortfall / sine, 1.0) / cos_b

    # 1 - |cos dphi| = sin^2 dphi/(1 + |cos dphi|) without cancellation, both 0 where an azimuth is undefined.
    (ux, uy), (vx, vy) = _azimuth(p.ix, p.iy, sin_i), _azimuth(p.ox, p.oy, sin_o)
    cos_dphi, sin_dphi = ux * vx + uy * vy, ux * vy - uy * vx
    turn = sin_dphi * sin_dphi / (1.0 + jnp.abs(cos_dphi))
    c3 = 0.125 * q * (4 * a * b / math.pi**2) ** 2
    # tan((a + b)/2) = (sin a + sin b)/(cos a + cos b).
    across = turn * c3 * (sin_a + sin_b) / (cos_a + cos_b)

    bounce = 0.17 * s2 / (s2 + 0.13) * (1.0 - cos_dphi * (2 * b / math.pi) ** 2)
    return (_level(s2) + plane + across) / math.pi, bounce / math.pi


def _fujii(sigma: Array, p: Pair) -> Array:
    inner = p.ix * p.ox + p.iy * p.oy
    t = jnp.where(inner > 0, jnp.where(p.iz > p.oz, p.iz, p.oz), 1.0)
    return (1.0 + sigma * inner / t) / (math.pi * (1.0 + _K1 * sigma))


def _compensation(sigma: Array, p: Pair) -> Array:
    """(1 - E(wi))(1 - E(wo))/(pi (1 - <E>)), all three factors divided by A_F sigma: regular at sigma = 0."""
    scale = sigma / (math.pi * (_K1 - _K2) * (1.0 + _K1 * sigma))
    return scale * _missing(p.ix, p.iy, p.iz) * _missing(p.ox, p.oy, p.oz)


def _missing(x: Array, y: Array, z: Array) -> Array:
    """(1 - E)/(A_F sigma) = k1 - G/pi, accurate where E -> 1 at grazing and flat at the normal."""
    s = _sine(x, y)
    near = z > 0.5
    # G near the normal, with 1 - z = s^2/(1 + z).
    mu = jnp.where(near, z, 1.0)
    g = s * (jnp.arctan2(s, mu) - s * mu) + 2 / 3 * s * s * s * (1.0 / (1.0 + mu) - s) / mu
    # pi k1 - G elsewhere, with 1 - s = z^2/(1 + s) and the complement of theta: every term is small at z = 0.
    mu, t = jnp.where(near, 0.5, z), jnp.where(near, 1.0, s)
    complement = jnp.arctan2(mu, t)
    rest = math.pi * _K1 * mu * mu + t * (1.0 + t) * (complement + t * mu)
    rest = rest - 2 / 3 * mu * t * (1.0 + t + t * t)
    return jnp.where(near, _K1 - g / math.pi, rest / (math.pi * (1.0 + t)))


def _sine(x: Array, y: Array) -> Array:
    """sqrt(x^2 + y^2), with slope 0 where it vanishes."""
    s2 = x * x + y * y
    # The slope of a quotient by the root needs 1/s2: not beyond what the type holds.
    some = s2 > 100 * float(jnp.finfo(s2.dtype).tiny)
    return jnp.where(some, jnp.sqrt(jnp.where(some, s2, 1.0)), 0.0)


def _azimuth(x: Array, y: Array, sine: Array) -> tuple[Array, Array]:
    """Cosine and sine of the azimuth; both 0 at the normal."""
    some = sine > 0
    safe = jnp.where(some, sine, 1.0)
    return jnp.where(some, x / safe, 0.0), jnp.where(some, y / safe, 0.0)
