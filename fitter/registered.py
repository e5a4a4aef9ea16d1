"""Registries: what the modules of a folder declare, found by looking into it."""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType
from typing import TypeVar

_T = TypeVar("_T")


def declared(package: ModuleType, name: str, kind: type[_T]) -> list[_T]:
    """Of every module of ``package`` that has one, its ``name``, where that is a ``kind``."""
    found: list[_T] = []
    for module in pkgutil.iter_modules(package.__path__):
        entry = getattr(importlib.import_module(f"{package.__name__}.{module.name}"), name, None)
        if isinstance(entry, kind):
            found.append(entry)
    return found
