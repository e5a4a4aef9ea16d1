"""JSON without NaN: arrays become lists, what is not finite becomes null, text becomes valid UTF-8."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

#: Significant digits of numbers that are only drawn.
DRAWN_DIGITS = 5


def clean(item: Any) -> Any:
    """``item`` as strict JSON allows it. Raises TypeError on what has no JSON form."""
    if item is None or isinstance(item, bool | np.bool_):
        return None if item is None else bool(item)
    if isinstance(item, str):
        # File names may hold bytes that are not UTF-8 (lone surrogates): no JSON writer takes them.
        return item.encode("utf-8", "replace").decode("utf-8")
    if isinstance(item, int | np.integer):
        return int(item)
    if isinstance(item, float | np.floating):
        number = float(item)
        return number if math.isfinite(number) else None
    if isinstance(item, Mapping):
        return {str(clean(str(key))): clean(part) for key, part in item.items()}
    if isinstance(item, np.ndarray):
        return clean(item.tolist())
    if isinstance(item, Sequence | set | frozenset):
        return [clean(part) for part in item]
    if hasattr(item, "tolist"):  # a JAX array
        return clean(item.tolist())
    raise TypeError(f"{type(item).__name__} has no JSON form")


def drawn(array: ArrayLike, digits: int = DRAWN_DIGITS) -> list[Any]:
    """A list rounded to ``digits`` significant digits: enough for a figure, a third of the text."""
    values = np.asarray(array, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        magnitude = np.where(values != 0, np.floor(np.log10(np.abs(values))), 0.0)
    # A factor beyond 1e300 would overflow; such numbers are kept as they are.
    small = np.isfinite(magnitude) & (np.abs(magnitude) < 290)
    factor = 10.0 ** np.where(small, digits - 1 - magnitude, 0.0)
    with np.errstate(invalid="ignore", over="ignore"):
        rounded = np.where(small, np.round(values * factor) / factor, values)
    return clean(rounded)
