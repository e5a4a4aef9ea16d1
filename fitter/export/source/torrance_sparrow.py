"""Torrance-Sparrow with any of its parts: see :mod:`fitter.models.torrance_sparrow` and what it names."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fitter.export.source import microfacets, parts
from fitter.export.source.formula import Argument, Formula, arguments_of
from fitter.models import ReflectanceModel

#: cos theta_d and 1 - cos theta_d of the pair.
_COSINE = "c = 0.5*sqrt(h2)"
_SCHLICK = (
    _COSINE,
    "dx = ix - ox",
    "dy = iy - oy",
    "dz = iz - oz",
    "m = 0.25*(dx*dx + dy*dy + dz*dz)/(1.0 + c)",
    "m5 = m*m*m*m*m",
)
_DIELECTRIC = (
    "# Fresnel's term of a dielectric, with eta^2 - 1 factored out.",
    _COSINE,
    "contrast = (eta - 1.0)*(eta + 1.0)",
    "g = sqrt(max(pick(c*c > 0.5, eta*eta - (1.0 - c)*(1.0 + c), contrast + c*c), 0.0))",
    "across = max(c + g, 1.0e-18)",
    "along = max(eta*eta*c + g, 1.0e-18)",
    "r_s = (contrast/across)/across",
    "r_p = (contrast/along)*((c*c*(eta*eta + 1.0) - 1.0)/along)",
    "entering = 2.0*c*g*(1.0/(across*across) + eta*eta/(along*along))",
    "reflected = pick(entering < 0.5, 1.0 - entering, 0.5*(r_s*r_s + r_p*r_p))",
)
_CONDUCTOR = (
    "# Fresnel's term of a metal; ga + i gb is the root of n^2 - sin^2.",
    _COSINE,
    "sin2 = (1.0 - c)*(1.0 + c)",
    "q = pick(c*c > 0.5, eta*eta - sin2, (eta - 1.0)*(eta + 1.0) + c*c) - kappa*kappa",
    "n2r = (eta - kappa)*(eta + kappa)",
    "n2i = 2.0*eta*kappa",
    "modulus = sqrt(q*q + n2i*n2i)",
    "big = sqrt(max(0.5*(modulus + max(q, -q)), 1.0e-36))",
    "small = eta*kappa/big",
    "ga = pick(q >= 0.0, big, small)",
    "gb = pick(q >= 0.0, small, big)",
    "ac = c + ga",
    "across2 = ac*ac + gb*gb",
    "al_r = c*n2r + ga",
    "al_i = c*n2i + gb",
    "along2 = al_r*al_r + al_i*al_i",
    "br_r = c*c*(n2r + 1.0) - 1.0",
    "br_i = c*c*n2i",
    "minus = (eta - 1.0)*(eta - 1.0) + kappa*kappa",
    "plus = (eta + 1.0)*(eta + 1.0) + kappa*kappa",
    "r_s = (minus/across2)*(plus/across2)",
    "r_p = (minus/along2)*(plus/along2)*(br_r*br_r + br_i*br_i)",
    "entering = 2.0*c*ga*(1.0/across2 + (modulus + sin2)/along2)",
    "reflected = pick(entering < 0.5, 1.0 - entering, 0.5*(r_s + r_p))",
)
_FRESNEL: Mapping[str, tuple[str, ...]] = {
    "none": (), "schlick": _SCHLICK, "dielectric": _DIELECTRIC, "conductor": _CONDUCTOR,
}  # fmt: skip


def formula(model: ReflectanceModel) -> Formula:
    spec = model.spec
    fresnel = spec.fresnel or "none"
    arguments: list[Argument] = arguments_of(model)
    lines = list(parts.HALF)
    masking, more = microfacets.masking(model)
    lines += masking + microfacets.density(model)
    lines += _FRESNEL[fresnel]
    arguments += more + microfacets.constants(model)
    if fresnel == "none":
        lobe, through = "ks*lobe", None
    elif fresnel == "schlick":
        lobe = "ks*(f0 + (1.0 - f0)*m5)*lobe"
        through = "(1.0 - f0)*c*(1.0 + m*(1.0 + m*(1.0 + m*(1.0 + m))))"
    else:
        lobe, through = "ks*reflected*lobe", "entering"
    if spec.diffuse == "coupled":
        assert through is not None
        result = f"kd / PI * {through} + {lobe}"
    else:
        result = parts.with_diffuse(spec.diffuse, lobe)
    used = [a for a in arguments if np.isfinite(a.values).all()]
    return Formula(model.channels, tuple(used), tuple(lines), result)
