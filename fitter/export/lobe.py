"""The lobe of a model about the half vector, from its parameters: where a table of it needs its samples."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from fitter.export.subject import Subject
from fitter.formats.rgl_writer import NARROWEST, WIDEST, Lobe

FloatArray = NDArray[np.float64]


def _half(n: FloatArray) -> FloatArray:
    """Roughness of a power of the half vector's cosine."""
    return np.sqrt(2.0 / (n + 2.0))


def _mirrored(n: FloatArray) -> FloatArray:
    """Roughness of a power of a cosine about the mirror direction, whose angle is twice that of the half
    vector."""
    return np.sqrt(1.0 / (2.0 * n + 1.0))


#: What a parameter of that name says of GGX's alpha.
_WIDTHS: Mapping[str, Callable[[FloatArray], FloatArray]] = {
    "alpha": lambda a: a, "alpha_x": lambda a: a, "alpha_y": lambda a: a, "s": lambda s: s,
    "roughness": np.square, "nu": _half, "nv": _half,
}  # fmt: skip
#: Powers are of the half vector's cosine in these families, of the mirror direction's in others.
_OF_HALF = ("torrance_sparrow", "blinn_phong")
#: Below this share of the diffuse scale a specular one counts as none.
_FAINT = 1e-3
#: Before the parameters of a component, and behind those of one of several lobes.
_AFFIXES = re.compile(r"^(?:(?:[a-f]|base|facet)_)+|_\d$")


def lobe_of(subject: Subject) -> Lobe:
    """The narrowest lobe: a model's own axes and roughness where it has them, else one that is wide enough
    for what has no lobe. No narrower than float32's directions can tell apart."""
    assert subject.model is not None
    model = subject.model
    values = {name: np.asarray(value, np.float64) for name, value in model.values.items()}
    if "kd" in values and "ks" in values and values["ks"].max() < _FAINT * values["kd"].max():
        # A lobe that nobody sees: its roughness means nothing.
        return Lobe(WIDEST, WIDEST)
    if "alpha_x" in values:
        along, across = (_held(float(values[k].min())) for k in ("alpha_x", "alpha_y"))
        return Lobe(along, across, float(values["psi"].mean()))
    power = _half if model.spec.family in _OF_HALF else _mirrored
    found = [
        float(width(value).min())
        for name, value in values.items()
        if (width := {**_WIDTHS, "n": power}.get(_AFFIXES.sub("", name))) is not None
    ]
    alpha = _held(min(found, default=WIDEST))
    return Lobe(alpha, alpha)


def _held(alpha: float) -> float:
    return min(max(alpha, NARROWEST), 1.0)
