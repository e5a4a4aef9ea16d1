"""Lobes: the densities a model draws directions from, and their mixture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from fitter.models.ndf import GGX, NDF
from fitter.models.pair import Half, Pair


@runtime_checkable
class Lobe(Protocol):
    """A density of wo given wi over the whole sphere, per unit solid angle."""

    def sample(self, wi: Array, u: Array) -> Array:
        """(n, 3) directions for uniform u (n, 3); may point below the horizon."""
        ...

    def pdf(self, p: Pair) -> Array:
        """Density at the pair, of its shape."""
        ...


class Delta(NamedTuple):
    """An ideal component: all of its light goes into one direction (x, y, z) per incidence, (...) each.

    weight : (..., C) share of the incident light it carries; share : (...) unnormalised share of the draws.
    """

    x: Array
    y: Array
    z: Array
    weight: Array
    share: Array


class OneSided(eqx.Module):
    """A lobe of a part that only reflects, beside one that transmits.

    Light from below has no share of it, and what it draws below the horizon is lost as in a model that only
    reflects: put on the horizon, where no direction is valid. Its density there is not to be relied on.
    """

    lobe: Lobe

    def sample(self, wi: Array, u: Array) -> Array:
        wo = self.lobe.sample(wi, u)
        return wo.at[:, 2].set(jnp.maximum(wo[:, 2], 0.0))

    def pdf(self, p: Pair) -> Array:
        return jnp.where((p.iz > 0) & (p.oz > 0), self.lobe.pdf(p), 0.0)


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

    ndf: NDF

    def sample(self, wi: Array, u: Array) -> Array:
        h = self.ndf.sample(u)
        return 2.0 * (h @ wi)[:, None] * h - wi

    def pdf(self, p: Pair) -> Array:
        h, ok = upper_half(p)
        # cos_h = H_z/|H|, h.wi = |H|/2.
        return jnp.where(ok, self.ndf.density(h) * h.z / (2.0 * h.squared), 0.0)


class VisibleNormalLobe(eqx.Module):
    """wo is wi mirrored in a normal that is visible from wi: pdf(wo) = G1(wi) D(h) / (4 cos_i).

    E. Heitz and E. d'Eon 2014. With Smith's G1 the weight of a GGX reflection is at most F.
    """

    ggx: GGX

    def sample(self, wi: Array, u: Array) -> Array:
        h = self.ggx.sample_visible(wi, u)
        return 2.0 * (h @ wi)[:, None] * h - wi

    def pdf(self, p: Pair) -> Array:
        h, ok = upper_half(p)
        ok = ok & (p.iz > 0)
        iz = jnp.where(ok, p.iz, 1.0)
        # G1/cos_i = 1/(cos_i + Lambda cos_i): finite at grazing.
        return jnp.where(ok, 0.25 * self.ggx.density(h) / (iz + self.ggx.lambda_cos(p.ix, p.iy, iz)), 0.0)


def upper_half(p: Pair) -> tuple[Half, Array]:
    """The half vector, and whether it is above the horizon; where not, the normal instead.

    Directions whose half vector is below the horizon are reached from -h too: not by these lobes.
    """
    h = Half.of(p)
    ok = (h.z > 0) & (h.squared > 1e-24)
    zero, one = jnp.zeros_like(h.z), jnp.ones_like(h.z)
    lifted = Half(
        jnp.where(ok, h.x, zero), jnp.where(ok, h.y, zero), jnp.where(ok, h.z, one),
        jnp.where(ok, h.squared, one),
    )  # fmt: skip
    return lifted, ok


def mixture_pdf(lobes: Sequence[Lobe], shares: Sequence[Array], p: Pair, transmits: bool = False) -> Array:
    """Density of the lobes' mixture at the pair; 0 for wi below the horizon unless it transmits."""
    total = jnp.zeros(jnp.broadcast_shapes(p.iz.shape, p.oz.shape), p.oz.dtype)
    # Shares of ideal components follow those of the lobes: they have no density.
    for share, lobe in zip(shares[: len(lobes)], lobes, strict=True):
        total = total + share * lobe.pdf(p)
    return total if transmits else jnp.where(p.iz > 0, total, 0.0)


def sample_mixture(
    lobes: Sequence[Lobe], shares: Sequence[Array], deltas: Sequence[Delta], wi: Array, n: int, key: Array
) -> tuple[Array, Array]:
    """(n, 3) directions and (n,) which lobe or, counted on, ideal component each came from.

    Every lobe is drawn and one chosen: a factor of the number of lobes but no gather or scatter, which is
    the cheaper on a CPU for the two to ten lobes a model has. Lobes get a third uniform number for free:
    where in its own interval the number that chose the lobe lies.
    """
    choose, draw = jax.random.split(key)
    u = jax.random.uniform(draw, (n, 2), wi.dtype)
    v = jax.random.uniform(choose, (n,), wi.dtype)
    ends = jnp.cumsum(jnp.stack([jnp.asarray(share, wi.dtype) for share in shares]))
    pick = jnp.minimum(jnp.searchsorted(ends, v, side="right"), len(shares) - 1)
    wo = jnp.zeros((n, 3), wi.dtype)
    for k, lobe in enumerate(lobes):
        start = ends[k - 1] if k else jnp.zeros_like(ends[0])
        width = ends[k] - start
        rest = jnp.clip((v - start) / jnp.where(width > 0, width, 1.0), 0.0, 1.0)
        drawn = lobe.sample(wi, jnp.concatenate([u, rest[:, None]], axis=1))
        wo = jnp.where((pick == k)[:, None], drawn, wo)
    for k, delta in enumerate(deltas, start=len(lobes)):
        wo = jnp.where((pick == k)[:, None], jnp.stack([delta.x, delta.y, delta.z]), wo)
    return wo, pick
