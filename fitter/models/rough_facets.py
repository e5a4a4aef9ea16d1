"""Rough facets: any isotropic BRDF as the BRDF of Smith microfacets, integrated over their normals.

    f = G(wi, wo)/(cos_i cos_o) Int f_facet(wi, wo; m) (wi.m)+ (wo.m)+ D(m) dm

f_facet is evaluated in the frame of the facet m, which has no direction of its own: facets have to be
isotropic. G = 1/(1 + Lambda_i + Lambda_o) is the height-correlated Smith term of the distribution D, which
does not depend on m (E. Heitz and J. Dupuy, "Implementing a simple anisotropic rough diffuse material with
stochastic evaluation", 2015; M. Oren and S. Nayar 1994 has the V-groove form). Light that meets several
facets is not added: the albedo is below the facet's own.

The integral is a product rule over slopes in polar coordinates, RADII x 5 x AZIMUTHS nodes a pair, with
panels that end where a facet turns its back on wi or wo. The relative error for Lambertian facets is below
2e-5 (GGX) and 1e-3 (Beckmann; 1e-4 up to alpha 0.6) for cosines from 0.02 up, and below 2e-2 down to cosines
of 1e-6, where what is left of the integral is a sliver. A facet with a lobe of its own is resolved less well:
the error, over the highest value, is about 0.01 for a cosine lobe of exponent 1 and 0.1 for 10 at alpha 0.5.
It costs as many evaluations of the facet as there are nodes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp
from jax import Array

from fitter.errors import SpecError
from fitter.models import composite, ndf, slopes
from fitter.models.base import ReflectanceModel
from fitter.models.lobes import CosineLobe, HalfVectorLobe, Lobe
from fitter.models.masking import smith
from fitter.models.pair import Half, Pair
from fitter.models.parameters import Parameter
from fitter.spec import ModelSpec

#: Nodes: in the slope's size, and in its azimuth for each of five panels.
RADII, AZIMUTHS = 16, 16
#: Pairs whose nodes are in memory at once: few, so that they stay in the processor's cache.
CHUNK = 16


class RoughFacets(composite.Composite):
    family: ClassVar[str] = "rough_facets"

    #: Relative error of float32: near grazing the nodes of a sliver are known to its last digits only.
    float32_error: ClassVar[float] = 5e-4

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        _check(spec)
        return (*composite.parameters(spec), *ndf.parameters(spec))

    def value(self, p: Pair) -> Array:
        (facet,) = composite.parts(self)
        alpha = self.values["alpha"]
        if not alpha.ndim:
            return _integrated(self.spec, facet, alpha, p)
        # Each channel has nodes of its own.
        channels = [_channel(facet, k) for k in range(len(self.channels))]
        found = [_integrated(self.spec, one, a, p) for one, a in zip(channels, alpha, strict=True)]
        return jnp.concatenate(found, axis=-1)

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        ((kind, inner, own),) = composite.kinds(spec, values)
        found = kind.lobes(inner, own)
        sharp = [share for lobe, share in found if not isinstance(lobe, CosineLobe)]
        if not sharp:
            return found
        # A facet's lobe is spread by the slopes: between the lobe itself and that of rough mirrors.
        normals = ndf.each(spec, values)
        spread = sum(sharp[1:], start=sharp[0]) / len(normals)
        return [*found, *((HalfVectorLobe(d), spread) for d in normals), (CosineLobe(), spread)]


def _check(spec: ModelSpec) -> None:
    """Refuse facets that are ideal mirrors, transmit, or have a direction of their own."""
    ((kind, inner),) = composite.families(spec)
    defaults = {p.name: jnp.full((1,) if p.linear else (), p.default) for p in kind.parameter_table(inner)}
    zero, one = jnp.zeros(()), jnp.ones(())
    if kind.transmits(inner):
        why, remedy = "transmits light", "use rough_dielectric"
    elif kind.deltas(inner, defaults, zero, zero, one):
        why, remedy = "is an ideal mirror", "use torrance_sparrow: its facets are mirrors"
    elif not kind.isotropic(inner):
        why, remedy = "is anisotropic, and a facet has no direction of its own", "use its isotropic form"
    else:
        return
    raise SpecError(
        f"facets can't be {inner.name}: it {why}", code="bad-spec", parameter="components", remedy=remedy
    )


def _channel(model: ReflectanceModel, k: int) -> ReflectanceModel:
    """One channel of a model as a model of its own."""
    own = {name: v[k : k + 1] if v.ndim else v for name, v in model.values.items()}
    return type(model)(spec=model.spec, channels=model.channels[k : k + 1], values=own)


def _integrated(spec: ModelSpec, facet: ReflectanceModel, alpha: Array, p: Pair) -> Array:
    """f of pairs (...), (..., C), for one roughness (); CHUNK pairs at a time."""
    above = p.above
    p = p.lifted()
    shape = p.iz.shape
    flat = Pair(*(component.reshape(-1) for component in p))
    count = flat.iz.size
    size = min(CHUNK, max(count, 1))
    more = (0, -count % size)
    chunks = Pair(*(jnp.pad(c, more, mode="edge").reshape(-1, size) for c in flat))
    # Remembering the nodes of every chunk for the gradient would need all the memory again.
    sums = jax.lax.map(jax.checkpoint(lambda q: _integral(spec, facet, alpha, q)), chunks)
    sums = sums.reshape(-1, sums.shape[-1])[:count].reshape(*shape, sums.shape[-1])
    normals = ndf.of(spec, {"alpha": alpha})
    shadowing = 4.0 * smith(p, Half.of(p), normals)
    return jnp.where(above[..., None], sums * shadowing[..., None], 0.0)


def _integral(spec: ModelSpec, facet: ReflectanceModel, alpha: Array, p: Pair) -> Array:
    """Int f_facet (wi.m)+ (wo.m)+ D dm for pairs (M,), (M, C)."""
    kind = spec.ndf or "ggx"
    phi, w_phi, rho, w_rho = jax.lax.stop_gradient(_nodes(kind, alpha, p))
    slope = alpha * rho
    tx, ty = slope * jnp.cos(phi)[:, None], slope * jnp.sin(phi)[:, None]
    mz = 1.0 / jnp.sqrt(1.0 + slope * slope)
    mx, my = tx * mz, ty * mz
    # The frame of Duff et al. 2017 (JCGT 6(1)), smooth for every facet that looks up.
    a = -1.0 / (1.0 + mz)
    b = mx * my * a

    def local(x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        return (
            (1.0 + mx * mx * a) * x + b * y - mx * z,
            b * x + (1.0 + my * my * a) * y - my * z,
            mx * x + my * y + mz * z,
        )

    q = Pair(*local(p.ix, p.iy, p.iz), *local(p.ox, p.oy, p.oz))
    seen = jnp.maximum(q.iz, 0.0) * jnp.maximum(q.oz, 0.0)
    # D dm = P d(slopes) / cos(m).
    weight = slopes.density(kind, rho * rho) * rho * w_rho * w_phi[:, None] * seen / mz
    return jnp.sum(weight[..., None] * facet.value(q), axis=(0, 1))


def _nodes(kind: str, alpha: Array, p: Pair) -> tuple[Array, Array, Array, Array]:
    """Azimuths and their weights (A, M), radii in units of alpha and their weights (A, R, M) for pairs (M,).

    They follow the pair so that what turns its back contributes nothing: no derivative passes through them.
    """
    phi_i, phi_o = jnp.arctan2(p.iy, p.ix), jnp.arctan2(p.oy, p.ox)
    # The facet that sees both wi and wo edge-on: the ends of the radii have a kink at its azimuth.
    x, y, z = p.iy * p.oz - p.iz * p.oy, p.iz * p.ox - p.ix * p.oz, p.ix * p.oy - p.iy * p.ox
    corner = jnp.arctan2(jnp.where(z < 0, -y, y), jnp.where(z < 0, -x, x))
    quarter = 0.5 * math.pi
    ends = jnp.stack([phi_i - quarter, phi_i + quarter, phi_o - quarter, phi_o + quarter, corner])
    ends = jnp.sort(jnp.mod(ends, 2.0 * math.pi), axis=0)
    widths = jnp.roll(ends, -1, axis=0) - ends
    widths = widths.at[-1].add(2.0 * math.pi)
    x, w = slopes.clustered(AZIMUTHS, p.iz)
    phi = (ends[:, None] + widths[:, None] * x[:, None]).reshape(-1, ends.shape[1])
    w_phi = (widths[:, None] * w[:, None]).reshape(phi.shape)
    # In the facet's angle theta: it ends at pi/2, slopes never do.
    last = jnp.arctan(jnp.minimum(_edge(p.ix, p.iy, p.iz, phi), _edge(p.ox, p.oy, p.oz, phi))) / alpha
    last = jnp.minimum(last, 7.0) if kind == "beckmann" else last
    x, w = slopes.gauss(RADII, p.iz)
    theta, w_theta = slopes.graded(jnp.zeros_like(last)[:, None], last[:, None], x[:, None], w[:, None])
    slope = jnp.tan(alpha * theta)
    return phi, w_phi, slope / alpha, w_theta * (1.0 + slope * slope)


def _edge(x: Array, y: Array, z: Array, phi: Array) -> Array:
    """The slope at which a facet of azimuth phi turns its back on (x, y, z); at most 1e5."""
    away = -(x * jnp.cos(phi) + y * jnp.sin(phi))
    return jnp.where(away > 1e-5 * z, z / jnp.where(away > 1e-5 * z, away, 1.0), 1e5)
