"""Enclosures of a coat over a base: its reflection, what passes it twice, and the directions beneath it.

In the terms of :mod:`fitter.models.layered`: T (1 - F G) a, in which F falls twice and G and a once, and, of
wi' and wo', mirrored in the half vector as wi and wo are,

    cos_i' = p cos_i + m cos_o,    cos_o' = m cos_i + p cos_o,    wi'.wo' = 1 - (1 - wi.wo)/n^2.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from fitter.scene import factors, fresnel
from fitter.scene.boxes import Angles
from fitter.scene.intervals import Interval
from fitter.spec import ModelSpec

_NOTHING = frozenset[str]()


def top(
    spec: ModelSpec, values: Mapping[str, float], angles: Angles
) -> tuple[Interval, Interval, Interval]:
    """The coat's own reflection, that times n.l, and 1."""
    return factors.facets(_facets(spec), values, _NOTHING, {}, angles, 0)


def passage(spec: ModelSpec, values: Mapping[str, float], angles: Angles) -> Interval:
    """What passes the coat twice, absorption included."""
    own = _facets(spec)
    f = fresnel.reflectance(own, values, fresnel.facet_cosine(angles))
    g = factors.unshadowed(own, values, angles)
    found = (1.0 - f) * (1.0 - f * g)
    if values["tau"] > 0:
        below = beneath(values, angles)
        found = found * (-(below.lz.reciprocal() + below.vz.reciprocal()) * values["tau"]).exp()
    return found.clip(0, 1)


def beneath(values: Mapping[str, float], angles: Angles) -> Angles:
    """The angles of the refracted directions; their tangents are not followed."""
    eta = values["eta"]
    n2 = Interval.of(np.asarray(eta)).squared()
    c = fresnel.facet_cosine(angles)
    r = (n2 - 1.0 + c.squared()).clip(0, np.inf).sqrt()
    own = (r / c + 1.0) * (0.5 / eta)
    other = (n2 - 1.0) / (c * (r + c)) * (0.5 / eta)
    l, v = angles.lz, angles.vz
    whole = Interval(np.full(l.lo.shape, -1.0), np.full(l.lo.shape, 1.0))
    return dataclasses.replace(
        angles, lz=(own * l + other * v).clip(0, 1), vz=(other * l + own * v).clip(0, 1),
        dot=(1.0 - (1.0 - angles.dot) / n2).clip(-1, 1), l=(whole, whole), v=(whole, whole),
        kept={},
    )  # fmt: skip


def _facets(spec: ModelSpec) -> ModelSpec:
    return ModelSpec(
        family="torrance_sparrow", ndf=spec.ndf, masking="smith", fresnel="dielectric", diffuse="none"
    )
