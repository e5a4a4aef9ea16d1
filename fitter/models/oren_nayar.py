"""Oren-Nayar: a rough surface of Lambertian facets, the qualitative form.

M. Oren and S. Nayar 1994, eq. 30, rho/pi (A + B max(0, cos dphi) sin a tan b), written without angles:
sin a tan b cos dphi = (xi xo + yi yo) / max(cos_i, cos_o). It exceeds an albedo of 1 by up to 1.5 % at
grazing for rho = 1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from fitter.models.base import ReflectanceModel
from fitter.models.lobes import CosineLobe, Lobe
from fitter.models.pair import Pair
from fitter.models.parameters import Parameter
from fitter.spec import ModelSpec

RHO = Parameter("rho", "1", 0.0, math.inf, 0.5, "albedo of the facets", linear=True)
SIGMA = Parameter(
    "sigma", "rad", 0.0, math.pi / 2, 0.3, "standard deviation of the facets' slope angle; 0 is Lambertian"
)


class OrenNayar(ReflectanceModel):
    family: ClassVar[str] = "oren_nayar"

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        return (RHO, SIGMA)

    @staticmethod
    def terms(spec: ModelSpec, nonlinear: Mapping[str, Array], p: Pair) -> tuple[Array, ...]:
        above = p.above
        p = p.lifted()
        s2 = nonlinear["sigma"] * nonlinear["sigma"]
        a = 1.0 - 0.5 * s2 / (s2 + 0.33)
        b = 0.45 * s2 / (s2 + 0.09)
        plane = p.ix * p.ox + p.iy * p.oy
        forward = jnp.maximum(plane, 0.0) / jnp.maximum(p.iz, p.oz)
        return (jnp.where(above, (a + b * forward) / math.pi, 0.0),)

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        return [(CosineLobe(), jnp.ones((), values["sigma"].dtype))]
