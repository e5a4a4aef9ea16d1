"""ks F D G/(4 cos cos): Torrance and Sparrow 1967, Cook and Torrance 1982 (with 4 where they have pi)."""

from __future__ import annotations

from collections.abc import Mapping

from mpmath import mp, mpf

from fitter.spec import ModelSpec
from tests.evidence.reference.fresnel import fresnel
from tests.evidence.reference.geometry import Pair
from tests.evidence.reference.masking import masking
from tests.evidence.reference.ndf import NDFS


def torrance_sparrow(spec: ModelSpec, values: Mapping[str, mpf], p: Pair) -> mpf:
    return microfacets(
        spec.ndf or "beckmann", spec.masking or "v_groove", spec.fresnel or "schlick", values, p
    )


def microfacets(ndf: str, mask: str, kind: str, values: Mapping[str, mpf], p: Pair) -> mpf:
    """The specular term of named parts."""
    d, g, f = NDFS[ndf](values, p.half), masking(mask, ndf, values, p), fresnel(kind, values, p)
    return values["ks"] * f * d * g / (4 * p.iz * p.oz)


def coupled(spec: ModelSpec, values: Mapping[str, mpf], p: Pair) -> mpf:
    """The diffuse term that gets what the facets let through, kd/pi (1 - F)."""
    return values["kd"] / mp.pi * (1 - fresnel(spec.fresnel or "schlick", values, p))
