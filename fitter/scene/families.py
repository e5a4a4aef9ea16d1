"""Families: which effects of them are known, and enclosures of their terms.

A family is added here, to FAMILIES; what replaces its effects, to :mod:`fitter.scene.shading`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from fitter.models import ReflectanceModel, composite
from fitter.models.lafortune import lobe_suffixes
from fitter.scene import coats, cosine_lobes, factors, fresnel, multiple
from fitter.scene.facets import as_facets, model_as_facets
from fitter.scene.intervals import Interval, increasing
from fitter.scene.terms import Asked, Term
from fitter.spec import ModelSpec


@dataclass(frozen=True)
class Family:
    """What is known of a family: the effects of a model, None where nothing is proved of it, and its terms
    but for an additive diffuse one."""

    effects: Callable[[ReflectanceModel], Sequence[str] | None]
    terms: Callable[[Asked], list[Term]]


def known(model: ReflectanceModel) -> Sequence[str] | None:
    """The effects of a model, None where nothing is proved of it."""
    family = FAMILIES.get(model.spec.family)
    return family.effects(model) if family else None


def terms(asked: Asked) -> list[Term]:
    """The terms of one channel over boxes."""
    family = FAMILIES[asked.spec.family]
    spec, values = as_facets(asked.spec, asked.values)
    asked = replace(asked, spec=spec, values={name: float(x) for name, x in values.items()})
    off, angles = asked.off, asked.angles
    found = family.terms(asked)
    base = asked.values.get("kd", 0.0) / math.pi
    if base > 0:
        level = np.full(angles.lz.lo.shape, base)
        level = increasing(level, level)
        if spec.diffuse == "coupled":
            cosine = fresnel.facet_cosine(angles)
            entering = (1.0 - fresnel.reflectance(spec, asked.values, cosine)).clip(0, 1)
            ratio = (1.0 - asked.constant("fresnel")) / entering if "fresnel" in off else 1.0
            found.append(asked.term("diffuse", level * entering, ratio=ratio))
        else:
            found.append(asked.term("diffuse", level))
    zero = Interval.of(np.zeros(angles.lz.lo.shape))
    return found or [asked.term("", zero, zero)]


def lobe_names(spec: ModelSpec) -> tuple[str, ...]:
    """The effects that lobes are, where they are left out."""
    return ("specular",) if spec.lobes == 1 else tuple(f"lobe{k + 1}" for k in range(spec.lobes))


def _of_lobes(model: ReflectanceModel) -> tuple[str, ...]:
    """The terms that may be absent: none of a model that has one."""
    found = lobe_names(model.spec) if model.spec.diffuse == "none" else ("diffuse", *lobe_names(model.spec))
    return found if len(found) > 1 else ()


def _per_channel(model: ReflectanceModel) -> bool:
    """Roughness per channel: the substitutes of facets are written for one."""
    return any(np.ndim(v) for name, v in model.nonlinear.items() if name not in ("eta", "kappa"))


def _of_oren_nayar(model: ReflectanceModel) -> Sequence[str] | None:
    if model.spec.variant not in ("qualitative", "fujii"):
        return None
    rough = bool(np.any(np.asarray(model.values["sigma"]) > 0))
    return ("retro",) if rough and not np.ndim(model.values["sigma"]) else ()


def _of_ward(model: ReflectanceModel) -> Sequence[str]:
    found = _of_lobes(model)
    return (*found, "anisotropy") if model.spec.anisotropic and not _per_channel(model) else found


def _of_facets(model: ReflectanceModel) -> Sequence[str] | None:
    model = model_as_facets(model)
    spec = model.spec
    if not (
        spec.ndf in ("ggx", "beckmann") and spec.masking in ("smith", "smith_separable", "v_groove", None)
        and spec.fresnel in ("schlick", "dielectric", "conductor", "none", None)
        and not (spec.ndf == "beckmann" and spec.anisotropic)
        and not (spec.anisotropic and spec.masking != "smith")
    ):  # fmt: skip
        return None
    found = list(_of_lobes(model))
    if _per_channel(model):
        return found
    found += ["fresnel"] if spec.fresnel not in (None, "none") else []
    found += ["masking"]
    hammon = spec.ndf == "ggx" and spec.masking == "smith" and not spec.anisotropic
    # Its bounds are those of a roughness up to 1.
    found += ["hammon"] if hammon and float(np.max(np.asarray(model.values["alpha"]))) <= 1 else []
    return (*found, "anisotropy") if spec.anisotropic else found


def _lobe(a: Asked, value: Interval, *more: Interval) -> list[Term]:
    """A specular lobe: its value over ks, that times n.l, and its ratio."""
    ks = a.values["ks"]
    lit = (more[0] if more else value * a.angles.lz) * ks
    return [a.term("specular", value * ks, lit, *more[1:])] if ks > 0 else []


def _ward(a: Asked) -> list[Term]:
    value, ratio = factors.ward(a.spec, a.values, a.off, a.angles)
    return _lobe(a, value, value * a.angles.lz, ratio)


def _facets(a: Asked) -> list[Term]:
    return _lobe(a, *factors.facets(a.spec, a.values, a.off, a.constants, a.angles, a.channel))


def _of_kulla_conty(model: ReflectanceModel) -> Sequence[str]:
    # One roughness, GGX or Beckmann: all that is known of facets holds.
    return ("multiple", *(_of_facets(model) or ()))


def _kulla_conty(a: Asked) -> list[Term]:
    again = multiple.scattered(a.spec, a.values, a.angles) * a.values["ks"]
    return [*_facets(a), a.term("multiple", again)]


def _of_layered(model: ReflectanceModel) -> Sequence[str] | None:
    return None if known(composite.parts(model)[0]) is None else ("coat", "passage")


def _layered(a: Asked) -> list[Term]:
    value, lit, _ = coats.top(a.spec, a.values, a.angles)
    passed = coats.passage(a.spec, a.values, a.angles)
    ratio = a.constant("passage") / passed if "passage" in a.off else 1.0
    (base,) = _components(a)
    parts = terms(replace(base, angles=coats.beneath(a.values, a.angles)))
    below = [a.term("", part.value * passed, ratio=ratio) for part in parts]
    return [a.term("coat", value, lit), *below]


def component_names(spec: ModelSpec) -> tuple[str, ...]:
    """The effects that a sum's components are."""
    return tuple(f"component_{prefix[0]}" for prefix in composite.prefixes(spec))


def _components(a: Asked) -> list[Asked]:
    """The components of a composite, whole."""
    values = {name: jnp.asarray(x) for name, x in a.values.items()}
    return [
        replace(a, spec=spec, values={name: float(x) for name, x in own.items()}, off=frozenset())
        for _, spec, own in composite.kinds(a.spec, values)
    ]


def _of_sum(model: ReflectanceModel) -> Sequence[str] | None:
    if any(known(part) is None for part in composite.parts(model)):
        return None
    return component_names(model.spec)


def _sum(a: Asked) -> list[Term]:
    return [
        a.term(name, part.value, part.lit)
        for name, component in zip(component_names(a.spec), _components(a), strict=True)
        for part in terms(component)
    ]


def _phong(a: Asked) -> list[Term]:
    return _lobe(a, cosine_lobes.phong(a.values, a.angles))


def _blinn(a: Asked) -> list[Term]:
    return _lobe(a, cosine_lobes.blinn(a.values, a.angles))


def _lafortune(a: Asked) -> list[Term]:
    lobes = cosine_lobes.lafortune(a.spec, a.values, a.angles)
    scales = (a.values[f"ks{s}"] for s in lobe_suffixes(a.spec))
    return [a.term(name, lobe * ks) for name, lobe, ks in zip(lobe_names(a.spec), lobes, scales, strict=True)]


def _oren_nayar(a: Asked) -> list[Term]:
    rho, sigma = a.values["rho"], a.values["sigma"]
    angles = a.angles
    l, v = angles.lz, angles.vz
    inner = angles.dot - l * v
    if a.spec.variant == "fujii":
        scale = rho / (math.pi * (1.0 + (0.5 - 2 / (3 * math.pi)) * sigma))
        forward = inner.clip(0, 1) / l.maximum(v)
        back = inner.clip(-1, 0)
        level, slope, rise = 1.0, sigma, (forward + back) * sigma
    else:
        s2 = sigma * sigma
        scale, level = rho / math.pi, 1.0 - 0.5 * s2 / (s2 + 0.33)
        slope = 0.45 * s2 / (s2 + 0.09)
        rise = (inner.clip(0, 1) / l.maximum(v)) * slope
    value = (rise + level) * scale
    value = value.clip(0, np.inf)
    # n.l/max(n.l, n.v) <= 1.
    lit = value * l
    bounded = (inner.clip(0, 1) * slope + level) * scale
    lit = Interval(lit.lo, np.minimum(lit.hi, bounded.hi))
    return [a.term("", value, lit, (level / (rise + level)).clip(0, np.inf) if "retro" in a.off else 1.0)]


FAMILIES: Mapping[str, Family] = {
    "lambert": Family(lambda _: (), lambda _: []),
    "oren_nayar": Family(_of_oren_nayar, _oren_nayar),
    "ward": Family(_of_ward, _ward),
    "torrance_sparrow": Family(_of_facets, _facets),
    "cook_torrance": Family(_of_facets, _facets),
    "metallic_roughness": Family(_of_facets, _facets),
    "layered": Family(_of_layered, _layered),
    "kulla_conty": Family(_of_kulla_conty, _kulla_conty),
    "sum": Family(_of_sum, _sum),
    "lafortune": Family(_of_lobes, _lafortune),
    "phong": Family(_of_lobes, _phong),
    "blinn_phong": Family(_of_lobes, _blinn),
}
