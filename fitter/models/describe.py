"""What there is to say about a model before it has parameter values: for command line, HTTP and docs."""

from __future__ import annotations

import inspect
from typing import Any

from fitter.models.registry import family_of
from fitter.spec import FAMILIES, OPTIONS, ModelSpec


def default(family: str) -> ModelSpec:
    """A family in its default form; one that is built of other models gets Lambertian parts."""
    options = OPTIONS[family]
    count = len(options.parts) if options.fewest is None else options.fewest
    return ModelSpec(family=family, components=(ModelSpec(family="lambert"),) * count)


def documentation(spec: ModelSpec) -> str:
    """What the family's module says about itself: its mathematics and its references."""
    module = inspect.getmodule(family_of(spec))
    assert module is not None
    return inspect.cleandoc(module.__doc__ or "")


def describe(spec: ModelSpec) -> dict[str, Any]:
    """JSON-ready: names, options with the default first, the parameter table, and what kind of model it is.

    ``parts`` are the prefixes of the components' parameters, for a family that is built of other models.
    Raises SpecError for components that the family can't be built of.
    """
    kind, options = family_of(spec), OPTIONS[spec.family]
    choices = {name: list(allowed) for name, allowed in options.choices.items()}
    if len(options.diffuse) > 1:
        choices["diffuse"] = list(options.diffuse)
    return {
        "name": spec.name, "family": spec.family, "spec": spec.model_dump(mode="json"),
        "summary": " ".join(documentation(spec).partition("\n\n")[0].split()),
        "options": choices, "max_lobes": options.max_lobes, "anisotropic": options.anisotropic,
        "parts": list(options.parts), "fitted": spec.family in FAMILIES,
        "reciprocal": kind.reciprocal(spec), "transmits": kind.transmits(spec),
        "parameters": [parameter.to_dict() for parameter in kind.parameter_table(spec)],
    }  # fmt: skip
