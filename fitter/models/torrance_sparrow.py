"""Torrance-Sparrow: ks F D G / (4 cos_i cos_o) plus a diffuse term, for any NDF, masking and Fresnel term.

K. Torrance and E. Sparrow 1967; the constant is 4 (the 1982 paper of Cook and Torrance prints pi for
a D without its own 1/pi). The diffuse term is kd/pi, or coupled, (1 - F) kd/pi with F at the half vector,
which is reciprocal. Schlick's Fresnel term splits into terms that are linear,

    ks F = (ks F0) + (ks (1 - F0)) S,    kd (1 - F) = (kd (1 - F0)) (1 - S),    S = (1 - cos theta_d)^5,

which leaves the roughness as the only nonlinear parameter and removes the ks-F0 valley. With exact Fresnel
terms the indices are nonlinear: eta, shared by the channels, or a metal's eta and kappa, per channel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from fitter.models import fresnel, ndf
from fitter.models.base import SeparableModel, quotient
from fitter.models.diffuse import KS, masked_terms, with_diffuse
from fitter.models.lobes import CosineLobe, HalfVectorLobe, Lobe, VisibleNormalLobe
from fitter.models.masking import facets
from fitter.models.pair import Half, Pair
from fitter.models.parameters import Parameter
from fitter.models.span import Span, of_half_vector
from fitter.spec import ModelSpec

#: With a coupled diffuse term F0 = 1 would leave no light to it: the largest F0 such a fit may have.
LARGEST_COUPLED_F0 = 1.0 - 2.0**-20


class TorranceSparrow(SeparableModel):
    family: ClassVar[str] = "torrance_sparrow"

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        linear = (KS, fresnel.F0) if spec.fresnel == "schlick" else (KS,)
        nonlinear = (*ndf.parameters(spec), *fresnel.PARAMETERS[spec.fresnel or "none"])
        return with_diffuse(spec, (*linear, *nonlinear))

    @staticmethod
    def terms(spec: ModelSpec, nonlinear: Mapping[str, Array], p: Pair) -> tuple[Array, ...]:
        above = p.above
        p = p.lifted()
        h = Half.of(p)
        normals = ndf.of(spec, nonlinear)
        lobe = facets(spec.masking, p, h, normals)
        coupled = spec.diffuse == "coupled"
        if spec.fresnel == "schlick":
            entering = fresnel.schlick_rest(p, h) if coupled else 1.0
            return masked_terms(spec, above, [lobe, fresnel.schlick_weighted(lobe, p, h)], entering)
        if spec.fresnel == "none":
            return masked_terms(spec, above, [lobe])
        reflected, entering = fresnel.exact_split(spec.fresnel, nonlinear, fresnel.facet_cosine(h))
        return masked_terms(spec, above, [lobe * reflected], entering if coupled else 1.0)

    @staticmethod
    def span(spec: ModelSpec) -> Span | None:
        # Of the masking terms only that of V-grooves, of the Fresnel terms only those that are linear, have
        # no nonlinear parameter of their own.
        if spec.anisotropic or spec.masking != "v_groove" or spec.fresnel not in ("schlick", "none"):
            return None
        return of_half_vector(tuple((p.name, ndf.widest(p)) for p in ndf.parameters(spec)))

    @classmethod
    def coefficients(
        cls, spec: ModelSpec, linear: Mapping[str, Array], nonlinear: Mapping[str, Array]
    ) -> tuple[Array, ...]:
        if spec.fresnel != "schlick":
            return super().coefficients(spec, linear, nonlinear)
        ks, f0 = linear["ks"], linear["f0"]
        lobes = (ks * f0, ks * (1.0 - f0))
        if spec.diffuse == "none":
            return lobes
        return (linear["kd"] * (1.0 - f0) if spec.diffuse == "coupled" else linear["kd"], *lobes)

    @classmethod
    def linear_from(
        cls, spec: ModelSpec, coefficients: Sequence[Array], nonlinear: Mapping[str, Array]
    ) -> dict[str, Array]:
        if spec.fresnel != "schlick":
            return super().linear_from(spec, coefficients, nonlinear)
        *diffuse, constant, rising = coefficients
        ks = constant + rising
        # Without a specular term F0 means nothing: 0 keeps it finite, its uncertainty says the rest.
        f0 = quotient(constant, ks)
        if not diffuse:
            return {"ks": ks, "f0": f0}
        kd = diffuse[0]
        if spec.diffuse == "coupled":
            f0 = jnp.where(kd > 0, jnp.minimum(f0, LARGEST_COUPLED_F0), f0)
            kd = quotient(kd, 1.0 - f0)
        return {"kd": kd, "ks": ks, "f0": f0}

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        normals = ndf.each(spec, values)
        average = average_fresnel(spec, values)
        strength = jnp.mean(values["ks"] * average) / len(normals)
        found: list[tuple[Lobe, Array]] = [(lobe_of(spec, d), strength) for d in normals]
        if spec.diffuse != "none":
            entering = 1.0 - average if spec.diffuse == "coupled" else 1.0
            found.append((CosineLobe(), jnp.mean(values["kd"] * entering)))
        return found


def lobe_of(spec: ModelSpec, normals: ndf.Distribution) -> Lobe:
    """Reflection in visible normals where the masking is Smith's or close to it, else in all normals: so
    the weights are bounded (V-grooves: by 2 F, since G <= 2 cos_h cos_i / (h.wi))."""
    if spec.masking in (None, "v_groove"):
        return HalfVectorLobe(normals)
    return VisibleNormalLobe(normals.envelope())


def average_fresnel(spec: ModelSpec, values: Mapping[str, Array]) -> Array:
    """Cosine average of F, () or (C,): about the share of light that is reflected at the facets."""
    if spec.fresnel == "schlick":
        return fresnel.schlick_average(values["f0"])
    if spec.fresnel == "none":
        return jnp.ones_like(values["ks"])
    return fresnel.cosine_average(lambda c: fresnel.exact(spec.fresnel, values, c), values["eta"])
