"""OpenPBR's opaque base, as far as refits use it: MaterialX's ``open_pbr_surface`` without coat, fuzz, film.

OpenPBR Surface 1.1 (Academy Software Foundation) in the form of MaterialX's graph. With V the viewer, h the
half vector, c = V.h, m = base_metalness, alpha_x = r^2 sqrt(2/(1 + (1 - a)^2)) and alpha_y = (1 - a) alpha_x
of roughness r and anisotropy a, D of GGX, G Smith's height-correlated term at alpha = sqrt(alpha_x alpha_y):

    f = m S(F_metal) + (1 - m) [S(F_eta) specular_color + (1 - E(V)) f_EON(base_color, diffuse_roughness)]
    S(F) = F D G (1 + F (1 - E_1)/E_1) / (4 cos_i cos_o)
    F_metal = F0 + (1 - F0)(1 - c)^5 - b c (1 - c)^6, which is specular_color times Schlick's at c = 1/7
    E(V) = (F0 A + B)(1 + F (1 - E_1)/E_1),  E_1 = A + B,

A and B the albedo of GGX at V for F = 1 - (1 - c)^5 and (1 - c)^5. MaterialX fits these two by polynomials;
here they are integrated. By them f depends on which of the two directions is the viewer's.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from fitter.export.refit import Evaluate, of_ours
from fitter.sampling.warp import lookup

FloatArray = NDArray[np.float64]

#: Nodes of the albedo's table over cos(theta) and roughness, and points of each integral on an axis.
_NODES, _POINTS = 32, 24
_SMALLEST_ALPHA = 1e-4


def openpbr(channels: int) -> Evaluate:
    """f_r (M, C) in 1/sr of wi, the light's, and wo, the viewer's, (M, 3) above the horizon.

    Values: base_color and specular_color (C,); base_diffuse_roughness, base_metalness, specular_roughness,
    specular_ior (); specular_roughness_anisotropy and psi, the azimuth of the tangent in radians, default 0.
    """
    diffuse = of_ours("oren_nayar:eon", channels)

    def evaluate(values: Mapping[str, FloatArray], wi: FloatArray, wo: FloatArray) -> FloatArray:
        base, tint = values["base_color"], values["specular_color"]
        metalness, roughness = float(values["base_metalness"]), float(values["specular_roughness"])
        stretch = 1.0 - float(values.get("specular_roughness_anisotropy", np.zeros(())))
        along = max(roughness**2 * np.sqrt(2 / (1 + stretch**2)), _SMALLEST_ALPHA)
        across = max(stretch * along, _SMALLEST_ALPHA)
        h = wi + wo
        h /= np.linalg.norm(h, axis=1)[:, None]
        lobe, cos_d = _lobe(wi, wo, h, along, across, values.get("psi")), (h * wo).sum(axis=1)
        a, b = _albedo(wo[:, 2], np.sqrt(np.sqrt(along * across)))
        lost = (1 - a - b) / (a + b)

        def scattered(f: FloatArray) -> FloatArray:
            return f * (1 + f * lost[:, None])

        eta = float(values["specular_ior"])
        dielectric = _dielectric(cos_d, eta)[:, None]
        f0 = ((eta - 1) / (eta + 1)) ** 2
        under = 1 - (f0 * a + b) * (1 + dielectric[:, 0] * lost)
        eon = diffuse({"rho": base, "sigma": values["base_diffuse_roughness"]}, wi, wo)
        below = scattered(dielectric) * lobe[:, None] * tint + under[:, None] * eon
        return metalness * scattered(_metal(cos_d, base, tint)) * lobe[:, None] + (1 - metalness) * below

    return evaluate


def _lobe(
    wi: FloatArray, wo: FloatArray, h: FloatArray, along: float, across: float, psi: FloatArray | None
) -> FloatArray:
    """D G / (4 cos_i cos_o), (M,)."""
    turn = 0.0 if psi is None else float(psi)
    x, y = (
        np.cos(turn) * h[:, 0] + np.sin(turn) * h[:, 1],
        np.cos(turn) * h[:, 1] - np.sin(turn) * h[:, 0],
    )
    density = 1 / (np.pi * along * across * ((x / along) ** 2 + (y / across) ** 2 + h[:, 2] ** 2) ** 2)
    return density * _visible(wi[:, 2], wo[:, 2], along * across)


def _visible(cos_i: FloatArray, cos_o: FloatArray, alpha2: float | FloatArray) -> FloatArray:
    """Smith's height-correlated G over 4 cos_i cos_o."""
    i, o = (np.sqrt(alpha2 + (1 - alpha2) * c * c) for c in (cos_i, cos_o))
    return np.asarray(0.5 / (i * cos_o + o * cos_i))


def _dielectric(cosine: FloatArray, eta: float) -> FloatArray:
    g = np.sqrt(np.maximum(eta * eta - 1 + cosine * cosine, 0.0))
    across = (g - cosine) / (g + cosine)
    along = ((g + cosine) * cosine - 1) / ((g - cosine) * cosine + 1)
    return np.asarray(0.5 * across**2 * (1 + along**2))


def _metal(cosine: FloatArray, f0: FloatArray, tint: FloatArray) -> FloatArray:
    c = np.clip(cosine, 0.0, 1.0)[:, None]
    edge = (f0 + (1 - f0) * (6 / 7) ** 5) * (1 - tint) / (1 / 7 * (6 / 7) ** 6)
    return np.asarray(f0 + (1 - f0) * (1 - c) ** 5 - edge * c * (1 - c) ** 6)


def _albedo(cosine: FloatArray, roughness: float) -> tuple[FloatArray, FloatArray]:
    tables = _tables()
    at = np.clip(cosine, 0.0, 1.0), np.full(len(cosine), np.clip(roughness, 0.0, 1.0))
    return lookup(tables[0], *at), lookup(tables[1], *at)


@cache
def _tables() -> tuple[FloatArray, FloatArray]:
    """A and B (roughness, cosine), by visible normals (J. Dupuy, A. Benyoub 2023): the mean of G2/G1."""
    u, v = (c.reshape(-1) for c in np.meshgrid(*2 * [(np.arange(_POINTS) + 0.5) / _POINTS]))
    cosine, roughness = np.meshgrid(np.maximum(np.linspace(0, 1, _NODES), 1e-3), np.linspace(0, 1, _NODES))
    mu, alpha = cosine.reshape(-1, 1), np.maximum(roughness.reshape(-1, 1) ** 2, _SMALLEST_ALPHA)
    # The viewer in the frame where the normals fill a hemisphere, and a normal of a cap about it.
    x, z = alpha * np.sqrt(1 - mu * mu), mu
    length = np.hypot(x, z)
    x, z = x / length, z / length
    height = (1 - v) * (1 + z) - z
    radius = np.sqrt(np.maximum(1 - height * height, 0.0))
    hx, hy = (radius * np.cos(2 * np.pi * u) + x) * alpha, radius * np.sin(2 * np.pi * u) * alpha
    hz = height + z
    norm = np.sqrt(hx * hx + hy * hy + hz * hz)
    cos_d = (np.sqrt(1 - mu * mu) * hx + mu * hz) / norm
    out = np.maximum(2 * cos_d * hz / norm - mu, 0.0)
    # G2/G1 = G2/(4 mu out) 4 mu out / G1, with G1 = 2 mu/(mu + root).
    seen = mu + np.sqrt(alpha**2 + (1 - alpha**2) * mu**2)
    share = _visible(mu, np.maximum(out, 1e-9), alpha**2) * 2 * out * seen
    faint = (1 - np.clip(cos_d, 0.0, 1.0)) ** 5
    a, b = ((share * weight).mean(axis=1).reshape(_NODES, _NODES) for weight in (1 - faint, faint))
    return a, b
