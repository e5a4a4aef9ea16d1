"""Families whose facets are those of Torrance and Sparrow, as such models: what is bounded and rendered of
those holds for these."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp

from fitter.models import ReflectanceModel, metallic_roughness
from fitter.models.torrance_sparrow import TorranceSparrow
from fitter.spec import ModelSpec


def as_facets(spec: ModelSpec, values: Mapping[str, Any]) -> tuple[ModelSpec, dict[str, Any]]:
    """The same reflectance (of Kulla-Conty the light that meets one facet); others as they are."""
    if spec.family == "metallic_roughness":
        same = ModelSpec(family="torrance_sparrow", ndf="ggx", masking="smith", diffuse="coupled")
        return same, metallic_roughness.facets({name: jnp.asarray(x) for name, x in values.items()})
    if spec.family == "kulla_conty":
        same = ModelSpec(
            family="torrance_sparrow", ndf=spec.ndf, masking="smith", fresnel=spec.fresnel, diffuse="none"
        )
        return same, dict(values)
    return spec, dict(values)


def model_as_facets(model: ReflectanceModel) -> ReflectanceModel:
    """The same of a model."""
    spec, values = as_facets(model.spec, model.values)
    if spec is model.spec:
        return model
    return TorranceSparrow(spec=spec, channels=model.channels, values=values)
