"""A Mitsuba 3 scene snippet with its ``principled`` BSDF, refitted."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fitter.export.mitsuba_xml import snippet
from fitter.export.principled import principled
from fitter.export.refit import Unknown, refit
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject

_UNKNOWNS = (
    Unknown("base_color", 0.0, 1.0, (0.3,), per_channel=True),
    Unknown("metallic", 0.0, 1.0, (0.05, 0.9)),
    Unknown("roughness", 0.04, 1.0, (0.2, 0.6)),
    Unknown("specular", 0.01, 1.0, (0.5,)),
)


def write(subject: Subject, path: Path) -> Written:
    found = refit(subject, "Mitsuba principled", _UNKNOWNS, principled)
    values = found.values
    colour = np.broadcast_to(values["base_color"], (3,)).tolist()
    numbers = {name: float(values[name]) for name in ("metallic", "roughness", "specular")}
    snippet(path, subject, found, "principled", {}, {"base_color": colour}, numbers)
    return Written((found.note(),), found.residuals())


TARGET = Target(
    "mitsuba-principled", "Mitsuba 3 scene snippet with its principled BSDF, a refit", True, True, ".xml",
    "linear RGB and numbers of Mitsuba's own model; roughness is the root of alpha", write, "application/xml",
    channels=(1, 3),
)  # fmt: skip
