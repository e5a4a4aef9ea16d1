"""The ideal mirror: all reflected light goes into the mirror direction, a delta component.

    f = ks F(cos theta_i) delta(wo - R(wi)) / cos theta_o,    R(x, y, z) = (-x, -y, z)

so that its directional albedo is ks F(cos theta_i). ``evaluate`` and ``pdf`` are 0: a delta is no number.
``sample`` returns the one direction with that weight and is_delta. F is 1, Schlick's, or the exact term of a
dielectric or a metal (:mod:`fitter.models.fresnel`). Reciprocal; conserves energy where ks <= 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from fitter.models import fresnel
from fitter.models.base import ReflectanceModel
from fitter.models.diffuse import KS
from fitter.models.lobes import Delta, Lobe
from fitter.models.pair import Pair
from fitter.models.parameters import Parameter
from fitter.spec import ModelSpec


class Ideal(ReflectanceModel):
    """A model that has ideal components only: its value is 0, a delta being no number."""

    def value(self, p: Pair) -> Array:
        shape = (*jnp.broadcast_shapes(p.iz.shape, p.oz.shape), len(self.channels))
        return jnp.zeros(shape, jnp.result_type(p.iz, p.oz))

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        del spec, values
        return []


class Specular(Ideal):
    family: ClassVar[str] = "specular"

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        assert spec.fresnel is not None
        linear = (KS, fresnel.F0) if spec.fresnel == "schlick" else (KS,)
        return (*linear, *fresnel.PARAMETERS[spec.fresnel])

    @staticmethod
    def deltas(
        spec: ModelSpec, values: Mapping[str, Array], x: Array, y: Array, z: Array
    ) -> tuple[Delta, ...]:
        above = z > 0
        # Grazing light from below must not reach the roots of the Fresnel term.
        f = reflectance(spec, values, x[..., None], y[..., None], jnp.where(above, z, 1.0)[..., None])
        weight = jnp.where(above[..., None], values["ks"] * f, 0.0)
        return (Delta(-x, -y, z, weight, jnp.mean(weight, axis=-1)),)


def reflectance(spec: ModelSpec, values: Mapping[str, Array], x: Array, y: Array, z: Array) -> Array:
    """F of a flat surface for unit directions (x, y, z), z > 0; shapes broadcast with those of the values."""
    if spec.fresnel == "none":
        return jnp.ones_like(z)
    if spec.fresnel == "schlick":
        # 1 - z without its cancellation near the normal.
        m = (x * x + y * y) / (1.0 + z)
        m2 = m * m
        return values["f0"] + (1.0 - values["f0"]) * m2 * m2 * m
    return fresnel.exact(spec.fresnel, values, z)
