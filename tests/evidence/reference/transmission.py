"""Walter et al. 2007: reflection by, and refraction through, a rough interface, seen from either side.

f is the scattering function of radiance: a refracted beam is compressed by (eta_o/eta_i)^2.
"""

from __future__ import annotations

from collections.abc import Mapping

from mpmath import mp, mpf

from fitter.spec import ModelSpec
from tests.evidence.reference.fresnel import dielectric
from tests.evidence.reference.geometry import Half, Pair
from tests.evidence.reference.masking import LAMBDAS, masking
from tests.evidence.reference.ndf import NDFS


def rough_dielectric(spec: ModelSpec, values: Mapping[str, mpf], p: Pair) -> mpf:
    if not p.iz or not p.oz:
        return mpf(0)
    scatter = _reflection if (p.iz > 0) == (p.oz > 0) else _refraction
    return scatter(spec.ndf or "ggx", spec.masking or "smith", values, p)


def _indices(values: Mapping[str, mpf], p: Pair) -> tuple[mpf, mpf]:
    """The index on the side of each direction: 1 above, eta below."""
    return (mpf(1) if p.iz > 0 else values["eta"], mpf(1) if p.oz > 0 else values["eta"])


def _lifted(p: Pair) -> Pair:
    """Lambda of a direction is that of its mirror image in the surface."""
    return p._replace(iz=abs(p.iz), oz=abs(p.oz))


def _reflection(ndf: str, mask: str, values: Mapping[str, mpf], p: Pair) -> mpf:
    side, _ = _indices(values, p)
    relative = values["eta"] if p.iz > 0 else 1 / side
    d, g = NDFS[ndf](values, p.half), masking(mask, ndf, values, _lifted(p))
    return values["ks"] * dielectric(p.cos_d, relative) * d * g / (4 * p.iz * p.oz)


def _refraction(ndf: str, mask: str, values: Mapping[str, mpf], p: Pair) -> mpf:
    eta_i, eta_o = _indices(values, p)
    v = Half(eta_i * p.ix + eta_o * p.ox, eta_i * p.iy + eta_o * p.oy, eta_i * p.iz + eta_o * p.oz)
    length = mp.sqrt(v.squared)
    # h is v normalised and turned to the outside; a facet serves directions it sees from their own side only.
    sign = 1 if v.z > 0 else -1
    to_i = sign * (v.x * p.ix + v.y * p.iy + v.z * p.iz) / length if length else mpf(0)
    to_o = sign * (v.x * p.ox + v.y * p.oy + v.z * p.oz) / length if length else mpf(0)
    if not v.z or to_i * p.iz <= 0 or to_o * p.oz <= 0:
        return mpf(0)
    let_through = _transmitted(eta_i, eta_o, abs(to_i), abs(to_o))
    d, g = NDFS[ndf](values, v), _opposed_masking(mask, ndf, values, p)
    weight = abs(to_i) * abs(to_o) / abs(p.iz * p.oz) * eta_o**2 / v.squared
    return values["kt"] * weight * let_through * d * g


def _transmitted(eta_i: mpf, eta_o: mpf, ci: mpf, co: mpf) -> mpf:
    """1 - F of the cosines on both sides: 4 a b/(a + b)^2 with the ratios a/b of either polarisation."""
    across = 4 * eta_i * ci * eta_o * co / (eta_i * ci + eta_o * co) ** 2
    along = 4 * eta_o * ci * eta_i * co / (eta_o * ci + eta_i * co) ** 2
    return (across + along) / 2


def _opposed_masking(mask: str, ndf: str, values: Mapping[str, mpf], p: Pair) -> mpf:
    """Of directions on opposite sides one sees a point the better the higher it lies, the other the lower:
    Int_0^1 u^L_i (1 - u)^L_o du over the height's distribution (Heitz et al. 2016)."""
    if mask == "smith_separable":
        return masking(mask, ndf, values, _lifted(p))
    found = LAMBDAS[ndf]
    return mp.beta(1 + found(values, p.ix, p.iy, abs(p.iz)), 1 + found(values, p.ox, p.oy, abs(p.oz)))
