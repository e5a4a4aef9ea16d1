"""Mitsuba 3's ``principled`` BSDF, as far as refits use it: base colour, metallic, roughness, specular.

B. Burley, "Physically based shading at Disney" (2012) and its extension (2015), in Mitsuba's form: with h the
half vector, w(c) = (1 - c)^5, R = 2 roughness (h.wo)^2 and eta = 2/(1 - sqrt(0.08 specular)) - 1,

    f = (1 - metallic) base_color/pi [(1 - w_i/2)(1 - w_o/2) + R (w_o + w_i + w_o w_i (R - 1))]
        + F D G / (4 cos_i cos_o),
    F = (1 - metallic) F_dielectric(h.wi, eta) + metallic (base_color + (1 - base_color) w(h.wi)),

D of GGX with alpha = max(0.001, roughness^2) and G its separable Smith term.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def principled(values: Mapping[str, FloatArray], wi: FloatArray, wo: FloatArray) -> FloatArray:
    """f_r (M, C) in 1/sr of directions (M, 3) above the horizon, base_color (C,), the others ()."""
    base, metallic = values["base_color"], float(values["metallic"])
    roughness, specular = float(values["roughness"]), float(values["specular"])
    h = wi + wo
    h = h / np.linalg.norm(h, axis=1)[:, None]
    cos_i, cos_o, cos_d = wi[:, 2], wo[:, 2], (h * wo).sum(axis=1)
    w_i, w_o, w_d = (_weight(c) for c in (cos_i, cos_o, cos_d))
    back = 2.0 * roughness * cos_d**2
    diffuse = (1 - 0.5 * w_i) * (1 - 0.5 * w_o) + back * (w_o + w_i + w_o * w_i * (back - 1))
    alpha2 = max(0.001, roughness * roughness) ** 2
    density = alpha2 / (np.pi * (h[:, 2] ** 2 * (alpha2 - 1) + 1) ** 2)
    lobe = density * _smith(wi, alpha2) * _smith(wo, alpha2) / (4 * cos_i * cos_o)
    eta = 2.0 / (1.0 - np.sqrt(0.08 * specular)) - 1.0
    metal = base + (1.0 - base) * w_d[:, None]
    reflected = (1 - metallic) * _fresnel(cos_d, eta)[:, None] + metallic * metal
    return (1 - metallic) * base / np.pi * diffuse[:, None] + reflected * lobe[:, None]


def _weight(cosine: FloatArray) -> FloatArray:
    return np.asarray(np.clip(1.0 - cosine, 0.0, 1.0) ** 5)


def _smith(w: FloatArray, alpha2: float) -> FloatArray:
    tan2 = (w[:, 0] ** 2 + w[:, 1] ** 2) / w[:, 2] ** 2
    return np.asarray(2.0 / (1.0 + np.sqrt(1.0 + alpha2 * tan2)))


def _fresnel(cosine: FloatArray, eta: float) -> FloatArray:
    refracted = np.sqrt(np.maximum(1.0 - (1.0 - cosine**2) / eta**2, 0.0))
    across = (cosine - eta * refracted) / (cosine + eta * refracted)
    along = (eta * cosine - refracted) / (eta * cosine + refracted)
    return np.asarray(0.5 * (across**2 + along**2))
