"""Effects of a material: which there are, and enclosures of what a value is without them.

A value is a sum of terms (a diffuse one, a specular one), a term a product of factors. Leaving effects out
multiplies each term by a ratio, whose enclosure is the product of those of its factors' ratios, written so
that a variable appears as seldom as it can (masking's by 1/cos: once). What is bounded is sum |ratio - 1|
term / sum term.

The substitutes: diffuse, specular, lobes, components, multiple scattering, a coat's reflection -> absent;
fresnel (of a coupled diffuse term, too) and what passes a coat -> a constant, per channel; masking -> none,
or for GGX's height-correlated Smith term that of E. Hammon 2017, 0.5/((1 - alpha) 2 n.l n.v
+ alpha (n.l + n.v)), whose relative error is below 1 - sqrt((1 + alpha)/2); anisotropy -> the geometric mean
of both roughnesses; retro (of Oren-Nayar) -> its constant part.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.models import ReflectanceModel
from fitter.scene import families
from fitter.scene.boxes import Angles
from fitter.scene.terms import Asked, Off, Term

FloatArray = NDArray[np.float64]

#: In words, for the plan.
WORDS: Mapping[str, str] = {
    "diffuse": "diffuse base", "specular": "specular lobe", "fresnel": "Fresnel variation",
    "masking": "masking-shadowing", "hammon": "exact masking-shadowing", "anisotropy": "anisotropy",
    "retro": "retro-reflection of the rough diffuse base", "multiple": "multiple scattering",
    "coat": "reflection of the coat", "passage": "variation of what passes the coat",
    "lobe1": "first lobe", "lobe2": "second lobe", "lobe3": "third lobe",
    **{f"component_{letter}": f"component {letter}" for letter in "abcdef"},
}  # fmt: skip


def effects(model: ReflectanceModel) -> tuple[str, ...]:
    """The effects of a model that can be left out with a bound."""
    return tuple(families.known(model) or ())


def unbounded(model: ReflectanceModel) -> str | None:
    """Why nothing of a model is left out, where nothing is proved of it."""
    if families.known(model) is None:
        return f"nothing is proved of the effects of {model.spec.name}: all kept"
    return None


def compatible(off: Off) -> bool:
    """Whether a set of effects makes sense together: nothing of a lobe that is absent, one masking."""
    lobe = off & {"fresnel", "masking", "hammon", "anisotropy"}
    if "specular" in off and (lobe or "diffuse" in off):
        return False
    return not {"masking", "hammon"} <= off


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
    return families.terms(Asked(model.spec, of_channel(model, channel), off, constants, angles, channel))


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
