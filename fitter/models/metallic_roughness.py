"""The metallic-roughness material of real-time engines: base colour, metallic, roughness.

Khronos glTF 2.0, appendix B, with alpha = roughness^2, GGX's D and S = (1 - cos theta_d)^5:

    f = (1 - F) base_color (1 - metallic)/pi + F D G/(4 cos_i cos_o)
    F = f0 + (1 - f0) S,   f0 = 0.04 (1 - metallic) + base_color metallic

The appendix prints Smith's G as a product; this is the height-correlated form that engines compute
(E. Heitz 2014). alpha is held at 1e-4 or more: 0 is an ideal mirror, which has no density, and below that
width float32 directions can't resolve the lobe. Reciprocal.

A metal never gains energy; a dielectric does at grazing, where 1 - F of the half vector dims the diffuse term
too little: the albedo of a white one at cos_i = 1e-3 is 1.02 for roughness 1, 1.10 for 0.6, 1.77 for 0.1 and
1.92 for 0.

For given metallic and roughness three terms, whose coefficients are functions of base_color alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from fitter.models import masking
from fitter.models.base import SeparableModel, quotient
from fitter.models.fresnel import schlick_average, schlick_rest, schlick_weighted
from fitter.models.lobes import CosineLobe, Lobe, VisibleNormalLobe
from fitter.models.ndf import GGX
from fitter.models.pair import Half, Pair
from fitter.models.parameters import Parameter
from fitter.models.roughness import Isotropic
from fitter.spec import ModelSpec

BASE_COLOR = Parameter(
    "base_color", "1", 0.0, 1.0, 0.5, "albedo of a dielectric, reflectance at normal incidence of a metal",
    linear=True,
)  # fmt: skip
METALLIC = Parameter("metallic", "1", 0.0, 1.0, 0.0, "0 for a dielectric, 1 for a metal, a blend between")
ROUGHNESS = Parameter("roughness", "1", 0.0, 1.0, 0.5, "perceived roughness, the root of GGX's alpha")

_DIELECTRIC_F0 = 0.04
_SMALLEST_ALPHA = 1e-4


class MetallicRoughness(SeparableModel):
    family: ClassVar[str] = "metallic_roughness"

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        del spec
        return (BASE_COLOR, METALLIC, ROUGHNESS)

    @staticmethod
    def terms(spec: ModelSpec, nonlinear: Mapping[str, Array], p: Pair) -> tuple[Array, ...]:
        del spec
        above = p.above
        p = p.lifted()
        h = Half.of(p)
        lobe = masking.facets("smith", p, h, _normals(nonlinear["roughness"]))
        diffuse = schlick_rest(p, h) / math.pi
        return tuple(jnp.where(above, term, 0.0) for term in (diffuse, lobe, schlick_weighted(lobe, p, h)))

    @classmethod
    def coefficients(
        cls, spec: ModelSpec, linear: Mapping[str, Array], nonlinear: Mapping[str, Array]
    ) -> tuple[Array, ...]:
        base, metallic = linear["base_color"], nonlinear["metallic"]
        f0 = _f0(base, metallic)
        rest = (1.0 - _DIELECTRIC_F0) * (1.0 - metallic) + (1.0 - base) * metallic
        return base * (1.0 - metallic) * rest, f0, rest

    @classmethod
    def linear_from(
        cls, spec: ModelSpec, coefficients: Sequence[Array], nonlinear: Mapping[str, Array]
    ) -> dict[str, Array]:
        diffuse, f0, rest = coefficients
        # f0 + base_color (1 - metallic) is base_color but for the dielectric's part, for any metallic.
        return {"base_color": f0 + quotient(diffuse, rest) - _DIELECTRIC_F0 * (1.0 - nonlinear["metallic"])}

    @staticmethod
    def coefficients_are_free(spec: ModelSpec) -> bool:
        del spec
        return False

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        del spec
        base, metallic = values["base_color"], values["metallic"]
        widths = jnp.atleast_1d(values["roughness"])
        f0 = _f0(base, metallic)
        share = jnp.mean(schlick_average(f0)) / len(widths)
        found: list[tuple[Lobe, Array]] = [(VisibleNormalLobe(_normals(width)), share) for width in widths]
        return [*found, (CosineLobe(), jnp.mean(base * (1.0 - metallic) * (1.0 - f0)))]


def facets(values: Mapping[str, Array]) -> dict[str, Array]:
    """The parameters of the same reflectance as a coupled Torrance-Sparrow model."""
    base, metallic = values["base_color"], values["metallic"]
    return {
        "kd": base * (1.0 - metallic), "ks": jnp.ones_like(base), "f0": _f0(base, metallic),
        "alpha": _alpha(values["roughness"]),
    }  # fmt: skip


def _f0(base: Array, metallic: Array) -> Array:
    return _DIELECTRIC_F0 * (1.0 - metallic) + base * metallic


def _alpha(roughness: Array) -> Array:
    alpha = roughness * roughness
    return jnp.where(alpha > _SMALLEST_ALPHA, alpha, _SMALLEST_ALPHA)


def _normals(roughness: Array) -> GGX:
    return GGX(Isotropic(_alpha(roughness)))
