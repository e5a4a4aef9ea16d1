"""Roughness of a distribution of slopes: one width, or two along axes turned by psi.

Everything is written on direction components (B. Walter 2005; Heitz 2014): slopes measured in units of the
roughness, and projections stretched by it, need no angles and are smooth at the normal.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from fitter.models.parameters import Parameter

ALPHA = Parameter(
    "alpha", "1", 1e-4, 2.0, 0.2, "roughness: rms slope of the facets times sqrt(2)", search="log"
)
ALPHA_X = Parameter(
    "alpha_x", "1", 1e-4, 2.0, 0.1, "roughness along the direction psi", search="log"
)  # fmt: skip
ALPHA_Y = Parameter("alpha_y", "1", 1e-4, 2.0, 0.3, "roughness across the direction psi", search="log")
PSI = Parameter("psi", "rad", -math.pi, math.pi, 0.0, "azimuth of the first axis of roughness (brushing)")


class Isotropic(NamedTuple):
    """One roughness alpha, () or broadcastable to the pair."""

    alpha: Array

    @property
    def area(self) -> Array:
        """alpha_x alpha_y."""
        return self.alpha * self.alpha

    def slope2(self, x: Array, y: Array, z: Array) -> Array:
        """tan^2 of a direction's polar angle over alpha^2."""
        x, y = x / (self.alpha * z), y / (self.alpha * z)
        return x * x + y * y

    def projected(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Components of a direction stretched by the roughness: those it has above the unit roughness."""
        return self.alpha * x, self.alpha * y

    def projected2(self, x: Array, y: Array) -> Array:
        """alpha^2 sin^2 of a direction."""
        return self.alpha * self.alpha * (x * x + y * y)

    def elongated(self, x: Array, y: Array) -> tuple[Array, Array]:
        """The components of :meth:`projected` in units of the mean roughness sqrt(alpha_x alpha_y)."""
        return x, y

    def stretch(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Slopes of the unit roughness as those of this one."""
        return self.alpha * x, self.alpha * y


class Anisotropic(NamedTuple):
    """alpha_x along the azimuth psi, alpha_y across it."""

    alpha_x: Array
    alpha_y: Array
    psi: Array

    @property
    def area(self) -> Array:
        return self.alpha_x * self.alpha_y

    def turned(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Components along the axes of roughness."""
        return turned(self.psi, x, y)

    def slope2(self, x: Array, y: Array, z: Array) -> Array:
        x, y = self.turned(x, y)
        x, y = x / (self.alpha_x * z), y / (self.alpha_y * z)
        return x * x + y * y

    def projected(self, x: Array, y: Array) -> tuple[Array, Array]:
        x, y = self.turned(x, y)
        return self.alpha_x * x, self.alpha_y * y

    def projected2(self, x: Array, y: Array) -> Array:
        x, y = self.projected(x, y)
        return x * x + y * y

    def elongated(self, x: Array, y: Array) -> tuple[Array, Array]:
        ratio = jnp.sqrt(self.alpha_x / self.alpha_y)
        x, y = self.turned(x, y)
        return ratio * x, y / ratio

    def shortened(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Slopes, as :meth:`slope2` measures them, in units of the mean roughness."""
        ratio = jnp.sqrt(self.alpha_x / self.alpha_y)
        x, y = self.turned(x, y)
        return x / ratio, ratio * y

    def stretch(self, x: Array, y: Array) -> tuple[Array, Array]:
        return turned(-self.psi, self.alpha_x * x, self.alpha_y * y)


Roughness = Isotropic | Anisotropic


def turned(psi: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Components x, y in a frame whose x axis has azimuth psi."""
    c, s = jnp.cos(psi), jnp.sin(psi)
    return c * x + s * y, c * y - s * x


def parameters(anisotropic: bool) -> tuple[Parameter, ...]:
    return (ALPHA_X, ALPHA_Y, PSI) if anisotropic else (ALPHA,)


def of(anisotropic: bool, values: Mapping[str, Array]) -> Roughness:
    """The roughness of a model's nonlinear parameters."""
    if anisotropic:
        return Anisotropic(values["alpha_x"], values["alpha_y"], values["psi"])
    return Isotropic(values["alpha"])
