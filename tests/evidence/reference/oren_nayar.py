"""Oren and Nayar 1994 (qualitative, full with interreflection), Fujii 2012, EON (Portsmouth et al. 2025)."""

from __future__ import annotations

from collections.abc import Mapping

from mpmath import mp, mpf

from fitter.spec import ModelSpec
from tests.evidence.reference.geometry import Pair


def oren_nayar(spec: ModelSpec, values: Mapping[str, mpf], p: Pair) -> mpf:
    found = {"qualitative": qualitative, "full": full, "fujii": fujii, "eon": eon}
    return found[spec.variant or "qualitative"](values["rho"], values["sigma"], p)


def qualitative(rho: mpf, sigma: mpf, p: Pair) -> mpf:
    s2 = sigma * sigma
    a = 1 - s2 / (2 * (s2 + mpf("0.33")))
    b = mpf("0.45") * s2 / (s2 + mpf("0.09"))
    return rho / mp.pi * (a + b * max(mpf(0), p.across) / max(p.iz, p.oz))


def full(rho: mpf, sigma: mpf, p: Pair) -> mpf:
    """Angles are atan2(sqrt(x^2 + y^2), z); cos dphi is taken as 0 where a direction is the normal: every
    term it enters is 0 there."""
    s2, sin_i, sin_o = sigma * sigma, mp.hypot(p.ix, p.iy), mp.hypot(p.ox, p.oy)
    i, o = (mp.atan2(sin_i, p.iz), sin_i, p.iz), (mp.atan2(sin_o, p.oz), sin_o, p.oz)
    (alpha, sin_a, _), (beta, sin_b, cos_b) = (i, o) if i[0] >= o[0] else (o, i)
    cos_dphi = p.across / (sin_i * sin_o) if sin_i and sin_o else mpf(0)
    q = s2 / (s2 + mpf("0.09"))
    c1 = 1 - s2 / (2 * (s2 + mpf("0.33")))
    c2 = mpf("0.45") * q * (sin_a - (0 if cos_dphi >= 0 else (2 * beta / mp.pi) ** 3))
    c3 = q / 8 * (4 * alpha * beta / mp.pi**2) ** 2
    direct = c1 + cos_dphi * c2 * sin_b / cos_b + (1 - abs(cos_dphi)) * c3 * mp.tan((alpha + beta) / 2)
    twice = mpf("0.17") * s2 / (s2 + mpf("0.13")) * (1 - cos_dphi * (2 * beta / mp.pi) ** 2)
    return (rho * direct + rho * rho * twice) / mp.pi


def _grazing_gain() -> mpf:
    """1/2 - 2/(3 pi): what Fujii's normalisation 1/A_F adds for each unit of sigma."""
    return mpf(1) / 2 - 2 / (3 * mp.pi)


def fujii(rho: mpf, sigma: mpf, p: Pair) -> mpf:
    s = p.across
    t = max(p.iz, p.oz) if s > 0 else mpf(1)
    return rho / mp.pi / (1 + _grazing_gain() * sigma) * (1 + sigma * s / t)


def fujii_albedo_loss(sigma: mpf, x: mpf, y: mpf, z: mpf) -> mpf:
    """1 - E_F of a direction for rho = 1: A sigma (grazing gain - G/pi), 0 at sigma = 0."""
    sin = mp.hypot(x, y)
    g = sin * (mp.atan2(sin, z) - sin * z) + mpf(2) / 3 * (z * sin * (1 + sin + sin**2) / (1 + sin) - sin)
    return sigma * (_grazing_gain() - g / mp.pi) / (1 + _grazing_gain() * sigma)


def eon(rho: mpf, sigma: mpf, p: Pair) -> mpf:
    a = 1 / (1 + _grazing_gain() * sigma)
    # 1 - Eavg = sigma times this; the product of the losses has sigma^2.
    average_slope = a * (_grazing_gain() - mpf(2) / 3 + 28 / (15 * mp.pi))
    average = 1 - sigma * average_slope
    rho_ms = rho * rho * average / (1 - rho * (1 - average))
    slope_i = fujii_albedo_loss(sigma, p.ix, p.iy, p.iz)
    loss_o = _loss_slope(sigma, p.ox, p.oy, p.oz)
    return fujii(rho, sigma, p) + rho_ms / mp.pi * slope_i * loss_o / average_slope


def _loss_slope(sigma: mpf, x: mpf, y: mpf, z: mpf) -> mpf:
    """fujii_albedo_loss / sigma, which has no 0/0 at sigma = 0."""
    return fujii_albedo_loss(mpf(1), x, y, z) * (1 + _grazing_gain()) / (1 + _grazing_gain() * sigma)
