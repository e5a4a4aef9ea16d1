"""Lobes: the densities a model draws directions from, and their mixture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from fitter.models import ndf
from fitter.models.pair import Half, Pair


@runtime_checkable
class Lobe(Protocol):
    """A density of wo given wi over the whole sphere, per unit solid angle."""

    def sample(self, wi: Array, u: Array) -> Array:
        """(n, 3) directions for uniform u (n, 2); may point below the horizon."""
        ...

    def pdf(self, p: Pair) -> Array:
        """Density at the pair, of its shape."""
        ...


class CosineLobe(eqx.Module):
    """Density cos(theta_o)/pi on the upper hemisphere."""

    def sample(self, wi: Array, u: Array) -> Array:
        r, phi = jnp.sqrt(u[:, 0]), 2 * math.pi * u[:, 1]
        # 1 - u lies in (0, 1]: never exactly on the horizon.
        return jnp.stack([r * jnp.cos(phi), r * jnp.sin(phi), jnp.sqrt(1.0 - u[:, 0])], axis=-1)

    def pdf(self, p: Pair) -> Array:
        return jnp.maximum(p.oz, 0.0) / math.pi


class HalfVectorLobe(eqx.Module):
    """wo is wi mirrored in a half vector drawn with density D(h) cos(theta_h).

    Walter et al. 2007, eqs 24 and 14: pdf(wo) = D(h) cos(theta_h) / (4 h.wi).
    """

    alpha: Array
    ndf: str = eqx.field(static=True)

    def sample(self, wi: Array, u: Array) -> Array:
        tan2 = ndf.sample_tan2(self.ndf, self.alpha, u[:, 0])
        phi = 2 * math.pi * u[:, 1]
        cos_h = 1.0 / jnp.sqrt(1.0 + tan2)
        sin_h = jnp.sqrt(tan2) * cos_h
        h = jnp.stack([sin_h * jnp.cos(phi), sin_h * jnp.sin(phi), cos_h], axis=-1)
        return 2.0 * (h @ wi)[:, None] * h - wi

    def pdf(self, p: Pair) -> Array:
        h = Half.of(p)
        # Directions whose half vector is below the horizon are reached from -h too: not by this lobe.
        ok = (h.z > 0) & (h.squared > 1e-24)
        z = jnp.where(ok, h.z, 1.0)
        squared = jnp.where(ok, h.squared, 4.0)
        tan2 = (h.x * h.x + h.y * h.y) / (z * z)
        # cos_h = H_z/|H|, h.wi = |H|/2.
        density = ndf.NDFS[self.ndf](jnp.where(ok, tan2, 0.0), self.alpha) * z / (2.0 * squared)
        return jnp.where(ok, density, 0.0)


class PhongLobe(eqx.Module):
    """Density (n+1)/(2 pi) cos^n about the axis normalize(C o wi), C = (cxy, cxy, cz) (Lafortune 1997)."""

    cxy: Array
    cz: Array
    n: Array

    def sample(self, wi: Array, u: Array) -> Array:
        axis = wi * jnp.stack([self.cxy, self.cxy, self.cz])
        axis = axis / jnp.linalg.norm(axis)
        # 1 - cos in closed form: cos = u^(1/(n+1)) rounds to 1 for large n.
        one_minus = -jnp.expm1(jnp.log1p(-u[:, 0]) / (self.n + 1.0))
        cos_t = 1.0 - one_minus
        sin_t = jnp.sqrt(one_minus * (1.0 + cos_t))
        phi = 2 * math.pi * u[:, 1]
        t, b = _frame(axis)
        return (
            (sin_t * jnp.cos(phi))[:, None] * t + (sin_t * jnp.sin(phi))[:, None] * b + cos_t[:, None] * axis
        )

    def pdf(self, p: Pair) -> Array:
        ax, ay, az = self.cxy * p.ix, self.cxy * p.iy, self.cz * p.iz
        length2 = ax * ax + ay * ay + az * az
        dot = (ax * p.ox + ay * p.oy + az * p.oz) / jnp.sqrt(jnp.where(length2 > 0, length2, 1.0))
        ok = (dot > 0) & (length2 > 0)
        safe = jnp.where(ok, dot, 1.0)
        return jnp.where(ok, jnp.exp(self.n * jnp.log(safe)), 0.0) * (self.n + 1.0) / (2 * math.pi)


def _frame(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors orthogonal to ``axis`` (3,) and each other (Duff et al. 2017, JCGT 6(1))."""
    x, y, z = axis[0], axis[1], axis[2]
    sign = jnp.where(z >= 0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return (
        jnp.stack([1.0 + sign * x * x * a, sign * b, -sign * x]),
        jnp.stack([b, sign + y * y * a, -y]),
    )


def mixture_pdf(lobes: Sequence[Lobe], shares: Array, p: Pair) -> Array:
    """Density of the mixture at the pair; 0 where wi is not above the horizon."""
    total = shares[0] * lobes[0].pdf(p)
    for share, lobe in zip(shares[1:], lobes[1:], strict=True):
        total = total + share * lobe.pdf(p)
    return jnp.where(p.iz > 0, total, 0.0)


def sample_mixture(
    lobes: Sequence[Lobe], shares: Array, wi: Array, n: int, key: Array
) -> tuple[Array, Array]:
    """(n, 3) directions and (n,) whether above the horizon. Every lobe is drawn and one chosen.

    Drawing all and selecting costs a factor of the number of lobes but no gather or scatter, which is
    the cheaper on a CPU for the two to ten lobes a model has.
    """
    choose, draw = jax.random.split(key)
    u = jax.random.uniform(draw, (n, 2), wi.dtype)
    pick = jnp.searchsorted(jnp.cumsum(shares), jax.random.uniform(choose, (n,), wi.dtype))
    wo = lobes[0].sample(wi, u)
    for k, lobe in enumerate(lobes[1:], start=1):
        wo = jnp.where((pick >= k)[:, None], lobe.sample(wi, u), wo)
    return wo, wo[:, 2] > 0
