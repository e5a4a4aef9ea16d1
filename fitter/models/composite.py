"""Models built of other models: whose parameters are whose."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from jax import Array

from fitter.models.base import ReflectanceModel
from fitter.models.parameters import Parameter
from fitter.models.registry import family_of
from fitter.spec import OPTIONS, ModelSpec


class Composite(ReflectanceModel):
    """A model built of others: as reciprocal and isotropic as all of them are."""

    @staticmethod
    def reciprocal(spec: ModelSpec) -> bool:
        return all(kind.reciprocal(inner) for kind, inner in families(spec))

    @staticmethod
    def isotropic(spec: ModelSpec) -> bool:
        return all(kind.isotropic(inner) for kind, inner in families(spec))


def prefixes(spec: ModelSpec) -> tuple[str, ...]:
    """What the parameters of each component begin with."""
    return OPTIONS[spec.family].parts[: len(spec.components)]


def families(spec: ModelSpec) -> list[tuple[type[ReflectanceModel], ModelSpec]]:
    """The class and specification of each component."""
    return [(family_of(inner), inner) for inner in spec.components]


def parameters(spec: ModelSpec) -> tuple[Parameter, ...]:
    """The components' parameters under their prefixed names, linear ones first."""
    every = [
        dataclasses.replace(p, name=prefix + p.name, description=f"{inner.family}: {p.description}")
        for prefix, (kind, inner) in zip(prefixes(spec), families(spec), strict=True)
        for p in kind.parameter_table(inner)
    ]
    return tuple(sorted(every, key=lambda p: not p.linear))


def kinds(
    spec: ModelSpec, values: Mapping[str, Array]
) -> list[tuple[type[ReflectanceModel], ModelSpec, dict[str, Array]]]:
    """The class, specification and own values of each component."""
    return [
        (kind, inner, {p.name: values[prefix + p.name] for p in kind.parameter_table(inner)})
        for prefix, (kind, inner) in zip(prefixes(spec), families(spec), strict=True)
    ]


def parts(model: ReflectanceModel) -> list[ReflectanceModel]:
    """The components as models of their own."""
    return [
        kind(spec=inner, channels=model.channels, values=own)
        for kind, inner, own in kinds(model.spec, model.values)
    ]
