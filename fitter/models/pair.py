"""A pair of directions split into six component arrays, the form the kernels take."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from numpy.typing import ArrayLike


class Pair(NamedTuple):
    """Components of wi = (ix, iy, iz) and wo = (ox, oy, oz), all of one broadcastable shape.

    Kernels take components because XLA streams them several times faster than (N, 3) rows.
    """

    ix: Array
    iy: Array
    iz: Array
    ox: Array
    oy: Array
    oz: Array

    @staticmethod
    def split(wi: ArrayLike, wo: ArrayLike) -> Pair:
        """From (..., 3) arrays, broadcast against each other."""
        i, o = jnp.asarray(wi), jnp.asarray(wo)
        return Pair(i[..., 0], i[..., 1], i[..., 2], o[..., 0], o[..., 1], o[..., 2])

    @property
    def above(self) -> Array:
        """True where both directions are above the horizon."""
        return (self.iz > 0) & (self.oz > 0)

    def lifted(self) -> Pair:
        """The pair with every direction that isn't above the horizon replaced by the normal.

        Kernels mask what they return with :attr:`above`, but a gradient flows through both branches of
        ``where``: it is the argument that has to be harmless.
        """
        ok = self.above
        zero, one = jnp.zeros_like(self.iz), jnp.ones_like(self.iz)
        pick = lambda x, y: jnp.where(ok, x, y)  # noqa: E731
        return Pair(
            pick(self.ix, zero), pick(self.iy, zero), pick(self.iz, one),
            pick(self.ox, zero), pick(self.oy, zero), pick(self.oz, one),
        )  # fmt: skip


class Half(NamedTuple):
    """The unnormalised half vector H = wi + wo and what follows from it without trigonometry."""

    x: Array
    y: Array
    z: Array
    squared: Array  # |H|^2

    @staticmethod
    def of(p: Pair) -> Half:
        x, y, z = p.ix + p.ox, p.iy + p.oy, p.iz + p.oz
        return Half(x, y, z, x * x + y * y + z * z)

    @property
    def sec2(self) -> Array:
        """1/cos^2 of the angle between H and the normal."""
        return 1.0 + self.tan2

    @property
    def tan2(self) -> Array:
        """tan^2 of the angle between H and the normal."""
        x, y = self.x / self.z, self.y / self.z
        return x * x + y * y
