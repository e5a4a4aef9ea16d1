"""A rough interface of two transparent media: microfacet reflection and transmission (Walter et al. 2007).

B. Walter, S. Marschner, H. Li and K. Torrance, "Microfacet models for refraction through rough surfaces",
EGSR 2007. Index 1 above (+z), eta below; wi and wo may lie on either side. With n_i the index on the side of
wi and n_o that on the *other* side:

    reflection     f_r = ks F D G / (4 |i_z| |o_z|),                                      h ~ wi + wo
    transmission   f_t = kt |wi.h| |wo.h| n_o^2 (1 - F) G D / (|i_z| |o_z| (n_i wi.h + n_o wo.h)^2),
                                                                                h ~ -(n_i wi + n_o wo)

h turned to the side of wi; 0 where wi or wo is behind its facet. On components, with H = n_i wi + n_o wo
not normalised, f_t = kt |wi.H| |wo.H| n_o^2 T G D / (|i_z| |o_z| |H|^4). F is exact, of c = |wi + wo|/2;
T = 1 - F of *both* cosines |wi.H|/|H| and |wo.H|/|H| (:func:`fitter.models.refraction.transmittance`): no
root, no difference, and the same from both ends.

G : smith_separable is G1(wi) G1(wo). smith is the joint masking of uncorrelated heights: 1/(1 + L_i + L_o)
    for reflection. Of directions on opposite sides the one sees a point the better the higher it lies, the
    other the lower: B(1 + L_i, 1 + L_o) (:func:`fitter.models.refraction.opposed_masking`).
Quantity : f_t relates *radiance* as f_r does, L_o = int f L_i |cos_i| d omega_i, hence its n_o^2. Reflection
    is reciprocal; transmission obeys f_t(wi, wo)/n_o^2 = f_t(wo, wi)/n_i^2. The integral of f |o_z| over wo
    is the share of *power*: for ks = kt = 1 reflectance + transmittance is 1 less what masking loses.
eta = 1 : light goes straight on at every facet, a delta that f_t can't hold; the transmitted lobe is about
    alpha |eta - 1| wide on the way there. |eta - 1| < 1e-3 is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from fitter.errors import SpecError
from fitter.models import fresnel, ndf, refraction
from fitter.models.base import SeparableModel
from fitter.models.interface_lobe import InterfaceLobe
from fitter.models.lobes import Lobe
from fitter.models.masking import facets
from fitter.models.ndf import NDF
from fitter.models.pair import Half, Pair
from fitter.models.parameters import Parameter
from fitter.models.refraction import Crossing
from fitter.spec import ModelSpec

#: Indices closer to 1 than this are refused.
SMALLEST_CONTRAST = 1e-3


class RoughDielectric(SeparableModel):
    family: ClassVar[str] = "rough_dielectric"

    def __check_init__(self) -> None:
        eta = self.values["eta"]
        # Inside a compiled program there is no number to look at.
        if isinstance(eta, Tracer):
            return
        if (np.abs(np.asarray(eta) - 1.0) < SMALLEST_CONTRAST).any():
            raise SpecError(
                f"eta = {np.asarray(eta).tolist()} is within {SMALLEST_CONTRAST:g} of 1", code="no-interface",
                parameter="eta", cause="the media are the same, so that light goes straight on, undeviated",
                remedy="leave the interface out, or use an index further from 1",
            )  # fmt: skip

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        return (refraction.KS, refraction.KT, refraction.ETA, *ndf.parameters(spec))

    @staticmethod
    def transmits(spec: ModelSpec) -> bool:
        del spec
        return True

    @staticmethod
    def refractive_index(spec: ModelSpec, values: Mapping[str, Array]) -> Array:
        del spec
        return values["eta"]

    @staticmethod
    def reciprocal(spec: ModelSpec) -> bool:
        del spec
        return False

    @staticmethod
    def terms(spec: ModelSpec, nonlinear: Mapping[str, Array], p: Pair) -> tuple[Array, ...]:
        normals = ndf.of(spec, nonlinear)
        p, above = refraction.seen_from_above(p)
        ni, no = refraction.indices(above, nonlinear["eta"])
        return _reflected(spec, normals, p, ni, no), _transmitted(spec, normals, p, ni, no)

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        each = ndf.each(spec, values)
        eta = jnp.atleast_1d(values["eta"])
        count = max(len(each), len(eta))
        ks, kt = jnp.mean(values["ks"]), jnp.mean(values["kt"])
        strength = 0.5 * (ks + kt) / count
        return [
            (InterfaceLobe(each[k % len(each)].envelope(), eta[k % len(eta)], ks, kt), strength)
            for k in range(count)
        ]


def _reflected(spec: ModelSpec, normals: NDF, p: Pair, ni: Array, no: Array) -> Array:
    above = p.above
    p = p.lifted()
    h = Half.of(p)
    f = fresnel.dielectric(fresnel.facet_cosine(h), no / ni)
    return jnp.where(above, f * facets(spec.masking, p, h, normals), 0.0)


def _transmitted(spec: ModelSpec, normals: NDF, p: Pair, ni: Array, no: Array) -> Array:
    x = Crossing.of(p, ni, no)
    iz, oz = jnp.where(x.ok, p.iz, 1.0), jnp.where(x.ok, -p.oz, 1.0)
    zero = jnp.zeros_like(p.ix)
    li = normals.lambda_cos(jnp.where(x.ok, p.ix, zero), jnp.where(x.ok, p.iy, zero), iz)
    lo = normals.lambda_cos(jnp.where(x.ok, p.ox, zero), jnp.where(x.ok, p.oy, zero), oz)
    # G / (|i_z| |o_z|), finite at grazing: z (1 + Lambda) = z + lambda_cos.
    masked = 1.0 / ((iz + li) * (oz + lo))
    power = refraction.transmittance(x.ci, x.co, ni, no)
    separable = normals.density(x.h, x.ci * x.jacobian * power * masked)
    joint = spec.masking == "smith"
    return jnp.where(
        x.ok, refraction.opposed_masking(li / iz, lo / oz, separable) if joint else separable, 0.0
    )
