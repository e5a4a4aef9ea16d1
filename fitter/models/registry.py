"""Which class a family is: every module of this room that defines one, found by name."""

from __future__ import annotations

import functools
import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fitter.models.base import ReflectanceModel
    from fitter.spec import ModelSpec


def family_of(spec: ModelSpec) -> type[ReflectanceModel]:
    """The class of a specification's family: it lives in the module of the family's name."""
    return _load(spec.family)


@functools.cache
def _load(family: str) -> type[ReflectanceModel]:
    from fitter.models.base import ReflectanceModel

    module = importlib.import_module(f"fitter.models.{family}")
    for found in vars(module).values():
        if (
            isinstance(found, type)
            and issubclass(found, ReflectanceModel)
            and vars(found).get("family") == family
        ):
            return found
    raise ImportError(f"fitter.models.{family} defines no model of that name")
