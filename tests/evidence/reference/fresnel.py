"""Fresnel reflectance at c = cos theta_d, unpolarised."""

from __future__ import annotations

from collections.abc import Mapping

from mpmath import mp, mpc, mpf

from tests.evidence.reference.geometry import Pair


def dielectric(c: mpf, eta: mpf) -> mpf:
    """Both polarisations from the amplitude ratios of a real index (Born and Wolf, section 1.5); 1 beyond
    the critical angle."""
    g2 = eta * eta - 1 + c * c
    if g2 <= 0:
        return mpf(1)
    g = mp.sqrt(g2)
    across = (c - g) / (c + g)
    along = (eta * eta * c - g) / (eta * eta * c + g)
    return (across**2 + along**2) / 2


def conductor(c: mpf, eta: mpf, kappa: mpf) -> mpf:
    """The same ratios with the complex index eta + i kappa."""
    index2 = mpc(eta, kappa) ** 2
    g = mp.sqrt(index2 - 1 + c * c)
    across = (c - g) / (c + g)
    along = (index2 * c - g) / (index2 * c + g)
    return (abs(across) ** 2 + abs(along) ** 2) / 2


def fresnel(kind: str, values: Mapping[str, mpf], p: Pair) -> mpf:
    """F of the named form at the half vector of the pair."""
    if kind == "none":
        return mpf(1)
    if kind == "schlick":
        return values["f0"] + (1 - values["f0"]) * p.schlick
    if kind == "dielectric":
        return dielectric(p.cos_d, values["eta"])
    if kind == "conductor":
        return conductor(p.cos_d, values["eta"], values["kappa"])
    raise LookupError(f"no reference for the Fresnel form {kind!r}")
