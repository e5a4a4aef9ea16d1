"""A sum of other models: f = f_a + f_b + ..., each with parameters of its own (prefix a_, b_, ...)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from fitter.models import composite
from fitter.models.base import ReflectanceModel
from fitter.models.lobes import Delta, Lobe, OneSided
from fitter.models.pair import Pair
from fitter.models.parameters import Parameter
from fitter.spec import ModelSpec


class Sum(composite.Composite):
    family: ClassVar[str] = "sum"

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        return composite.parameters(spec)

    def value(self, p: Pair) -> Array:
        parts = [part.value(p) for part in composite.parts(self)]
        return jnp.sum(jnp.stack(parts), axis=0)

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        transmits = Sum.transmits(spec)
        found: list[tuple[Lobe, Array]] = []
        for kind, inner, own in composite.kinds(spec, values):
            for lobe, share in kind.lobes(inner, own):
                found.append((OneSided(lobe) if transmits and not kind.transmits(inner) else lobe, share))
        return found

    @staticmethod
    def deltas(
        spec: ModelSpec, values: Mapping[str, Array], x: Array, y: Array, z: Array
    ) -> tuple[Delta, ...]:
        return tuple(
            delta
            for kind, inner, own in composite.kinds(spec, values)
            for delta in kind.deltas(inner, own, x, y, z)
        )

    @staticmethod
    def transmits(spec: ModelSpec) -> bool:
        return any(kind.transmits(inner) for kind, inner in composite.families(spec))

    @staticmethod
    def refractive_index(spec: ModelSpec, values: Mapping[str, Array]) -> Array:
        """That of the first component that transmits."""
        for kind, inner, own in composite.kinds(spec, values):
            if kind.transmits(inner):
                return kind.refractive_index(inner, own)
        return ReflectanceModel.refractive_index(spec, values)
