"""Effects of a material: which there are, and enclosures of what a value is without them.

A value is a sum of terms (a diffuse one, a specular one), a term a product of factors. Leaving effects out
multiplies each term by a ratio, whose enclosure is the product of those of its factors' ratios, written so
that a variable appears as seldom as it can (masking's by 1/cos: once). What is bounded is sum |ratio - 1|
term / sum term.

The substitutes: diffuse, specular -> absent; fresnel -> a constant, per channel; masking -> none, or for
GGX's height-correlated Smith term that of E. Hammon 2017, 0.5/((1 - alpha) 2 n.l n.v + alpha (n.l + n.v)),
whose relative error is below 1 - sqrt((1 + alpha)/2); anisotropy -> the geometric mean of both roughnesses;
retro (of Oren-Nayar) -> its constant part.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitter.models import ReflectanceModel, composite
from fitter.models.lafortune import lobe_suffixes
from fitter.scene import coats, cosine_lobes, factors, multiple
from fitter.scene.facets import as_facets, model_as_facets
from fitter.scene.intervals import Interval, increasing
from fitter.scene.surfaces import Angles
from fitter.spec import ModelSpec

FloatArray = NDArray[np.float64]
Off = frozenset[str]

#: In words, for the plan.
WORDS: Mapping[str, str] = {
    "diffuse": "diffuse base", "specular": "specular lobe", "fresnel": "Fresnel variation",
    "masking": "masking-shadowing", "hammon": "exact masking-shadowing", "anisotropy": "anisotropy",
    "retro": "retro-reflection of the rough diffuse base", "multiple": "multiple scattering",
    "coat": "reflection of the coat", "passage": "variation of what passes the coat",
    "lobe1": "first lobe", "lobe2": "second lobe", "lobe3": "third lobe",
    **{f"component_{letter}": f"component {letter}" for letter in "abcdef"},
}  # fmt: skip


@dataclass(frozen=True)
class Term:
    """An additive part of a value, the same times n.l, and what they are multiplied by."""

    value: Interval
    lit: Interval
    ratio: Interval


@dataclass(frozen=True)
class Asked:
    """One channel of a model over boxes, without what is ``off``."""

    spec: ModelSpec
    values: Mapping[str, float]
    off: Off
    constants: Mapping[str, Any]
    angles: Angles
    channel: int

    def constant(self, factor: str) -> Interval:
        """What replaces a factor."""
        return Interval.of(np.asarray(self.constants[factor])[self.channel])

    def term(
        self, effect: str, value: Interval, lit: Interval | None = None, ratio: float | Interval = 1.0
    ) -> Term:
        """A term that is absent without ``effect``; else ``ratio`` is what it is multiplied by."""
        shape = self.angles.lz.lo.shape
        left = 0.0 if effect in self.off else ratio
        left = left if isinstance(left, Interval) else Interval.of(np.full(shape, left))
        return Term(value, value * self.angles.lz if lit is None else lit, left)


@dataclass(frozen=True)
class Family:
    """What is known of a family: the effects of a model, None where nothing is proved of it, and its terms
    but for an additive diffuse one."""

    effects: Callable[[ReflectanceModel], Sequence[str] | None]
    terms: Callable[[Asked], list[Term]]


def effects(model: ReflectanceModel) -> tuple[str, ...]:
    """The effects of a model that can be left out with a bound."""
    return tuple(_known(model) or ())


def unbounded(model: ReflectanceModel) -> str | None:
    """Why nothing of a model is left out, where nothing is proved of it."""
    if _known(model) is None:
        return f"nothing is proved of the effects of {model.spec.name}: all kept"
    return None


def compatible(off: Off) -> bool:
    """Whether a set of effects makes sense together: nothing of a lobe that is absent, one masking."""
    lobe = off & {"fresnel", "masking", "hammon", "anisotropy"}
    if "specular" in off and (lobe or "diffuse" in off):
        return False
    return not {"masking", "hammon"} <= off


def _known(model: ReflectanceModel) -> Sequence[str] | None:
    family = FAMILIES.get(model.spec.family)
    return family.effects(model) if family else None


def of_channel(model: ReflectanceModel, channel: int) -> dict[str, float]:
    """The parameters of one channel."""
    return {
        name: float(np.asarray(value).reshape(-1)[channel if np.size(value) > 1 else 0])
        for name, value in model.values.items()
    }


def terms(
    model: ReflectanceModel, off: Off, constants: Mapping[str, Any], angles: Angles, channel: int
) -> list[Term]:
    """The terms of one channel over boxes."""
    return _terms(Asked(model.spec, of_channel(model, channel), off, constants, angles, channel))


def _terms(asked: Asked) -> list[Term]:
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
            entering = 1.0 - factors.reflectance(spec, asked.values, factors.facet_cosine(angles))
            ratio = (1.0 - asked.constant("fresnel")) / entering if "fresnel" in off else 1.0
            found.append(asked.term("diffuse", level * entering.clip(0, 1), ratio=ratio))
        else:
            found.append(asked.term("diffuse", level))
    zero = Interval.of(np.zeros(angles.lz.lo.shape))
    return found or [asked.term("", zero, zero)]


def relative(parts: list[Term]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Upper bounds over boxes: of the relative error of the sum, and times n.l of its error and of the
    sum."""
    shape = parts[0].value.lo.shape if parts else (0,)
    error, absolute, total = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for k, part in enumerate(parts):
            wrong = (part.ratio - 1.0).abs_hi()
            rest = sum((other.value.lo for j, other in enumerate(parts) if j != k), np.zeros(shape))
            share = np.where(part.value.hi > 0, 1.0 / (1.0 + rest / part.value.hi), 0.0)
            error += np.where((wrong > 0) & (share > 0), wrong * share, 0.0)
            absolute += np.where((wrong > 0) & (part.lit.hi > 0), wrong * part.lit.hi, 0.0)
            total += part.lit.hi
    # Three roundings to nearest of positive numbers a term.
    return tuple(x * (1 + 1e-14) for x in (error, absolute, total))  # pyright: ignore[reportReturnType]


# Families -------------------------------------------------------------------------------------------


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
    base = composite.parts(model)[0]
    # Tangents are not followed beneath the coat.
    return None if _known(base) is None or base.spec.anisotropic else ("coat", "passage")


def _layered(a: Asked) -> list[Term]:
    value, lit, _ = coats.top(a.spec, a.values, a.angles)
    passed = coats.passage(a.spec, a.values, a.angles)
    ratio = a.constant("passage") / passed if "passage" in a.off else 1.0
    (base,) = _components(a)
    parts = _terms(replace(base, angles=coats.beneath(a.values, a.angles)))
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
    if any(_known(part) is None for part in composite.parts(model)):
        return None
    return component_names(model.spec)


def _sum(a: Asked) -> list[Term]:
    return [
        a.term(name, part.value, part.lit)
        for name, component in zip(component_names(a.spec), _components(a), strict=True)
        for part in _terms(component)
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


#: Where a family is added: its effects, its enclosures and, in :mod:`fitter.scene.shading`, its substitutes.
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
