"""A Mitsuba 3 scene snippet with its ``roughconductor`` BSDF, refitted: for metals.

Mitsuba's is GGX with the separable Smith term and the exact Fresnel term of a metal, times a tint; here the
tint is 1, so that eta and k say how much is reflected, and only they.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitter.export import sampling
from fitter.export.mitsuba_xml import snippet
from fitter.export.refit import Unknown, of_ours, refit
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject

FloatArray = NDArray[np.float64]

_MODEL = "torrance_sparrow:ggx:smith_separable:conductor:no_diffuse"
_UNKNOWNS = (
    Unknown("eta", 0.02, 10.0, (1.5, 0.3), per_channel=True, log=True),
    Unknown("kappa", 0.0, 20.0, (2.0,), per_channel=True),
    Unknown("alpha", 1e-3, 1.0, (0.05, 0.2, 0.6), log=True),
)


def write(subject: Subject, path: Path) -> Written:
    sampling.isotropic(subject, "this snippet")
    ours = of_ours(_MODEL, len(subject.channels))

    def evaluate(values: Mapping[str, FloatArray], wi: FloatArray, wo: FloatArray) -> FloatArray:
        return ours({**values, "ks": np.ones(())}, wi, wo)

    found = refit(subject, "Mitsuba roughconductor", _UNKNOWNS, evaluate)
    values = found.values
    colours = {
        name: np.broadcast_to(values[key], (3,)).tolist() for name, key in (("eta", "eta"), ("k", "kappa"))
    }
    words = {"distribution": "ggx"}
    snippet(path, subject, found, "roughconductor", words, colours, {"alpha": float(values["alpha"])})
    return Written((found.note(),), found.residuals())


TARGET = Target(
    "mitsuba-conductor", "Mitsuba 3 scene snippet with its roughconductor BSDF, a refit", True, True,
    ".xml", "eta and k in linear RGB; alpha is the rms slope times sqrt(2)", write, "application/xml",
    channels=(1, 3),
)  # fmt: skip
