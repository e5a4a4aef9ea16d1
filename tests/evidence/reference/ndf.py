"""Normal distributions D of an unnormalised half vector, 1/sr; each has Int D cos dw = 1.

Beckmann and Spizzichino 1963; Walter et al. 2007 (GGX, after Trowbridge and Reitz 1975); Blinn 1977;
Torrance and Sparrow 1967 (Gaussian in the angle, normalised over the hemisphere).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

from mpmath import mp, mpc, mpf

from tests.evidence.reference.geometry import Half


def widths(values: Mapping[str, mpf]) -> tuple[mpf, mpf, mpf]:
    """alpha_x, alpha_y and psi; the isotropic alpha is both, with psi = 0."""
    if "alpha" in values:
        return values["alpha"], values["alpha"], mpf(0)
    return values["alpha_x"], values["alpha_y"], values["psi"]


def slope2(values: Mapping[str, mpf], half: Half) -> mpf:
    """((Hx'/ax)^2 + (Hy'/ay)^2)/Hz^2."""
    ax, ay, psi = widths(values)
    turned = half.turned(psi)
    return ((turned.x / ax) ** 2 + (turned.y / ay) ** 2) / half.z**2


def beckmann(values: Mapping[str, mpf], half: Half) -> mpf:
    ax, ay, _ = widths(values)
    return mp.exp(-slope2(values, half)) * (1 + half.tan2) ** 2 / (mp.pi * ax * ay)


def ggx(values: Mapping[str, mpf], half: Half) -> mpf:
    ax, ay, _ = widths(values)
    return (1 + half.tan2) ** 2 / (mp.pi * ax * ay * (1 + slope2(values, half)) ** 2)


def blinn(values: Mapping[str, mpf], half: Half) -> mpf:
    n = values["n"]
    return (n + 2) / (2 * mp.pi) * (1 + half.tan2) ** (-n / 2)


def gaussian(values: Mapping[str, mpf], half: Half) -> mpf:
    theta = mp.atan(mp.sqrt(half.tan2))
    return mp.exp(-((theta / values["s"]) ** 2)) / gaussian_weight(values["s"])


@lru_cache(maxsize=4096)
def gaussian_weight(s: mpf) -> mpf:
    """2 pi Int_0^(pi/2) exp(-(t/s)^2) cos t sin t dt = pi Im Int exp(-(t/s)^2 + 2 i t) dt, by erf."""
    end = mp.erf(mpc(mp.pi / (2 * s), -s)) + mp.erf(mpc(0, s))
    return mp.pi * s * mp.sqrt(mp.pi) / 2 * mp.exp(-s * s) * end.imag


NDFS = {"beckmann": beckmann, "ggx": ggx, "blinn": blinn, "gaussian": gaussian}
