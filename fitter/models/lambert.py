"""Lambert's cosine law: the ideal diffuse reflector, kd/pi (J. H. Lambert, Photometria, 1760)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from fitter.models.base import SeparableModel
from fitter.models.diffuse import KD
from fitter.models.lobes import CosineLobe, Lobe
from fitter.models.pair import Pair
from fitter.models.parameters import Parameter
from fitter.spec import ModelSpec


class Lambert(SeparableModel):
    family: ClassVar[str] = "lambert"

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        del spec
        return (KD,)

    @staticmethod
    def terms(spec: ModelSpec, nonlinear: Mapping[str, Array], p: Pair) -> tuple[Array, ...]:
        del spec, nonlinear
        return (jnp.where(p.above, 1 / math.pi, jnp.zeros_like(p.iz + p.oz)),)

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        del spec
        return [(CosineLobe(), jnp.mean(values["kd"]))]
