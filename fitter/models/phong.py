"""Phong's mirror lobe, normalised and reciprocal, plus kd/pi.

B. T. Phong 1975 as modified by E. Lafortune and Y. Willems ("Using the modified Phong reflectance model for
physically based rendering", 1994): with R(wi).wo = zi zo - xi xo - yi yo,

    ks (n + 2)/(2 pi) max(0, R(wi).wo)^n.

Its albedo is ks about the normal and less elsewhere. Where the product is not positive the lobe is 0, for
n = 0 too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from fitter.models.base import SeparableModel
from fitter.models.diffuse import KS, diffuse_lobes, masked_terms, with_diffuse
from fitter.models.lobes import Lobe
from fitter.models.pair import Pair
from fitter.models.parameters import Parameter
from fitter.models.phong_lobe import EXPONENT, PhongLobe, power
from fitter.spec import ModelSpec


class Phong(SeparableModel):
    family: ClassVar[str] = "phong"

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        return with_diffuse(spec, (KS, EXPONENT))

    @staticmethod
    def terms(spec: ModelSpec, nonlinear: Mapping[str, Array], p: Pair) -> tuple[Array, ...]:
        above = p.above
        p = p.lifted()
        n = nonlinear["n"]
        base = p.iz * p.oz - (p.ix * p.ox + p.iy * p.oy)
        return masked_terms(spec, above, [power(base, n) * (n + 2.0) / (2 * math.pi)])

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        exponents = jnp.atleast_1d(values["n"])
        one = jnp.ones_like(exponents[0])
        share = jnp.mean(values["ks"]) / len(exponents)
        found: list[tuple[Lobe, Array]] = [(PhongLobe(-one, -one, one, n), share) for n in exponents]
        return [*found, *diffuse_lobes(spec, values)]
