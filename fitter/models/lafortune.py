"""Lafortune's generalised cosine lobes, one to three, plus kd/pi.

E. Lafortune, S. Foo, K. Torrance, D. Greenberg, "Non-linear approximation of reflectance functions",
SIGGRAPH 1997. A lobe here is

    ks (n + 2)/(2 pi) [max(0, Cx xi xo + Cy yi yo + Cz zi zo) / max(|Cx|, |Cy|, |Cz|)]^n,

    isotropic    C = (-sin gamma, -sin gamma, cos gamma)
    anisotropic  C = (-sqrt2 sin gamma cos delta, -sqrt2 sin gamma sin delta, cos gamma), x and y in a frame
                 turned by psi; delta = 45 deg is the isotropic lobe.

The length of C, which is degenerate with ks, is gone. For a mirror lobe, and for any other whose largest
coefficient is Cz, ks is the albedo about the normal. gamma = 45 deg is the mirror lobe, -45 deg the
retro-reflecting one; beyond 90 deg either way Cz is negative, a lobe seen near grazing only.

Reciprocal; the albedo of a lobe is at most ks. Where the sum in brackets is not positive a lobe is 0, for
n = 0 too (its limit for n -> 0). Kinks: the edge of the lobe for n <= 1 (for n < 1 the slope has no bound
there, though that of any stored pair is finite), and ties of the largest coefficient, where slopes are
one-sided.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from fitter.models.base import SeparableModel
from fitter.models.diffuse import KS, diffuse_lobes, masked_terms, with_diffuse
from fitter.models.lobes import Lobe
from fitter.models.pair import Pair
from fitter.models.parameters import Parameter
from fitter.models.phong_lobe import EXPONENT, PhongLobe, power
from fitter.models.roughness import PSI, turned
from fitter.spec import ModelSpec

GAMMA = Parameter(
    "gamma", "rad", -math.pi, math.pi, math.pi / 4,
    "direction of the lobe: 45 deg mirror, -45 deg retro, between them towards the normal", per_channel=True,
)  # fmt: skip
DELTA = Parameter(
    "delta", "rad", -math.pi / 2, math.pi / 2, math.pi / 4,
    "anisotropy of the lobe, tan(delta) = Cy/Cx: 45 deg is isotropic", per_channel=True,
)  # fmt: skip
N = dataclasses.replace(EXPONENT, per_channel=True)


class Lafortune(SeparableModel):
    family: ClassVar[str] = "lafortune"

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        suffixes = lobe_suffixes(spec)
        own = (GAMMA, DELTA, N) if spec.anisotropic else (GAMMA, N)
        linear = tuple(_renamed(KS, s) for s in suffixes)
        nonlinear = tuple(_renamed(p, s) for s in suffixes for p in own)
        # The axes are the material's, not a lobe's.
        return with_diffuse(spec, (*linear, *nonlinear, *((PSI,) if spec.anisotropic else ())))

    @staticmethod
    def terms(spec: ModelSpec, nonlinear: Mapping[str, Array], p: Pair) -> tuple[Array, ...]:
        above = p.above
        p = p.lifted()
        normal = p.iz * p.oz
        if spec.anisotropic:
            (ix, iy), (ox, oy) = (turned(nonlinear["psi"], x, y) for x, y in ((p.ix, p.iy), (p.ox, p.oy)))
            products = (ix * ox, iy * oy, normal)
        else:
            products = (p.ix * p.ox + p.iy * p.oy, normal)
        lobes = [
            cosine_lobe(lobe_coefficients(spec, nonlinear, s), nonlinear[f"n{s}"], products)
            for s in lobe_suffixes(spec)
        ]
        return masked_terms(spec, above, lobes)

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        found: list[tuple[Lobe, Array]] = []
        for s in lobe_suffixes(spec):
            c = lobe_coefficients(spec, values, s)
            cx, cy, cz = c if spec.anisotropic else (c[0], *c)
            psi = values["psi"] if spec.anisotropic else jnp.zeros_like(cx)
            per_channel = jnp.broadcast_arrays(
                *(jnp.atleast_1d(v) for v in (cx, cy, cz, values[f"n{s}"], psi))
            )
            share = jnp.mean(values[f"ks{s}"]) / len(per_channel[0])
            for x, y, z, n, turn in zip(*per_channel, strict=True):
                found.append((PhongLobe(x, y, z, n, turn if spec.anisotropic else None), share))
        return [*found, *diffuse_lobes(spec, values)]


def cosine_lobe(coefficients: tuple[Array, ...], n: Array, products: tuple[Array, ...]) -> Array:
    """(n + 2)/(2 pi) times the sum of coefficients times products to the power n."""
    base = coefficients[0] * products[0]
    for c, product in zip(coefficients[1:], products[1:], strict=True):
        base = base + c * product
    return power(base, n) * (n + 2.0) / (2 * math.pi)


def lobe_suffixes(spec: ModelSpec) -> tuple[str, ...]:
    """Empty for a single lobe; "_1", "_2", ... for several."""
    return ("",) if spec.lobes == 1 else tuple(f"_{k + 1}" for k in range(spec.lobes))


def lobe_coefficients(spec: ModelSpec, values: Mapping[str, Array], suffix: str) -> tuple[Array, ...]:
    """C over the largest of its magnitudes: (Cxy, Cz), or (Cx, Cy, Cz) where anisotropic.

    Quotients written out (tan gamma and so on), the largest as a sign: the slope of one magnitude over
    itself is then 0, not a difference that cancels. At a tie slopes are those of one side.
    """
    gamma = values[f"gamma{suffix}"]
    sine, cosine = jnp.sin(gamma), jnp.cos(gamma)
    if not spec.anisotropic:
        z_leads = jnp.abs(cosine) >= jnp.abs(sine)
        lead = jnp.sign(jnp.where(z_leads, cosine, -sine))
        tangent = sine / jnp.where(z_leads, cosine, 1.0)
        cotangent = cosine / jnp.where(z_leads, 1.0, sine)
        return lead * jnp.where(z_leads, -tangent, 1.0), lead * jnp.where(z_leads, 1.0, -cotangent)
    delta = values[f"delta{suffix}"]
    x, y = math.sqrt(2) * jnp.cos(delta), math.sqrt(2) * jnp.sin(delta)
    x_first = jnp.abs(x) >= jnp.abs(y)
    plane = sine * jnp.where(x_first, x, y)
    z_leads = jnp.abs(cosine) >= jnp.abs(plane)
    lead = jnp.sign(jnp.where(z_leads, cosine, -plane))
    tangent = sine / jnp.where(z_leads, cosine, 1.0)
    cotangent = cosine / jnp.where(z_leads, 1.0, plane)
    x_ratio = jnp.where(x_first, 1.0, x / jnp.where(x_first, 1.0, y))
    y_ratio = jnp.where(x_first, y / jnp.where(x_first, x, 1.0), 1.0)
    return (
        lead * jnp.where(z_leads, -tangent * x, x_ratio),
        lead * jnp.where(z_leads, -tangent * y, y_ratio),
        lead * jnp.where(z_leads, 1.0, -cotangent),
    )


def _renamed(p: Parameter, suffix: str) -> Parameter:
    if not suffix:
        return p
    return dataclasses.replace(p, name=p.name + suffix, description=f"lobe {suffix[1:]}: {p.description}")
