"""Packages that only some formats need: imported when such a file is met, named where they are missing."""

from __future__ import annotations

import importlib
from typing import Any

from fitter.errors import TableError


def optional_package(module: str, extra: str, purpose: str, file: str | None) -> Any:
    """The module, or a TableError that says how to install it.

    extra : the project's optional dependency that brings it. purpose : what it is for, as "Parquet files".
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise TableError(
            f"{purpose} need the package {package}, which can't be imported ({error})",
            code="package-missing", file=file, cause="it is not installed: only some formats need it",
            remedy=f"pip install 'brdf-fitter[{extra}]', or pip install {package}",
        ) from error  # fmt: skip
