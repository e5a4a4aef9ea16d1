"""Ashikhmin-Shirley: an anisotropic Phong lobe of half vectors under a diffuse term that gives way to it.

M. Ashikhmin and P. Shirley, "An anisotropic Phong BRDF model", Journal of Graphics Tools 5(2), 2000. With H
the unnormalised half vector, x and y in the frame turned by psi, c = cos theta_d and S = (1 - c)^5,

    specular  sqrt((nu + 1)(nv + 1))/(8 pi) cos^e theta_h (rs + (1 - rs) S) / (c max(cos_i, cos_o)),
              e = (nu Hx^2 + nv Hy^2)/(Hx^2 + Hy^2)
    diffuse   28 rd/(23 pi) (1 - rs) (1 - (1 - cos_i/2)^5) (1 - (1 - cos_o/2)^5).

The exponent has no value at H = n; cos^e does, for with t = tan^2 theta_h its logarithm is
-(nu Hx^2 + nv Hy^2)/(2 Hz^2) log(1 + t)/t. Reciprocal; nu = nv is isotropic. Kink: cos_i = cos_o.

The specular term is linear in rs, the diffuse bilinear in rd and rs: three coefficients of two parameters.
Sampling is the paper's: the specular part of a weight is at most F over its share of the draws.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from fitter.models.base import SeparableModel, quotient
from fitter.models.diffuse import KD
from fitter.models.fresnel import schlick_average, schlick_weighted
from fitter.models.lobes import CosineLobe, Lobe, upper_half
from fitter.models.pair import Half, Pair
from fitter.models.parameters import Parameter
from fitter.models.phong_lobe import EXPONENT
from fitter.models.roughness import PSI, turned
from fitter.spec import ModelSpec

RD = dataclasses.replace(KD, name="rd", description="diffuse reflectance under the specular layer")
RS = Parameter("rs", "1", 0.0, 1.0, 0.04, "specular reflectance at normal incidence", linear=True)
NU = dataclasses.replace(EXPONENT, name="nu", description="exponent along the direction psi")
NV = dataclasses.replace(EXPONENT, name="nv", description="exponent across the direction psi")


class AshikhminShirley(SeparableModel):
    family: ClassVar[str] = "ashikhmin_shirley"

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        del spec
        return (RD, RS, NU, NV, PSI)

    @staticmethod
    def isotropic(spec: ModelSpec) -> bool:
        del spec
        return False

    @staticmethod
    def terms(spec: ModelSpec, nonlinear: Mapping[str, Array], p: Pair) -> tuple[Array, ...]:
        del spec
        above = p.above
        p = p.lifted()
        h = Half.of(p)
        facets = HalfVectorPower(nonlinear["nu"], nonlinear["nv"], nonlinear["psi"])
        diffuse = 28 / (23 * math.pi) * _filled(p.iz) * _filled(p.oz)
        # c max(cos_i, cos_o) with c = |H|/2; where, not maximum: at the tie the slope is that of one side.
        larger = jnp.where(p.iz > p.oz, p.iz, p.oz)
        specular = facets.density(h) / (2.0 * jnp.sqrt(h.squared) * larger)
        terms = (diffuse, specular, schlick_weighted(specular, p, h))
        return tuple(jnp.where(above, term, 0.0) for term in terms)

    @classmethod
    def coefficients(
        cls, spec: ModelSpec, linear: Mapping[str, Array], nonlinear: Mapping[str, Array]
    ) -> tuple[Array, ...]:
        rest = 1.0 - linear["rs"]
        return linear["rd"] * rest, linear["rs"], rest

    @classmethod
    def linear_from(
        cls, spec: ModelSpec, coefficients: Sequence[Array], nonlinear: Mapping[str, Array]
    ) -> dict[str, Array]:
        diffuse, rs, rest = coefficients
        # Under a perfect mirror the diffuse term means nothing: 0 keeps it finite.
        return {"rd": quotient(diffuse, rest), "rs": rs}

    @staticmethod
    def coefficients_are_free(spec: ModelSpec) -> bool:
        del spec
        return False

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        del spec
        rd, rs = values["rd"], values["rs"]
        each = jnp.broadcast_arrays(*(jnp.atleast_1d(values[name]) for name in ("nu", "nv", "psi")))
        share = jnp.mean(schlick_average(rs)) / len(each[0])
        found: list[tuple[Lobe, Array]] = [
            (HalfVectorPower(nu, nv, psi), share) for nu, nv, psi in zip(*each, strict=True)
        ]
        return [*found, (CosineLobe(), jnp.mean(rd * (1.0 - rs)))]


class HalfVectorPower(eqx.Module):
    """Half vectors of density sqrt((nu + 1)(nv + 1))/(2 pi) cos^e theta_h: the paper's eqs 6 and 8 to 10."""

    nu: Array
    nv: Array
    psi: Array

    def density(self, h: Half) -> Array:
        """Per unit solid angle of h, for half vectors above the horizon."""
        x, y = turned(self.psi, h.x, h.y)
        x, y = x / h.z, y / h.z
        t = x * x + y * y
        # log(1 + t)/t, whose own slope cancels for small t.
        small = t < 1e-5
        safe = jnp.where(small, 1.0, t)
        ratio = jnp.where(small, 1.0 - t * (0.5 - t / 3.0), jnp.log1p(safe) / safe)
        power = jnp.exp(-0.5 * ratio * (self.nu * x * x + self.nv * y * y))
        return jnp.sqrt(self.nu + 1.0) * jnp.sqrt(self.nv + 1.0) / (2 * math.pi) * power

    def sample(self, wi: Array, u: Array) -> Array:
        # tan phi = sqrt((nu + 1)/(nv + 1)) tan(2 pi u), quadrant kept.
        turn = 2 * math.pi * u[:, 1]
        x, y = jnp.cos(turn) * jnp.sqrt(self.nv + 1.0), jnp.sin(turn) * jnp.sqrt(self.nu + 1.0)
        length2 = x * x + y * y
        e = (self.nu * x * x + self.nv * y * y) / length2
        # 1 - cos in closed form: cos = (1 - u)^(1/(e+1)) rounds to 1 for large e.
        one_minus = -jnp.expm1(jnp.log1p(-u[:, 0]) / (e + 1.0))
        hz = 1.0 - one_minus
        sine = jnp.sqrt(one_minus * (1.0 + hz) / length2)
        hx, hy = turned(-self.psi, sine * x, sine * y)
        h = jnp.stack([hx, hy, hz], axis=-1)
        return 2.0 * (h @ wi)[:, None] * h - wi

    def pdf(self, p: Pair) -> Array:
        """p(h)/(4 h.wi), h.wi = |H|/2; 0 for half vectors below the horizon, which are never drawn."""
        h, ok = upper_half(p)
        return jnp.where(ok, self.density(h) / (2.0 * jnp.sqrt(h.squared)), 0.0)


def _filled(mu: Array) -> Array:
    """1 - (1 - mu/2)^5 without cancellation at grazing."""
    y = 1.0 - 0.5 * mu
    return 0.5 * mu * (1.0 + y * (1.0 + y * (1.0 + y * (1.0 + y))))
