"""The shape-invariant distributions, Beckmann and GGX: slopes of one law, scaled by the roughness.

Only such a distribution has an anisotropic form and a closed Smith term for it (E. Heitz 2014, JCGT 3(2)).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.scipy.special import erfc

from fitter.models.pair import Half, Pair
from fitter.models.roughness import Isotropic, Roughness


class Beckmann(NamedTuple):
    """Beckmann and Spizzichino 1963: exp(-tan^2/alpha^2) / (pi alpha^2 cos^4)."""

    roughness: Roughness

    def density(self, h: Half, times: Array | float = 1.0) -> Array:
        sec2 = h.sec2
        # The root of the exponential, twice: it underflows only where the product has.
        root = jnp.exp(-0.5 * self.roughness.slope2(h.x, h.y, h.z))
        return root * (root * (sec2 * sec2 / (math.pi * self.roughness.area)) * times)

    def lambda_cos(self, x: Array, y: Array, z: Array) -> Array:
        """Lambda = exp(-a^2)/(2 a sqrt(pi)) - erfc(a)/2, a = cos/(alpha sin) (Heitz 2014, eq. 66 with 72).

        Near the normal a -> inf and Lambda -> 0; the root is guarded because it has no slope there.
        """
        p2 = self.roughness.projected2(x, y)
        p = jnp.sqrt(jnp.maximum(p2, float(jnp.finfo(p2.dtype).tiny)))
        # Beyond a = 6, exp(-a^2) < 3e-16: Lambda is below the rounding of 1 + Lambda.
        near = z >= 6.0 * p
        a = jnp.where(near, 6.0, z / jnp.where(near, 1.0, p))
        # z/a = p: written so, the first term is finite at z = 0.
        product = jnp.exp(-a * a) * p / (2.0 * math.sqrt(math.pi)) - 0.5 * z * erfc(a)
        return jnp.where(near, 0.0, product)

    def sample(self, u: Array) -> Array:
        return _from_slopes(self.roughness, jnp.sqrt(-jnp.log1p(-u[:, 0])), u[:, 1])

    def envelope(self) -> GGX:
        """D is at most 4/e times that of GGX of the same roughness: e^-t (1 + t)^2 is largest at t = 1."""
        return GGX(self.roughness)


class GGX(NamedTuple):
    """Trowbridge and Reitz 1975 (GGX, Walter et al. 2007): 1 / (pi alpha^2 cos^4 (1 + tan^2/alpha^2)^2)."""

    roughness: Roughness

    def density(self, h: Half, times: Array | float = 1.0) -> Array:
        # |H|^2 and H_z^2 rather than tan^2, whose slopes cancel where it is large.
        ratio = h.squared / (h.z * h.z + self.roughness.slope2(h.x, h.y, jnp.ones_like(h.z)))
        return ratio * ratio / (math.pi * self.roughness.area) * times

    def scaled_density(self, h: Half) -> Array:
        """D / (alpha_x alpha_y): what is left where D rises as the square of the roughness."""
        area, along = self.roughness.area, h.z * h.z
        # H is as small as 1e-6: its squares are divided before they are inverted, or the slope overflows.
        one = 1.0 / h.squared
        if isinstance(self.roughness, Isotropic):
            # area cos^2 + sin^2, whose terms have slopes that cancel at a roughness of about 1, with sin^2 by
            # the form whose own don't.
            across = h.x * h.x + h.y * h.y
            inverse = area + (1.0 - area) * jnp.where(across < along, across * one, 1.0 - along * one)
        else:
            x, y = self.roughness.shortened(h.x, h.y)
            inverse = (area * along + x * x + y * y) * one
        return 1.0 / (math.pi * inverse * inverse)

    def scaled(self, p: Pair) -> tuple[GGX, Pair]:
        """The unit distribution, and the pair whose Lambda cos of it is that of ``p`` over sqrt(area)."""
        mean = jnp.sqrt(self.roughness.area)
        ix, iy = self.roughness.elongated(p.ix, p.iy)
        ox, oy = self.roughness.elongated(p.ox, p.oy)
        return GGX(Isotropic(jnp.ones_like(mean))), Pair(ix, iy, p.iz / mean, ox, oy, p.oz / mean)

    def lambda_cos(self, x: Array, y: Array, z: Array) -> Array:
        """Lambda = (sqrt(1 + alpha^2 tan^2) - 1)/2, times cos, without cancellation near the normal."""
        p2 = self.roughness.projected2(x, y)
        return 0.5 * p2 / (jnp.sqrt(z * z + p2) + z)

    def sample(self, u: Array) -> Array:
        return _from_slopes(self.roughness, jnp.sqrt(u[:, 0] / (1.0 - u[:, 0])), u[:, 1])

    def sample_visible(self, wi: Array, u: Array) -> Array:
        """(n, 3) normals with the density that is seen from wi (3,), G1 D max(0, wi.h) / cos_i.

        E. Heitz 2018 (JCGT 7(4)): stretched to the unit roughness the facets are a hemisphere. J. Dupuy and
        A. Benyoub 2023 (Computer Graphics Forum 42(8)): reflections in its visible normals fill a
        spherical cap evenly. Heights are kept as distances from the cap's ends, which don't cancel.
        """
        x, y = self.roughness.projected(wi[0], wi[1])
        length = jnp.sqrt(x * x + y * y + wi[2] * wi[2])
        x, y, z = x / length, y / length, wi[2] / length
        below = u[:, 0] * (1.0 + z)  # from the top of the cap down
        sine = jnp.sqrt(below * (2.0 - below))
        phi = 2 * math.pi * u[:, 1]
        hx, hy = self.roughness.stretch(sine * jnp.cos(phi) + x, sine * jnp.sin(phi) + y)
        hz = (1.0 - u[:, 0]) * (1.0 + z)
        inverse = 1.0 / jnp.sqrt(hx * hx + hy * hy + hz * hz)
        return jnp.stack([hx * inverse, hy * inverse, hz * inverse], axis=-1)

    def envelope(self) -> GGX:
        return self


def _from_slopes(rough: Roughness, radius: Array, turn: Array) -> Array:
    """(n, 3) normals whose slopes have that radius in units of the roughness."""
    phi = 2 * math.pi * turn
    x, y = rough.stretch(radius * jnp.cos(phi), radius * jnp.sin(phi))
    z = 1.0 / jnp.sqrt(1.0 + x * x + y * y)
    return jnp.stack([x * z, y * z, z], axis=-1)
