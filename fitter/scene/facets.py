"""Families whose facets are those of Torrance and Sparrow, as such models: what is bounded and rendered of
those holds for these."""

from __future__ import annotations

from fitter.models import ReflectanceModel, metallic_roughness
from fitter.models.torrance_sparrow import TorranceSparrow
from fitter.spec import ModelSpec


def as_facets(model: ReflectanceModel) -> ReflectanceModel:
    """The same reflectance (of Kulla-Conty the light that meets one facet); other models as they are."""
    if isinstance(model, metallic_roughness.MetallicRoughness):
        spec = ModelSpec(family="torrance_sparrow", ndf="ggx", masking="smith", diffuse="coupled")
        values = metallic_roughness.facets(model.values)
    elif model.spec.family == "kulla_conty":
        spec = ModelSpec(
            family="torrance_sparrow", ndf=model.spec.ndf, masking="smith", fresnel=model.spec.fresnel,
            diffuse="none",
        )  # fmt: skip
        values = model.values
    else:
        return model
    return TorranceSparrow(spec=spec, channels=model.channels, values=values)
