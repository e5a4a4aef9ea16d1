"""Powers of a cosine about an axis that follows wi: their exponent, value and density for sampling."""

from __future__ import annotations

import math

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from fitter.models.pair import Pair
from fitter.models.parameters import Parameter
from fitter.models.roughness import turned

#: A fit looks where measured materials are; 0 is a constant lobe, 1e6 a width of a milliradian.
EXPONENT = Parameter(
    "n", "1", 0.0, 1e6, 20.0, "exponent: larger is narrower", search="log", search_range=(0.1, 1e5)
)


def power(base: Array, n: Array) -> Array:
    """max(0, base)^n, and 0 for base <= 0 whatever n >= 0; value and slopes finite for any stored base."""
    # x**n has NaN slopes for x <= 0 even where masked out: guard the argument. 1/x must not overflow either.
    positive = base > 4 * float(jnp.finfo(base.dtype).tiny)
    return jnp.where(positive, jnp.exp(n * jnp.log(jnp.where(positive, base, 1.0))), 0.0)


class PhongLobe(eqx.Module):
    """Density (n + 1)/(2 pi) cos^n about the axis C o wi, component-wise, in a frame turned by psi
    (E. Lafortune et al. 1997).

    All fields are scalars (); ``psi`` None is the sample's own frame. The axis of Phong's mirror lobe is
    C = (-1, -1, 1). What falls below the horizon is lost.
    """

    cx: Array
    cy: Array
    cz: Array
    n: Array
    psi: Array | None = None

    def sample(self, wi: Array, u: Array) -> Array:
        x, y, z = self._axis(wi[0], wi[1], wi[2])
        # 1 - cos in closed form: cos = u^(1/(n+1)) rounds to 1 for large n.
        one_minus = -jnp.expm1(jnp.log1p(-u[:, 0]) / (self.n + 1.0))
        cos_t = 1.0 - one_minus
        sin_t = jnp.sqrt(one_minus * (1.0 + cos_t))
        phi = 2 * math.pi * u[:, 1]
        t, b = _frame(x, y, z)
        axis = jnp.stack([x, y, z])
        return (
            (sin_t * jnp.cos(phi))[:, None] * t + (sin_t * jnp.sin(phi))[:, None] * b + cos_t[:, None] * axis
        )

    def pdf(self, p: Pair) -> Array:
        x, y, z = self._axis(p.ix, p.iy, p.iz)
        # cos = 1 - |axis - wo|^2/2: rounding of the directions enters squared, which n = 1e6 needs.
        x, y, z = x - p.ox, y - p.oy, z - p.oz
        one_minus = 0.5 * (x * x + y * y + z * z)
        ok = one_minus < 1.0
        power = jnp.exp(self.n * jnp.log1p(-jnp.where(ok, one_minus, 0.0)))
        return jnp.where(ok, power, 0.0) * (self.n + 1.0) / (2 * math.pi)

    def _axis(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        """Unit vector along C o wi; the normal where that has no length."""
        if self.psi is not None:
            x, y = turned(self.psi, x, y)
        x, y, z = self.cx * x, self.cy * y, self.cz * z
        if self.psi is not None:
            x, y = turned(-self.psi, x, y)
        # Scaled by the largest component: squares of tiny ones underflow in float32.
        largest = jnp.maximum(jnp.maximum(jnp.abs(x), jnp.abs(y)), jnp.abs(z))
        some = largest > 0
        scale = jnp.where(some, largest, 1.0)
        x, y, z = x / scale, y / scale, jnp.where(some, z / scale, 1.0)
        length = jnp.sqrt(x * x + y * y + z * z)
        return x / length, y / length, z / length


def _frame(x: Array, y: Array, z: Array) -> tuple[Array, Array]:
    """Two unit vectors orthogonal to (x, y, z) and each other (Duff et al. 2017, JCGT 6(1))."""
    sign = jnp.where(z >= 0, jnp.ones_like(z), -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return (
        jnp.stack([1.0 + sign * x * x * a, sign * b, -sign * x]),
        jnp.stack([b, sign + y * y * a, -y]),
    )
