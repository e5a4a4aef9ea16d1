"""Packages that not everyone needs: imported when they are, named where they are missing."""

from __future__ import annotations

import importlib
from typing import Any

from fitter.errors import TableError


def optional_package(module: str, extra: str | None, purpose: str, file: str | None) -> Any:
    """The module, or a TableError that says how to install it.

    extra : the project's optional dependency that brings it, None where none does. purpose : what it is for,
        as "Parquet files".
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise TableError(
            f"{purpose} need the package {package}, which can't be imported ({error})",
            code="package-missing", file=file,
            cause=f"it is not installed: only {purpose} need it",
            remedy=("" if extra is None else f"pip install 'brdf-fitter[{extra}]', or ")
            + f"pip install {package}",
        ) from error  # fmt: skip
