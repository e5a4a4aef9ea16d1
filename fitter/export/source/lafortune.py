"""Lafortune's cosine lobes: see :mod:`fitter.models.lafortune`. The coefficients of a lobe stand for its
angles: they are what other programs take."""

from __future__ import annotations

import numpy as np

from fitter.export.source import parts
from fitter.export.source.formula import Argument, Formula, arguments_of, derived
from fitter.models import ReflectanceModel
from fitter.models.lafortune import lobe_coefficients, lobe_suffixes


def formula(model: ReflectanceModel) -> Formula:
    spec, count = model.spec, len(model.channels)
    axes = ("x", "y", "z") if spec.anisotropic else ("xy", "z")
    arguments: list[Argument] = [] if spec.diffuse == "none" else arguments_of(model, ("kd",))
    lines: list[str] = []
    if spec.anisotropic:
        arguments += arguments_of(model, ("psi",))
        lines += [*parts.turn("i", "o"), "px = iu*ou", "py = iv*ov"]
    else:
        lines.append("pxy = ix*ox + iy*oy")
    lines.append("pz = iz*oz")
    terms: list[str] = []
    for s in lobe_suffixes(spec):
        arguments += arguments_of(model, (f"ks{s}", f"n{s}"))
        for axis, c in zip(axes, lobe_coefficients(spec, model.values, s), strict=True):
            about = f"coefficient C{axis} of the lobe, the largest is 1 or -1"
            arguments.append(derived(f"c{axis}{s}", np.asarray(c), about, count))
        lines += [
            f"base{s} = " + " + ".join(f"c{axis}{s}*p{axis}" for axis in axes),
            f"power{s} = pick(base{s} > 0.0, exp(n{s}*log(max(base{s}, 1.0e-37))), 0.0)",
        ]
        terms.append(f"ks{s}*power{s}*(n{s} + 2.0)/(2.0*PI)")
    return Formula(
        model.channels, tuple(arguments), tuple(lines), parts.with_diffuse(spec.diffuse, " + ".join(terms))
    )
