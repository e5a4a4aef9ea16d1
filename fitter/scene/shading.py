"""A model's value with the effects that a plan has proved irrelevant left out of the program.

Which are left out is known when the program is compiled: what is off is not computed. With nothing off it is
the model's own value. The substitutes are those of :mod:`fitter.scene.effects`.
"""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
from jax import Array

from fitter.models import ReflectanceModel, fresnel, masking, ndf
from fitter.models.ndf import GGX
from fitter.models.pair import Half, Pair
from fitter.models.roughness import Isotropic


def value(model: ReflectanceModel, off: frozenset[str], constants: dict[str, Any], p: Pair) -> Array:
    """f (..., C) of the pair; ``off`` names what is left out, ``constants`` what replaces it."""
    if not off:
        return model.value(p)
    spec, values = model.spec, dict(model.values)
    above = p.above
    if spec.family == "oren_nayar":
        level = _constant_part(spec.variant, values["sigma"])
        return jnp.where(above[..., None], values["rho"] * (level / math.pi), 0.0)
    total = jnp.zeros((*above.shape, len(model.channels)), p.iz.dtype)
    if spec.diffuse != "none" and "diffuse" not in off:
        total = total + values["kd"] / math.pi
    if "specular" not in off:
        if "anisotropy" in off:
            values["alpha"] = jnp.sqrt(values["alpha_x"] * values["alpha_y"])
            spec = spec.model_copy(update={"anisotropic": False})
        if spec.family == "ward":
            kind = type(model)
            lobe = kind.terms(spec.model_copy(update={"diffuse": "none"}), values, p)[0]  # pyright: ignore[reportAttributeAccessIssue]
            return jnp.where(above[..., None], total + values["ks"] * lobe[..., None], 0.0)
        lifted = p.lifted()
        h = Half.of(lifted)
        normals = ndf.of(spec, values)
        if "masking" in off:
            lobe = normals.density(h, 0.25 / (lifted.iz * lifted.oz))
        elif "hammon" in off:
            lobe = normals.density(h, _hammon(normals, lifted))
        else:
            lobe = masking.facets(spec.masking, lifted, h, normals)
        lobe = lobe[..., None]
        if "fresnel" in off:
            reflected = jnp.asarray(constants["fresnel"], lobe.dtype)
        elif spec.fresnel == "schlick":
            m = fresnel.schlick_weighted(jnp.ones_like(lobe[..., 0]), lifted, h)[..., None]
            reflected = values["f0"] + (1.0 - values["f0"]) * m
        elif spec.fresnel in (None, "none"):
            reflected = jnp.ones_like(values["ks"])
        else:
            reflected = fresnel.exact(spec.fresnel, values, fresnel.facet_cosine(h)[..., None])
        total = total + values["ks"] * reflected * lobe
    return jnp.where(above[..., None], total, 0.0)


def _hammon(normals: ndf.Distribution, p: Pair) -> Array:
    """E. Hammon 2017: G/(4 n.l n.v) of GGX without a root."""
    assert isinstance(normals, GGX)
    assert isinstance(normals.roughness, Isotropic)
    alpha = normals.roughness.alpha
    return 0.5 / ((1.0 - alpha) * 2.0 * p.iz * p.oz + alpha * (p.iz + p.oz))


def _constant_part(variant: str | None, sigma: Array) -> Array:
    """What Oren-Nayar's terms are over rho/pi where they don't depend on the directions."""
    if variant == "fujii":
        return 1.0 / (1.0 + (0.5 - 2 / (3 * math.pi)) * sigma)
    s2 = sigma * sigma
    return 1.0 - 0.5 * s2 / (s2 + 0.33)
