"""Kulla-Conty: a Smith microfacet model that gives back the light single scattering loses.

    f = ks [F D G / (4 cos_i cos_o) + F_ms (1 - E(cos_i)) (1 - E(cos_o)) / (pi (1 - E_avg))]

G is the height-correlated Smith term, E the directional albedo of the first term with F = 1 and E_avg its
cosine average (:mod:`fitter.models.scattering_loss`). With F = 1 the albedo is 1 at every incidence and
roughness (C. Kelemen and L. Szirmay-Kalos 2001; C. Kulla and A. Conty, SIGGRAPH 2017 course "Physically based
shading in theory and practice"). F_ms colours the light that met more than one facet: a series that starts
with the second reflection,

    F_ms = F_avg^2 E_avg / (1 - F_avg (1 - E_avg)),      F_avg = F0 + (1 - F0)/21 (Schlick).

The albedo is 1 within 1e-5 in that case. Beside the table of 1 - E, some 2 ms of quadrature a call, a pair
costs two polynomials more than single scattering.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from fitter.models import ndf, scattering_loss
from fitter.models.base import SeparableModel, quotient
from fitter.models.diffuse import KS
from fitter.models.fresnel import F0, schlick_average, schlick_weighted
from fitter.models.lobes import CosineLobe, Lobe, VisibleNormalLobe
from fitter.models.masking import facets
from fitter.models.pair import Half, Pair
from fitter.models.parameters import Parameter
from fitter.spec import ModelSpec


class KullaConty(SeparableModel):
    family: ClassVar[str] = "kulla_conty"

    #: Relative error of float32: beside a small loss its table's last digit counts.
    float32_error: ClassVar[float] = 1e-4

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        return (KS, *([F0] if spec.fresnel == "schlick" else []), *ndf.parameters(spec))

    @staticmethod
    def terms(spec: ModelSpec, nonlinear: Mapping[str, Array], p: Pair) -> tuple[Array, ...]:
        above = p.above
        p = p.lifted()
        h = Half.of(p)
        normals = ndf.of(spec, nonlinear)
        once = facets("smith", p, h, normals)
        again = _again(loss_of(spec, nonlinear), p)
        terms = (once, schlick_weighted(once, p, h), again) if spec.fresnel == "schlick" else (once + again,)
        return tuple(jnp.where(above, term, 0.0) for term in terms)

    @classmethod
    def coefficients(
        cls, spec: ModelSpec, linear: Mapping[str, Array], nonlinear: Mapping[str, Array]
    ) -> tuple[Array, ...]:
        ks = linear["ks"]
        if spec.fresnel == "none":
            return (ks,)
        f0 = linear["f0"]
        return ks * f0, ks * (1.0 - f0), ks * _colour(f0, loss_of(spec, nonlinear).average)

    @classmethod
    def linear_from(
        cls, spec: ModelSpec, coefficients: Sequence[Array], nonlinear: Mapping[str, Array]
    ) -> dict[str, Array]:
        """From the first two: the third follows from them."""
        if spec.fresnel == "none":
            return {"ks": coefficients[0]}
        ks = coefficients[0] + coefficients[1]
        return {"ks": ks, "f0": quotient(coefficients[0], ks)}

    def multiple(self, p: Pair) -> Array:
        """What meets more than one facet, (..., C), for one roughness."""
        lost = loss_of(self.spec, self.values)
        colour = self.values["ks"] * colour_of(self.spec, self.values, lost.average)
        return jnp.where(p.above[..., None], _again(lost, p.lifted())[..., None] * colour, 0.0)

    @staticmethod
    def coefficients_are_free(spec: ModelSpec) -> bool:
        return spec.fresnel == "none"

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        normals = ndf.each(spec, values)
        ks, lost = values["ks"], loss_of(spec, values).average
        f0 = values["f0"] if spec.fresnel == "schlick" else jnp.ones_like(ks)
        once = jnp.mean(ks * schlick_average(f0) * (1.0 - lost))
        found: list[tuple[Lobe, Array]] = [
            (VisibleNormalLobe(d.envelope()), once / len(normals)) for d in normals
        ]
        return [*found, (CosineLobe(), jnp.mean(ks * _colour(f0, lost) * lost))]


def _again(lost: scattering_loss.Loss, p: Pair) -> Array:
    # Both at once: one recurrence to compile.
    lost_i, lost_o = lost(jnp.stack(jnp.broadcast_arrays(p.iz, p.oz)))
    return lost_i * lost_o / (math.pi * lost.average)


def loss_of(spec: ModelSpec, values: Mapping[str, Array]) -> scattering_loss.Loss:
    return scattering_loss.loss(spec.ndf or "ggx", values["alpha"])


def colour_of(spec: ModelSpec, values: Mapping[str, Array], lost: Array) -> Array:
    """F_ms of the parameters, for an average loss."""
    return _colour(values["f0"], lost) if spec.fresnel == "schlick" else jnp.ones_like(values["ks"])


def _colour(f0: Array, lost: Array) -> Array:
    """F_ms for an average loss 1 - E_avg; 1 for F0 = 1."""
    f = schlick_average(f0)
    return f * f * (1.0 - lost) / (1.0 - f * lost)
