"""Columns that Arrow holds, wherever they come from, as numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.formats.source import Source

FloatArray = NDArray[np.float64]


def refuse_same_names(source: Source, names: Sequence[str]) -> None:
    """Raise TableError where several columns have one name."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise source.error(
            f"{len(twice)} names are those of several columns", "table-columns", column=twice[0],
            remedy="give every column its own name",
        )  # fmt: skip


def floats(
    source: Source, names: Sequence[str], rows: int, use: Sequence[int], column: Callable[[int], Any],
    refusing: Callable[[str], AbstractContextManager[None]],
) -> FloatArray:  # fmt: skip
    """The columns ``use`` as (rows, len(use)), each contiguous; null is NaN.

    column : gives column k as an Arrow chunked array; refusing : turns what Arrow raises at the column of a
    name into a TableError. TableError for text, dates and nested columns.
    """
    import pyarrow as arrow

    values = np.empty((len(use), rows)).T
    for j, k in enumerate(use):
        found = column(k)
        types: Any = arrow.types
        kind = found.type.value_type if types.is_dictionary(found.type) else found.type
        if not (
            types.is_floating(kind) or types.is_integer(kind) or types.is_boolean(kind)
            or types.is_decimal(kind) or types.is_null(kind)
        ):  # fmt: skip
            raise source.error(
                f"the column holds {str(found.type)[:40]}, not numbers", "table-not-a-number",
                column=names[k], remedy="make it float64, or declare it as 'ignore'",
            )  # fmt: skip
        with refusing(names[k]):
            values[:, j] = found.cast(kind).cast(arrow.float64(), safe=False).to_numpy()
    return values
