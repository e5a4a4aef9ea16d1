"""He, Torrance, Sillion and Greenberg 1991 for unpolarised light: the directional-diffuse term.

sigma and tau are in wavelengths, H = wi + wo is not normalised, alpha = 2 sigma/tau. Lambda in the shadowing
is that of Smith 1967 for Gaussian slopes. The ideal component is a delta and no part of this.
"""

from __future__ import annotations

from collections.abc import Mapping

from mpmath import mp, mpf

from fitter.spec import ModelSpec
from tests.evidence.reference.fresnel import fresnel
from tests.evidence.reference.geometry import Pair


def he_torrance(spec: ModelSpec, values: Mapping[str, mpf], p: Pair) -> mpf:
    sigma, tau = abs(values["sigma"]), values["tau"]
    if not sigma:
        return mpf(0)
    half = p.half
    (seen_i, k_i), (seen_o, k_o) = (_shadowing(sigma, tau, *w) for w in (p[:3], p[3:]))
    # sqrt(pi/2) z = sigma/4 (K_i + K_o) exp(-z^2/(2 sigma^2)); q = (z/sigma)^2, q e^q = (K_i + K_o)^2/(8 pi).
    q = mp.lambertw((k_i + k_o) ** 2 / (8 * mp.pi)).real
    g = (2 * mp.pi * half.z * sigma) ** 2 / (1 + q)
    total = _series(g, (mp.pi * tau) ** 2 * (half.x**2 + half.y**2))
    f = fresnel("conductor", values, p)
    geometry = (half.squared / half.z) ** 2 * mp.pi * tau**2 / 4
    return f * seen_i * seen_o * geometry * total / (p.iz * p.oz)


def _shadowing(sigma: mpf, tau: mpf, x: mpf, y: mpf, z: mpf) -> tuple[mpf, mpf]:
    """S of one direction, and K = tan erfc(tau cot/(2 sigma))."""
    tan = mp.hypot(x, y) / z
    if not tan:
        return mpf(1), mpf(0)
    a = tau / (2 * sigma * tan)
    beyond = mp.erfc(a)
    smith = mp.exp(-a * a) / (2 * a * mp.sqrt(mp.pi)) - beyond / 2
    return (1 - beyond / 2) / (1 + smith), tan * beyond


def _series(g: mpf, a: mpf) -> mpf:
    """sum_m g^m e^-g/(m! m) e^(-a/m), m = 1, 2, ...: every term from the largest down to 1e-55 of it."""
    # Terms grow while g/m exp(a/m^2) > 1.
    top = max(1, int(g * mp.exp(mp.lambertw(2 * a / g**2).real / 2)))
    largest = mp.exp(top * mp.log(g) - g - mp.loggamma(top + 1) - mp.log(top))
    total = largest * mp.exp(-a / top)
    small = mpf("1e-55") * total
    for step in (1, -1):
        term, m = largest, top
        while m + step >= 1:
            term = term * g * m / (m + 1) ** 2 if step == 1 else term * m * m / (g * (m - 1))
            m += step
            added = term * mp.exp(-a / m)
            total += added
            if added < small:
                break
    return total
