"""The lobe of a rough interface: a facet is drawn, then reflection or refraction at it by their power."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from fitter.models import fresnel, refraction
from fitter.models.ndf import GGX
from fitter.models.pair import Half, Pair
from fitter.models.refraction import Crossing

_UP = (0.0, 0.0, 1.0, 0.0, 0.0, -1.0)


class InterfaceLobe(eqx.Module):
    """Density over the whole sphere of wo, for wi on either side (Walter et al. 2007, eqs 13 to 17).

    A facet h with the density visible from wi, D(h) max(0, wi.h) / (|cos_i| (1 + Lambda_i)) (E. Heitz 2018);
    reflected with probability ks F/(ks F + kt T), else refracted. Weights f |cos_o| / pdf are then bounded.
    What would leave on the wrong side of the surface is put on the horizon, z = 0: lost.
    """

    facets: GGX
    eta: Array
    ks: Array
    kt: Array

    def sample(self, wi: Array, u: Array) -> Array:
        above = wi[2] > 0
        ni, no = refraction.indices(above, self.eta)
        up = jnp.stack([wi[0], wi[1], jnp.abs(wi[2])])
        h = self.facets.sample_visible(up, u[:, :2])
        c = h @ up
        # A facet edge-on can round to one that faces away.
        hit = c > 0
        c = jnp.where(hit, c, 1.0)
        ct, _ = refraction.refracted_cosine(c, (1.0 - c) * (1.0 + c), ni, no)
        f = fresnel.dielectric(c, no / ni)
        mirrored = u[:, 2] < self._choose(f, 1.0 - f)[0]
        ratio = ni / no
        along = jnp.where(mirrored, 2.0 * c, ratio * c - ct)
        wo = along[:, None] * h - jnp.where(mirrored, 1.0, ratio)[:, None] * up
        z = wo[:, 2]
        right = hit & (jnp.where(mirrored, z, -z) > 0)
        return jnp.stack([wo[:, 0], wo[:, 1], jnp.where(right, jnp.where(above, z, -z), 0.0)], axis=-1)

    def pdf(self, p: Pair) -> Array:
        p, above = refraction.seen_from_above(p)
        ni, no = refraction.indices(above, self.eta)
        return self._reflection(p, ni, no) + self._transmission(p, ni, no)

    def _choose(self, f: Array, t: Array) -> tuple[Array, Array]:
        """The probabilities of reflection and refraction where F = f and 1 - F = t."""
        reflected, transmitted = self.ks * f, self.kt * t
        total = reflected + transmitted
        lit = total > 0
        total = jnp.where(lit, total, 1.0)
        return jnp.where(lit, reflected / total, f), jnp.where(lit, transmitted / total, t)

    def _reflection(self, p: Pair, ni: Array, no: Array) -> Array:
        above = p.above
        p = p.lifted()
        h = Half.of(p)
        f = fresnel.dielectric(fresnel.facet_cosine(h), no / ni)
        chosen, _ = self._choose(f, 1.0 - f)
        return jnp.where(above, 0.25 * chosen * self._visible(p, h), 0.0)

    def _transmission(self, p: Pair, ni: Array, no: Array) -> Array:
        x = Crossing.of(p, ni, no)
        t = refraction.transmittance(x.ci, x.co, ni, no)
        _, chosen = self._choose(1.0 - t, t)
        lit = Pair(
            *(jnp.where(x.ok, component, harmless) for component, harmless in zip(p, _UP, strict=True))
        )
        return jnp.where(x.ok, chosen * self._visible(lit, x.h) * x.ci * x.jacobian, 0.0)

    def _visible(self, p: Pair, h: Half) -> Array:
        """Density of the facet over wi.h: D / (cos_i + cos_i Lambda_i)."""
        return self.facets.density(h) / (p.iz + self.facets.lambda_cos(p.ix, p.iy, p.iz))
