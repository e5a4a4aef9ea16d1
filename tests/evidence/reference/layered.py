"""Weidlich and Wilkie 2007: a rough dielectric interface over another model."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from mpmath import mp, mpf

from fitter.spec import ModelSpec
from tests.evidence.reference.fresnel import dielectric
from tests.evidence.reference.geometry import Pair
from tests.evidence.reference.masking import masking
from tests.evidence.reference.ndf import NDFS

Base = Callable[[Pair], mpf]


def layered(spec: ModelSpec, values: Mapping[str, mpf], p: Pair, base: Base) -> mpf:
    """``base`` is the lower model's value at the directions refracted at the micro-normal h.

    f = F D G/(4 iz oz) + T f_base(wi', wo') exp(-tau (1/iz' + 1/oz')) ((1 - G) + T G), T = 1 - F(cos_d).
    """
    ndf, eta = spec.ndf or "ggx", values["eta"]
    f = dielectric(p.cos_d, eta)
    d, g = NDFS[ndf](values, p.half), masking("smith", ndf, values, p)
    inside = refracted(p, eta)
    if not inside.above:
        raise ArithmeticError("a refracted direction lies below the surface")
    absorbed = mp.exp(-values["tau"] * (1 / inside.iz + 1 / inside.oz))
    below = (1 - f) * base(inside) * absorbed * ((1 - g) + (1 - f) * g)
    return f * d * g / (4 * p.iz * p.oz) + below


def refracted(p: Pair, eta: mpf) -> Pair:
    """Both directions inside the layer, pointing up: w/eta + (c' - c/eta) h with c' the inner cosine at h."""
    half, c = p.half, p.cos_d
    inner = mp.sqrt(1 - p.sin2_d / eta**2)
    # h = H/(2c).
    along = (inner - c / eta) / (2 * c)
    turned = [w / eta + along * h for w, h in zip(p, (*half, *half), strict=True)]
    return Pair(*turned)
