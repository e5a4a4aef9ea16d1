"""The scale on which a relative bound is a constant one: log1p(|f| / floor), signed, in steps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.compression.tile import SINGLE

FloatArray = NDArray[np.float64]

#: Below this tolerance the logarithm's own rounding would eat the bound: such tables are stored lossless.
SMALLEST_TOLERANCE = 1e-9
#: The step is this much smaller than the bound allows, so that rounding alone violates it next to never
#: (what still does is found on writing and corrected).
_GUARD = 1e-6
#: The same where both of two mirrored nodes have to be within the bound of one number.
FOLDED_GUARD = 0.01
# expm1 overflows above 709.78; from here on exp(y + log floor) is the same number to 1 part in 1e300.
_LARGE = 700.0


def step_of(tolerance: float, largest: float) -> float:
    """Width of a step of log1p(|f| / floor), whose middle is within ``tolerance`` (|f| + floor) of its ends.

    largest : of those logarithms. Numbers that are worked on in single precision are a little off.
    """
    step = 2.0 * float(np.log1p(tolerance))
    numbers = largest / step
    return step * (1.0 - _GUARD - (numbers * 2.0**-22 if numbers < SINGLE else 0.0))


def logarithms(value: FloatArray, floor: FloatArray) -> FloatArray:
    """Signed log1p(|f| / floor) of values (N, C); what is no finite number stays as it is."""
    size = np.abs(value)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        y = np.log1p(size / floor)
        large = ~np.isfinite(y)
        if large.any():
            y = np.where(large, np.log(size) - np.log(floor), y)
    return np.where(np.isfinite(value), np.copysign(y, value), value)


def lift(logarithm: FloatArray, step: float) -> FloatArray:
    """What errors that are uniform over ``step`` add to logarithms y in the mean of the values: |f| + floor
    by a factor sinh(h) / h, with h = step / 2. Below h, where errors change the sign, less, to second
    order in h, down to nothing at 0."""
    h = 0.5 * step
    inner = 1.0 - np.minimum(np.abs(logarithm) / h, 1.0)
    return np.copysign(float(np.log(np.sinh(h) / h)) * (1.0 - inner**3), logarithm)


def values(logarithm: NDArray[np.floating[Any]], unit: float, floor: FloatArray) -> FloatArray:
    """(M, C) what logarithms (C, M), in multiples of ``unit``, are of."""
    from fitter.kernels.logarithms import restored

    found = np.empty(logarithm.shape[::-1])
    restored(np.ascontiguousarray(logarithm), unit, floor, _LARGE, found)
    return found


def error_in_bounds(
    value: FloatArray, decoded: FloatArray, floor: FloatArray, tolerance: float
) -> FloatArray:
    """(N, C) signed (decoded - value) / (tolerance (|value| + floor)): at most 1 where the guarantee holds.

    0 where ``value`` is not finite (those are kept apart, exactly); infinite where only the decoded
    number is not finite. Halves keep the sums from overflowing at the top of the range.
    """
    finite = np.isfinite(value)
    safe = np.where(finite, value, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        error = 0.5 * np.where(finite, decoded, 0.0) - 0.5 * safe
        units = error / (0.5 * np.abs(safe) + 0.5 * floor) / tolerance
    return np.where(np.isnan(units), np.inf, units)
