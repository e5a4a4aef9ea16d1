"""Blinn-Phong: a power of the half vector's cosine, normalised, plus kd/pi.

J. Blinn 1977. With cos^n theta_h = (1 + tan^2 theta_h)^(-n/2) of the unnormalised half vector,

    ks (n + 2)(n + 4) / (8 pi (2^(-n/2) + n)) cos^n theta_h,

the constant of F. Giesen (2009): the albedo is ks about the normal, exactly, and less elsewhere. Reciprocal.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from fitter.models.base import SeparableModel
from fitter.models.diffuse import KS, diffuse_lobes, masked_terms, with_diffuse
from fitter.models.lobes import HalfVectorLobe, Lobe
from fitter.models.ndf_blinn import Blinn
from fitter.models.pair import Half, Pair
from fitter.models.parameters import Parameter
from fitter.models.phong_lobe import EXPONENT
from fitter.spec import ModelSpec


class BlinnPhong(SeparableModel):
    family: ClassVar[str] = "blinn_phong"

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        return with_diffuse(spec, (KS, EXPONENT))

    @staticmethod
    def terms(spec: ModelSpec, nonlinear: Mapping[str, Array], p: Pair) -> tuple[Array, ...]:
        above = p.above
        h = Half.of(p.lifted())
        n = nonlinear["n"]
        scale = (n + 2.0) * ((n + 4.0) / (n + jnp.exp(-0.5 * math.log(2.0) * n))) / (8 * math.pi)
        return masked_terms(spec, above, [scale * jnp.exp(-0.5 * n * jnp.log1p(h.tan2))])

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        exponents = jnp.atleast_1d(values["n"])
        share = jnp.mean(values["ks"]) / len(exponents)
        found: list[tuple[Lobe, Array]] = [(HalfVectorLobe(Blinn(n)), share) for n in exponents]
        return [*found, *diffuse_lobes(spec, values)]
