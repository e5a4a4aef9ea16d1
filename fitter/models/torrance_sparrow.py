"""Torrance-Sparrow: ks F D G / (4 cos_i cos_o) plus kd/pi, any NDF with any masking and Fresnel term.

K. Torrance and E. Sparrow 1967; the constant is 4 (the 1982 paper of Cook and Torrance prints pi for
a D without its own 1/pi). Schlick's Fresnel term splits into two that are linear,

    ks F = (ks F0) + (ks (1 - F0)) (1 - cos theta_d)^5,

which leaves the roughness as the only nonlinear parameter and removes the ks-F0 valley.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from fitter.models.base import ReflectanceModel
from fitter.models.diffuse import KS, masked_terms, with_diffuse
from fitter.models.fresnel import schlick_weight
from fitter.models.lobes import CosineLobe, HalfVectorLobe, Lobe
from fitter.models.masking import MASKINGS
from fitter.models.ndf import NDFS
from fitter.models.pair import Half, Pair
from fitter.models.parameters import Parameter
from fitter.spec import ModelSpec

F0 = Parameter("f0", "1", 0.0, 1.0, 0.04, "Fresnel reflectance at normal incidence (Schlick)", linear=True)
ALPHA = Parameter("alpha", "1", 1e-3, 2.0, 0.2, "roughness of the normal distribution", search="log")


class TorranceSparrow(ReflectanceModel):
    family: ClassVar[str] = "torrance_sparrow"

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        return with_diffuse(spec, (KS, F0, ALPHA) if spec.fresnel == "schlick" else (KS, ALPHA))

    @staticmethod
    def terms(spec: ModelSpec, nonlinear: Mapping[str, Array], p: Pair) -> tuple[Array, ...]:
        above = p.above
        p = p.lifted()
        h = Half.of(p)
        alpha = nonlinear["alpha"]
        assert spec.ndf is not None
        assert spec.masking is not None
        lobe = NDFS[spec.ndf](h.tan2, alpha) * MASKINGS[spec.masking](p, h, alpha, spec.ndf)
        lobes = [lobe, lobe * schlick_weight(p, h)] if spec.fresnel == "schlick" else [lobe]
        return masked_terms(spec, above, lobes)

    @classmethod
    def coefficients(cls, spec: ModelSpec, linear: Mapping[str, Array]) -> tuple[Array, ...]:
        ks = linear["ks"]
        lobes = (ks * linear["f0"], ks * (1.0 - linear["f0"])) if spec.fresnel == "schlick" else (ks,)
        return (linear["kd"], *lobes) if spec.diffuse == "lambert" else lobes

    @classmethod
    def linear_from(cls, spec: ModelSpec, coefficients: Sequence[Array]) -> dict[str, Array]:
        found: dict[str, Array] = {}
        rest = list(coefficients)
        if spec.diffuse == "lambert":
            found["kd"] = rest.pop(0)
        found["ks"] = rest[0]
        if spec.fresnel == "schlick":
            ks = rest[0] + rest[1]
            found["ks"] = ks
            # Without a specular term F0 means nothing: 0 keeps it finite, its uncertainty says the rest.
            found["f0"] = jnp.where(ks > 0, rest[0] / jnp.where(ks > 0, ks, 1.0), 0.0)
        return found

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        assert spec.ndf is not None
        alphas = jnp.atleast_1d(values["alpha"])
        # Cosine average of Schlick's term: F0 + (1 - F0)/21.
        f0 = values["f0"] if spec.fresnel == "schlick" else jnp.ones_like(values["ks"])
        strength = jnp.mean(values["ks"] * (f0 + (1.0 - f0) / 21.0))
        found: list[tuple[Lobe, Array]] = [
            (HalfVectorLobe(a, spec.ndf), strength / len(alphas)) for a in alphas
        ]
        if spec.diffuse == "lambert":
            found.append((CosineLobe(), jnp.mean(values["kd"])))
        return found
