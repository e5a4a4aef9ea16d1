"""The Lambertian term beneath a specular one, and the parameters most families share."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
from jax import Array

from fitter.models.lobes import CosineLobe, Lobe
from fitter.models.parameters import Parameter
from fitter.spec import ModelSpec

KD = Parameter("kd", "1", 0.0, math.inf, 0.3, "diffuse albedo of the Lambertian term kd/pi", linear=True)
KS = Parameter("ks", "1", 0.0, math.inf, 0.1, "scale of the specular term", linear=True)


def with_diffuse(spec: ModelSpec, parameters: Sequence[Parameter]) -> tuple[Parameter, ...]:
    """``parameters`` behind kd, where the specification has the diffuse term."""
    return tuple(parameters) if spec.diffuse == "none" else (KD, *parameters)


def diffuse_lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
    """What :meth:`ReflectanceModel.lobes` has for an additive diffuse term, where there is one."""
    return [] if spec.diffuse == "none" else [(CosineLobe(), jnp.mean(values["kd"]))]


def masked_terms(
    spec: ModelSpec, above: Array, lobes: Sequence[Array], entering: Array | float = 1.0
) -> tuple[Array, ...]:
    """The terms of a family, 0 below the horizon: 1/pi where it has the diffuse term, then ``lobes``.

    entering : the part of the light that reaches the diffuse term, 1 where it is additive.
    """
    terms = tuple(lobes)
    if spec.diffuse != "none":
        terms = (jnp.broadcast_to(entering / math.pi, jnp.shape(terms[0])).astype(terms[0].dtype), *terms)
    return tuple(jnp.where(above, term, 0.0) for term in terms)
