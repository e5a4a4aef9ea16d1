"""Lafortune's generalised cosine lobes, isotropic, one to three, plus kd/pi.

E. Lafortune, S. Foo, K. Torrance, D. Greenberg 1997. A lobe here is

    ks (n + 2)/(2 pi) [max(0, cxy (xi xo + yi yo) + cz zi zo) / max(|cxy|, |cz|)]^n,

with (cxy, cz) = (-sin gamma, cos gamma): the length of C, which is degenerate with ks, is gone, and the
scale is the albedo of the lobe about the normal. gamma = 45 deg is the mirror lobe, -45 deg the
retro-reflecting one; beyond 90 deg either way cz is negative, a lobe seen near grazing only.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from fitter.models.base import ReflectanceModel
from fitter.models.diffuse import KS, masked_terms, with_diffuse
from fitter.models.lobes import CosineLobe, Lobe, PhongLobe
from fitter.models.pair import Pair
from fitter.models.parameters import Parameter
from fitter.spec import ModelSpec

GAMMA = Parameter(
    "gamma", "rad", -math.pi, math.pi, math.pi / 4,
    "direction of the lobe: 45 deg mirror, -45 deg retro, between them towards the normal", per_channel=True,
)  # fmt: skip
N = Parameter("n", "1", 0.1, 1e5, 20.0, "exponent: larger is narrower", search="log", per_channel=True)


class Lafortune(ReflectanceModel):
    family: ClassVar[str] = "lafortune"

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        suffixes = lobe_suffixes(spec)
        linear = tuple(_renamed(KS, s) for s in suffixes)
        nonlinear = tuple(_renamed(p, s) for s in suffixes for p in (GAMMA, N))
        return with_diffuse(spec, (*linear, *nonlinear))

    @staticmethod
    def terms(spec: ModelSpec, nonlinear: Mapping[str, Array], p: Pair) -> tuple[Array, ...]:
        above = p.above
        p = p.lifted()
        plane, normal = p.ix * p.ox + p.iy * p.oy, p.iz * p.oz
        lobes = [
            cosine_lobe(nonlinear[f"gamma{s}"], nonlinear[f"n{s}"], plane, normal)
            for s in lobe_suffixes(spec)
        ]
        return masked_terms(spec, above, lobes)

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        found: list[tuple[Lobe, Array]] = []
        for s in lobe_suffixes(spec):
            gamma, n = jnp.broadcast_arrays(
                jnp.atleast_1d(values[f"gamma{s}"]), jnp.atleast_1d(values[f"n{s}"])
            )
            share = jnp.mean(values[f"ks{s}"]) / len(n)
            found += [(PhongLobe(*_direction(g), e), share) for g, e in zip(gamma, n, strict=True)]
        if spec.diffuse == "lambert":
            found.append((CosineLobe(), jnp.mean(values["kd"])))
        return found


def cosine_lobe(gamma: Array, n: Array, plane: Array, normal: Array) -> Array:
    """(n + 2)/(2 pi) times the normalised base to the power n; plane = xi xo + yi yo, normal = zi zo."""
    cxy, cz = _direction(gamma)
    base = (cxy * plane + cz * normal) / jnp.maximum(jnp.abs(cxy), jnp.abs(cz))
    # x**n has NaN gradients for x <= 0 even where masked out: guard the argument.
    positive = base > 0
    power = jnp.exp(n * jnp.log(jnp.where(positive, base, 1.0)))
    return jnp.where(positive, power, 0.0) * (n + 2.0) / (2 * math.pi)


def lobe_suffixes(spec: ModelSpec) -> tuple[str, ...]:
    """Empty for a single lobe; "_1", "_2", ... for several."""
    return ("",) if spec.lobes == 1 else tuple(f"_{k + 1}" for k in range(spec.lobes))


def _direction(gamma: Array) -> tuple[Array, Array]:
    return -jnp.sin(gamma), jnp.cos(gamma)


def _renamed(p: Parameter, suffix: str) -> Parameter:
    if not suffix:
        return p
    return dataclasses.replace(p, name=p.name + suffix, description=f"lobe {suffix[1:]}: {p.description}")
