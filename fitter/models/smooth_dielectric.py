"""A smooth interface of two transparent media: ideal reflection and ideal refraction, both delta components.

Light from above (wi_z > 0, index 1) or from below (wi_z < 0, index eta) is split by the exact Fresnel term

    reflected    R(wi) = (-x, -y, z)                             with weight ks F
    refracted    (-x n_i/n_o, -y n_i/n_o, -sign(z) cos theta_t)  with weight kt (1 - F)    (Snell's law)

and wholly reflected beyond the critical angle. Weights are shares of *power*: ks = kt = 1 gives reflectance +
transmittance = 1. The radiance of refracted light is (n_o/n_i)^2 times that, since its solid angle changes: a
ray tracer that carries radiance against the light multiplies a refracted path by (n_o/n_i)^2.
``evaluate`` and ``pdf`` are 0. Draws choose by ks F and kt (1 - F), so that the weights of a grey model are
all the same, 1 for a lossless one. With one eta per channel (dispersion) each channel has a refracted
direction of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from fitter.models import fresnel, refraction
from fitter.models.lobes import Delta
from fitter.models.parameters import Parameter
from fitter.models.specular import Ideal
from fitter.spec import ModelSpec


class SmoothDielectric(Ideal):
    family: ClassVar[str] = "smooth_dielectric"

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        del spec
        return (refraction.KS, refraction.KT, refraction.ETA)

    @staticmethod
    def transmits(spec: ModelSpec) -> bool:
        del spec
        return True

    @staticmethod
    def deltas(
        spec: ModelSpec, values: Mapping[str, Array], x: Array, y: Array, z: Array
    ) -> tuple[Delta, ...]:
        del spec
        above, ci = z > 0, jnp.abs(z)
        # On the horizon itself nothing arrives; the normal stands in for it.
        ci = jnp.where(ci > 0, ci, 1.0)
        s2 = x * x + y * y
        ks, kt, eta = values["ks"], values["kt"], values["eta"]
        ni, no = refraction.indices(above[..., None], eta)
        weight = ks * fresnel.dielectric(ci[..., None], no / ni)
        found = [Delta(-x, -y, z, weight, jnp.mean(weight, axis=-1))]
        channel = jnp.arange(len(kt))
        for k, index in enumerate(jnp.atleast_1d(eta)):
            ni, no = refraction.indices(above, index)
            co, partial = refraction.refracted_cosine(ci, s2, ni, no)
            power = jnp.where(partial, refraction.transmittance(ci, co, ni, no), 0.0)
            weight = kt * power[..., None]
            if eta.ndim:
                weight = jnp.where(channel == k, weight, 0.0)
            ratio = ni / no
            found.append(
                Delta(-x * ratio, -y * ratio, jnp.where(above, -co, co), weight, jnp.mean(weight, axis=-1))
            )
        return tuple(found)
