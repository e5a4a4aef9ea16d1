"""Normal distribution functions D(h), normalised so that the integral of D cos(theta_h) d omega is 1.

Each is a small pytree with its density, Smith's Lambda and its own sampling. Densities take the
unnormalised half vector: tan^2 from its components keeps the digits near the normal that 1 - cos^2 loses
(relative error 7e-2 at alpha = 1e-3 in float32).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import jax.numpy as jnp
from jax import Array

from fitter.models import ndf_blinn, ndf_gaussian, roughness
from fitter.models.ndf_blinn import Blinn
from fitter.models.ndf_gaussian import Gaussian
from fitter.models.ndf_shape_invariant import GGX, Beckmann
from fitter.models.pair import Half
from fitter.models.parameters import Parameter
from fitter.spec import ModelSpec

__all__ = [
    "GGX", "NDF", "Beckmann", "Blinn", "Distribution", "Gaussian", "each", "of", "parameters", "widest",
]  # fmt: skip

Distribution = Beckmann | GGX | Blinn | Gaussian


#: Those with a roughness, which only stretches them, by the names that specifications have for them.
SHAPE_INVARIANT = {"ggx": GGX, "beckmann": Beckmann}


@runtime_checkable
class NDF(Protocol):
    """A distribution of microfacet normals."""

    def density(self, h: Half, times: Array | float = 1.0) -> Array:
        """D(h), 1/sr, of half vectors above the horizon, times a factor.

        A large factor belongs inside: the product may be a normal number where D alone underflows.
        """
        ...

    def lambda_cos(self, x: Array, y: Array, z: Array) -> Array:
        """Smith's Lambda(w) times cos(theta_w) of unit vectors w = (x, y, z), z >= 0 (finite at grazing)."""
        ...

    def sample(self, u: Array) -> Array:
        """(n, 3) normals with density D cos(theta_h) for uniform u (n, 2)."""
        ...


def parameters(spec: ModelSpec) -> tuple[Parameter, ...]:
    """The parameters of the distribution that a specification names."""
    if spec.ndf == "blinn":
        return (ndf_blinn.N,)
    if spec.ndf == "gaussian":
        return (ndf_gaussian.S,)
    return roughness.parameters(spec.anisotropic)


def widest(p: Parameter) -> float:
    """The bound of a parameter of a distribution at which its lobe is widest."""
    return p.lower if p.name == ndf_blinn.N.name else p.upper


def of(spec: ModelSpec, values: Mapping[str, Array]) -> Distribution:
    """The distribution that a specification names, from a model's nonlinear parameters."""
    if spec.ndf == "blinn":
        return Blinn(values["n"])
    if spec.ndf == "gaussian":
        return Gaussian(values["s"])
    # Ward's lobe, which has no such option, is drawn by Beckmann's distribution.
    return SHAPE_INVARIANT[spec.ndf or "beckmann"](roughness.of(spec.anisotropic, values))


def each(spec: ModelSpec, values: Mapping[str, Array]) -> list[Distribution]:
    """One distribution per channel where its parameters are per channel, else one: what lobes draw from."""
    arrays = {p.name: jnp.atleast_1d(values[p.name]) for p in parameters(spec)}
    count = max(len(a) for a in arrays.values())
    wide = {name: jnp.broadcast_to(a, (count,)) for name, a in arrays.items()}
    return [of(spec, {name: a[k] for name, a in wide.items()}) for k in range(count)]
