"""Enclosures of lobes that are powers of a cosine: Lafortune's, Phong's and Blinn's.

The sum of coefficients times products that Lafortune's and Phong's raise to a power is written in l.v and
n.l n.v, with m = (Cx + Cy)/2 and d = (Cx - Cy)/2,

    Cx lx vx + Cy ly vy + Cz lz vz = m l.v + (Cz - m) lz vz + d (lx vx - ly vy):

isotropic lobes have every variable once. The left side is enclosed as it stands, too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache

import jax.numpy as jnp
import numpy as np

from fitter.models.lafortune import lobe_coefficients, lobe_suffixes
from fitter.scene.boxes import Angles
from fitter.scene.factors import slopes, turned
from fitter.scene.intervals import Interval, increasing
from fitter.spec import ModelSpec

#: More than what rounding changes a coefficient by, all being at most 1.
_ROUNDED = 1e-13


def lafortune(spec: ModelSpec, values: Mapping[str, float], angles: Angles) -> list[Interval]:
    """Each lobe over ks."""
    found: list[Interval] = []
    for s in lobe_suffixes(spec):
        c = _coefficients(spec.anisotropic, values[f"gamma{s}"], values.get(f"delta{s}", 0.0))
        found.append(_power(c, values.get("psi", 0.0), values[f"n{s}"], angles))
    return found


def phong(values: Mapping[str, float], angles: Angles) -> Interval:
    return _power((-1.0, -1.0, 1.0), 0.0, values["n"], angles)


def blinn(values: Mapping[str, float], angles: Angles) -> Interval:
    """cos^n theta_h = (1 + tan^2)^(-n/2)."""
    n = values["n"]
    scale = (n + 2.0) * (n + 4.0) / (8 * math.pi * (n + 2.0 ** (-0.5 * n)))
    return ((slopes(angles) + 1.0).log() * (-0.5 * n)).exp() * _about(scale)


@lru_cache(maxsize=64)
def _coefficients(anisotropic: bool, gamma: float, delta: float) -> tuple[float, float, float]:
    spec = ModelSpec(family="lafortune", anisotropic=anisotropic)
    own = {"gamma": jnp.asarray(gamma), "delta": jnp.asarray(delta)}
    *xy, z = (float(c) for c in lobe_coefficients(spec, own, ""))
    return xy[0], xy[-1], z


def _power(c: tuple[float, float, float], psi: float, n: float, angles: Angles) -> Interval:
    """(n + 2)/(2 pi) max(0, Cx xi xo + Cy yi yo + Cz zi zo)^n; 0 to the power 0 is 0."""
    x, y, z = (Interval(np.asarray(one - _ROUNDED), np.asarray(one + _ROUNDED)) for one in c)
    along = angles.lz * angles.vz
    (lx, ly), (vx, vy) = (turned(psi, angles, w) for w in (angles.l, angles.v))
    ax, ay = lx * vx, ly * vy
    mean = (x + y) * 0.5
    base = mean * angles.dot + (z - mean) * along
    if c[0] != c[1]:
        base = base + (x - y) * 0.5 * (ax - ay)
    # No longer than wi and wo, as the largest coefficient is 1.
    base = base.meet(x * ax + y * ay + z * along).clip(-1, 1)
    raised = (base.log() * n).exp()
    # The models take what is below 4 times the smallest normal number as 0.
    certain = base.lo > 1e-37
    found = Interval(np.where(certain, raised.lo, 0.0), np.where(base.hi > 0, raised.hi, 0.0))
    return found * _about((n + 2.0) / (2 * math.pi))


def _about(x: float) -> Interval:
    """A number that was computed with a few roundings."""
    return increasing(np.asarray(x), np.asarray(x))
