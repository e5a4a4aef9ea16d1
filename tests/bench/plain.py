"""The models as one would write them in NumPy from the papers, without any of the project's code.

Every function takes unit vectors wi, wo (N, 3) and gives (N, C) in 1/sr, 0 below the horizon.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def ward(wi: Array, wo: Array, kd: Array, ks: Array, alpha: float) -> Array:
    """G. Ward 1992, isotropic."""
    cos_i, cos_o, cos_h, _, above = cosines(wi, wo)
    tan2 = (1.0 - cos_h**2) / cos_h**2
    lobe = np.exp(-tan2 / alpha**2) / (4 * np.pi * alpha**2 * np.sqrt(cos_i * cos_o))
    return total(above, kd, lobe[:, None] * ks)


def torrance_sparrow(wi: Array, wo: Array, kd: Array, ks: Array, f0: Array, alpha: float) -> Array:
    """Beckmann, V-grooves, Schlick."""
    cos_i, cos_o, cos_h, cos_d, above = cosines(wi, wo)
    tan2 = (1.0 - cos_h**2) / cos_h**2
    d = np.exp(-tan2 / alpha**2) / (np.pi * alpha**2 * cos_h**4)
    g = np.minimum(1.0, 2 * cos_h * np.minimum(cos_i, cos_o) / cos_d)
    return total(above, kd, (d * g / (4 * cos_i * cos_o))[:, None] * ks * schlick(cos_d, f0))


def ggx_smith(wi: Array, wo: Array, kd: Array, ks: Array, f0: Array, alpha: float) -> Array:
    """GGX, height-correlated Smith, Schlick."""
    cos_i, cos_o, cos_h, cos_d, above = cosines(wi, wo)
    d = alpha**2 / (np.pi * (cos_h**2 * (alpha**2 - 1.0) + 1.0) ** 2)
    lambda_i, lambda_o = (0.5 * (np.sqrt(1.0 + alpha**2 * (1.0 - c**2) / c**2) - 1.0) for c in (cos_i, cos_o))
    g = 1.0 / (1.0 + lambda_i + lambda_o)
    return total(above, kd, (d * g / (4 * cos_i * cos_o))[:, None] * ks * schlick(cos_d, f0))


def lafortune(wi: Array, wo: Array, kd: Array, ks: Array, gamma: Array, n: Array) -> Array:
    """One generalised cosine lobe per channel."""
    cxy, cz = -np.sin(gamma), np.cos(gamma)
    plane = wi[:, 0] * wo[:, 0] + wi[:, 1] * wo[:, 1]
    base = plane[:, None] * cxy + (wi[:, 2] * wo[:, 2])[:, None] * cz
    lobe = np.maximum(base / np.maximum(np.abs(cxy), np.abs(cz)), 0.0) ** n
    return total((wi[:, 2] > 0) & (wo[:, 2] > 0), kd, lobe * ks * (n + 2) / (2 * np.pi))


def oren_nayar(wi: Array, wo: Array, rho: Array, sigma: float) -> Array:
    """The qualitative form, eq. 30 of the 1994 paper, in angles as printed there."""
    above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    theta_i, theta_o = (np.arccos(np.clip(w[:, 2], 0.0, 1.0)) for w in (wi, wo))
    phi = np.arctan2(wo[:, 1], wo[:, 0]) - np.arctan2(wi[:, 1], wi[:, 0])
    a = 1.0 - 0.5 * sigma**2 / (sigma**2 + 0.33)
    b = 0.45 * sigma**2 / (sigma**2 + 0.09)
    swing = np.maximum(0.0, np.cos(phi)) * np.sin(np.maximum(theta_i, theta_o))
    shape = np.where(above, a + b * swing * np.tan(np.minimum(theta_i, theta_o)), 0.0)
    return shape[:, None] * rho / np.asarray(np.pi, wi.dtype)


FUNCTIONS: Mapping[str, Callable[..., Array]] = {
    "ward": ward, "torrance_sparrow": torrance_sparrow, "torrance_sparrow:ggx:smith": ggx_smith,
    "lafortune": lafortune, "oren_nayar": oren_nayar,
}  # fmt: skip

#: Parameters of a plausible glossy paint (and plaster), per channel where the model has them so.
TRUTHS: Mapping[str, Mapping[str, Any]] = {
    "ward": {"kd": (0.1, 0.2, 0.3), "ks": (0.05, 0.06, 0.07), "alpha": 0.15},
    "torrance_sparrow": {"kd": (0.1, 0.2, 0.3), "ks": (0.5, 0.6, 0.7), "f0": (0.1, 0.2, 0.3), "alpha": 0.2},
    "torrance_sparrow:ggx:smith": {
        "kd": (0.1, 0.2, 0.3), "ks": (0.9, 0.9, 0.9), "f0": (0.05, 0.06, 0.07), "alpha": 0.15,
    },
    "lafortune": {
        "kd": (0.1, 0.2, 0.3), "ks": (0.2, 0.2, 0.2), "gamma": (0.75, 0.8, 0.85), "n": (20.0, 30.0, 40.0),
    },
    "oren_nayar": {"rho": (0.3, 0.5, 0.7), "sigma": 0.5},
}  # fmt: skip


def evaluate(name: str, wi: Array, wo: Array, values: Mapping[str, Any] | None = None) -> Array:
    """Model ``name`` at its truth or at ``values``, in the precision of the directions."""
    return call(FUNCTIONS[name], wi, wo, TRUTHS[name] if values is None else values)


def call(function: Callable[..., Array], wi: Array, wo: Array, given: Mapping[str, Any]) -> Array:
    """``function`` with its parameters in the precision of the directions."""
    # Arrays of no dimension would widen float32 data; a plain float does not.
    typed = {k: float(v) if np.ndim(v) == 0 else np.asarray(v, wi.dtype) for k, v in given.items()}
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return function(wi, wo, **typed)


def cosines(wi: Array, wo: Array) -> tuple[Array, Array, Array, Array, Array]:
    """cos of theta_i, theta_o, theta_h, theta_d, and whether both directions are above the horizon."""
    h = wi + wo
    h = h / np.linalg.norm(h, axis=1, keepdims=True)
    cos_d = np.einsum("ij,ij->i", wi, h)
    return wi[:, 2], wo[:, 2], h[:, 2], cos_d, (wi[:, 2] > 0) & (wo[:, 2] > 0)


def schlick(cos_d: Array, f0: Array) -> Array:
    weight = (1.0 - cos_d) ** 5
    return f0 + (1.0 - f0) * weight[:, None]


def total(above: Array, kd: Array, lobe: Array) -> Array:
    return np.where(above[:, None], kd / np.asarray(np.pi, lobe.dtype) + lobe, 0.0)
