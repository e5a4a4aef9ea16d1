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
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.models import ReflectanceModel
from fitter.scene import factors
from fitter.scene.boxes import Angles
from fitter.scene.intervals import Interval, increasing
from fitter.spec import ModelSpec

FloatArray = NDArray[np.float64]
Off = frozenset[str]

#: In words, for the plan.
WORDS: Mapping[str, str] = {
    "diffuse": "diffuse base", "specular": "specular lobe", "fresnel": "Fresnel variation",
    "masking": "masking-shadowing", "hammon": "exact masking-shadowing", "anisotropy": "anisotropy",
    "retro": "retro-reflection of the rough diffuse base",
}  # fmt: skip
_FACETS = ("torrance_sparrow", "cook_torrance")


def effects(model: ReflectanceModel) -> tuple[str, ...]:
    """The effects of a model that can be bounded; none of families (or forms) that nothing is proved of."""
    spec = model.spec
    if any(np.ndim(v) for name, v in model.nonlinear.items() if name not in ("eta", "kappa")):
        # Roughness per channel: the substitutes are written for one.
        return ()
    if spec.family == "oren_nayar":
        return ("retro",) if spec.variant in ("qualitative", "fujii") and _rough(model) else ()
    if spec.family == "ward":
        found = ["specular"] if spec.diffuse != "none" else []
        found += ["diffuse"] if spec.diffuse != "none" else []
        return (*found, "anisotropy") if spec.anisotropic else tuple(found)
    if spec.family in _FACETS and _bounded(spec):
        found = ["diffuse", "specular"] if spec.diffuse != "none" else []
        found += ["fresnel"] if spec.fresnel not in (None, "none") and spec.diffuse != "coupled" else []
        found += ["masking"]
        hammon = spec.ndf == "ggx" and spec.masking == "smith" and not spec.anisotropic
        # Its bounds are those of a roughness up to 1.
        found += ["hammon"] if hammon and float(np.max(np.asarray(model.values["alpha"]))) <= 1 else []
        return (*found, "anisotropy") if spec.anisotropic else tuple(found)
    return ()


def unbounded(model: ReflectanceModel) -> str | None:
    """Why nothing of a model is left out, where nothing is proved of it."""
    if effects(model) or model.spec.family == "lambert":
        return None
    if model.spec.family == "oren_nayar" and not _rough(model):
        return None
    return f"nothing is proved of the effects of {model.spec.name}: all kept"


def compatible(off: Off) -> bool:
    """Whether a set of effects makes sense together: nothing of a lobe that is absent, one masking."""
    lobe = off & {"fresnel", "masking", "hammon", "anisotropy"}
    if "specular" in off and (lobe or "diffuse" in off):
        return False
    return not {"masking", "hammon"} <= off


def _rough(model: ReflectanceModel) -> bool:
    return bool(np.any(np.asarray(model.values["sigma"]) > 0))


def _bounded(spec: ModelSpec) -> bool:
    return (
        spec.ndf in ("ggx", "beckmann") and spec.masking in ("smith", "smith_separable", "v_groove", None)
        and spec.fresnel in ("schlick", "dielectric", "conductor", "none", None)
        and not (spec.ndf == "beckmann" and spec.anisotropic)
        and not (spec.anisotropic and spec.masking != "smith")
        and spec.diffuse != "coupled"
    )  # fmt: skip


@dataclass(frozen=True)
class Term:
    """An additive part of a value, the same times n.l, and what they are multiplied by."""

    value: Interval
    lit: Interval
    ratio: Interval


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
    values = of_channel(model, channel)
    spec = model.spec
    shape = angles.lz.lo.shape
    one = Interval.of(np.ones(shape))
    none = Interval.of(np.zeros(shape))
    found: list[Term] = []
    base = values.get("kd", 0.0)
    if spec.family == "oren_nayar":
        return [_oren_nayar(spec, values, off, angles)]
    if base > 0:
        level = base / math.pi
        value = increasing(level * one.lo, level * one.hi)
        found.append(Term(value, value * angles.lz, none if "diffuse" in off else one))
    if spec.family == "lambert" or values.get("ks", 0.0) == 0:
        return found or [Term(none, none, one)]
    if spec.family == "ward":
        value, ratio = factors.ward(spec, values, off, angles)
        lit = value * angles.lz
    else:
        value, lit, ratio = factors.facets(spec, values, off, constants, angles, channel)
    found.append(Term(value * values["ks"], lit * values["ks"], none if "specular" in off else ratio))
    return found


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


def _oren_nayar(spec: ModelSpec, values: Mapping[str, float], off: Off, angles: Angles) -> Term:
    rho, sigma = values["rho"], values["sigma"]
    l, v = angles.lz, angles.vz
    inner = angles.dot - l * v
    if spec.variant == "fujii":
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
    ratio = (level / (rise + level)).clip(0, np.inf) if "retro" in off else Interval.of(np.ones(l.lo.shape))
    return Term(value, lit, ratio)
