"""A model's value with the effects that a plan has proved irrelevant left out of the program.

Which are left out is known when the program is compiled: what is off is not computed. With nothing off it is
the model's own value. The substitutes are those of :mod:`fitter.scene.effects`.
"""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
from jax import Array

from fitter.models import ReflectanceModel, composite, fresnel, masking, ndf
from fitter.models.base import SeparableModel
from fitter.models.kulla_conty import KullaConty
from fitter.models.layered import Layered
from fitter.models.ndf import GGX
from fitter.models.pair import Half, Pair
from fitter.models.roughness import Isotropic
from fitter.scene.facets import model_as_facets
from fitter.scene.families import component_names, lobe_names


def value(model: ReflectanceModel, off: frozenset[str], constants: dict[str, Any], p: Pair) -> Array:
    """f (..., C) of the pair; ``off`` names what is left out, ``constants`` what replaces it."""
    if not off:
        return model.value(p)
    if isinstance(model, KullaConty):
        once = value(model_as_facets(model), off - {"multiple"}, constants, p)
        return once if "multiple" in off else once + model.multiple(p)
    if isinstance(model, Layered):
        return _coated(model, off, constants, p)
    if model.spec.family == "sum":
        named = zip(component_names(model.spec), composite.parts(model), strict=True)
        return _sum([part.value(p) for name, part in named if name not in off], model, p)
    model = model_as_facets(model)
    spec = model.spec
    if spec.family == "oren_nayar":
        level = _constant_part(spec.variant, model.values["sigma"])
        return jnp.where(p.above[..., None], model.values["rho"] * (level / math.pi), 0.0)
    if spec.family != "ward" and off & {"fresnel", "masking", "hammon", "anisotropy"}:
        return _facets(model, off, constants, p)
    if "anisotropy" in off:
        model = _isotropic(model)
    assert isinstance(model, SeparableModel)
    parts = model.parts(p)
    names = ["diffuse"] if spec.diffuse != "none" else []
    names += lobe_names(spec) if spec.family == "lafortune" else ["specular"] * (len(parts) - len(names))
    # What is not summed is not compiled.
    return _sum([part for name, part in zip(names, parts, strict=True) if name not in off], model, p)


def _sum(parts: list[Array], model: ReflectanceModel, p: Pair) -> Array:
    return sum(parts, jnp.zeros((*p.iz.shape, len(model.channels)), p.iz.dtype))


def _isotropic(model: ReflectanceModel) -> ReflectanceModel:
    """With the geometric mean of both roughnesses."""
    alpha = jnp.sqrt(model.values["alpha_x"] * model.values["alpha_y"])
    spec = model.spec.model_copy(update={"anisotropic": False})
    return type(model)(spec=spec, channels=model.channels, values={**model.values, "alpha": alpha})


def _facets(model: ReflectanceModel, off: frozenset[str], constants: dict[str, Any], p: Pair) -> Array:
    if "anisotropy" in off:
        model = _isotropic(model)
    spec, values = model.spec, model.values
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
    total = values["ks"] * reflected * lobe
    if spec.diffuse != "none" and "diffuse" not in off:
        entering = 1.0 - reflected if spec.diffuse == "coupled" else 1.0
        total = total + values["kd"] / math.pi * entering
    return jnp.where(p.above[..., None], total, 0.0)


def _coated(model: Layered, off: frozenset[str], constants: dict[str, Any], p: Pair) -> Array:
    lifted = p.lifted()
    top, passed, below = model.layers(lifted)
    base = composite.parts(model)[0]
    if base.spec.family == "lambert":
        # The same in all directions: they need not be refracted.
        below = base.value(lifted)
    if "passage" in off:
        passed = jnp.asarray(constants["passage"], below.dtype)
    found = passed * below
    return jnp.where(p.above[..., None], found if "coat" in off else found + top, 0.0)


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
