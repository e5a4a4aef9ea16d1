"""Versions of what is installed, each looked up once: reading a distribution's metadata takes a while."""

from __future__ import annotations

import functools
import importlib.metadata


@functools.cache
def installed(name: str) -> str:
    """The version of the distribution ``name``. Raises importlib.metadata.PackageNotFoundError."""
    return importlib.metadata.version(name)
