"""The error-bounded quantiser: values -> small integers on a signed logarithmic scale, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Below this tolerance the logarithm's own rounding would eat the bound: such tables are stored lossless.
SMALLEST_TOLERANCE = 1e-9
# The step is this much smaller than the bound allows, so that rounding alone violates it next to never
# (what still does is found on writing and stored as an exception).
_GUARD = 1.0 - 1e-6
# expm1 overflows above 709.78; from here on exp(y + log floor) is the same number to 1 part in 1e300.
_LARGE = 700.0


def step_of(tolerance: float) -> float:
    """Width of a bin of log1p(|f| / floor): its centre is within ``tolerance`` (|f| + floor) of its edges."""
    return 2.0 * float(np.log1p(tolerance)) * _GUARD


def quantise(value: FloatArray, floor: float, tolerance: float) -> IntArray:
    """(N,) bin numbers of finite values (N,); numbers that are not finite get bin 0."""
    finite = np.isfinite(value)
    size = np.abs(np.where(finite, value, 0.0))
    with np.errstate(over="ignore", divide="ignore"):
        ratio = size / floor
        y = np.where(np.isfinite(ratio), np.log1p(ratio), np.log(size) - np.log(floor))
    bins = np.rint(y / step_of(tolerance)).astype(np.int64)
    return np.where(np.signbit(value), -bins, bins)


def dequantise(bins: IntArray, floor: float, tolerance: float) -> FloatArray:
    """(N,) the values at the centres of the bins."""
    y = np.abs(bins) * step_of(tolerance)
    with np.errstate(over="ignore"):
        size = np.where(y < _LARGE, floor * np.expm1(np.minimum(y, _LARGE)), np.exp(y + np.log(floor)))
    return np.where(bins < 0, -size, size)


def error_in_bounds(value: FloatArray, decoded: FloatArray, floor: float, tolerance: float) -> FloatArray:
    """(N,) |decoded - value| / (tolerance (|value| + floor)): at most 1 where the guarantee holds.

    0 where ``value`` is not finite (those are kept apart, exactly); infinite where only the decoded
    number is not finite. Halves keep the sums from overflowing at the top of the range.
    """
    finite = np.isfinite(value)
    safe = np.where(finite, value, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(0.5 * np.where(finite, decoded, 0.0) - 0.5 * safe)
        units = error / (0.5 * np.abs(safe) + 0.5 * floor) / tolerance
    return np.where(np.isnan(units), np.inf, units)


def narrowest(numbers: IntArray) -> NDArray[np.signedinteger]:
    """The same numbers in the narrowest signed integer type that holds them all."""
    low, high = (int(numbers.min()), int(numbers.max())) if numbers.size else (0, 0)
    for kind in (np.int8, np.int16, np.int32):
        if np.iinfo(kind).min <= low and high <= np.iinfo(kind).max:
            return numbers.astype(kind)
    return numbers


#: Values per block of the local mean.
MEAN_LENGTH = 16


def local_means(bins: IntArray, shape: tuple[int, ...], axis: int) -> IntArray:
    """Rounded means of bins (N,) over runs of ``MEAN_LENGTH`` along ``axis``, flat.

    A mean predicts noisy values better than a neighbour does: it adds 1/16 of their variance, not all of it.
    """
    cube = bins.reshape(shape)
    starts = np.arange(0, shape[axis], MEAN_LENGTH)
    lengths = np.diff(np.append(starts, shape[axis]))
    counts = lengths.reshape([-1 if k == axis else 1 for k in range(len(shape))])
    return np.rint(np.add.reduceat(cube, starts, axis=axis) / counts).astype(np.int64).reshape(-1)


def spread(means: IntArray, shape: tuple[int, ...], axis: int) -> IntArray:
    """(N,) the local means, each repeated over its run."""
    runs = [(-(-n // MEAN_LENGTH) if k == axis else n) for k, n in enumerate(shape)]
    repeated = np.repeat(means.reshape(runs), MEAN_LENGTH, axis=axis)
    return np.take(repeated, np.arange(shape[axis]), axis=axis).reshape(-1)


def differences(bins: IntArray, shape: tuple[int, ...], axis: int) -> IntArray:
    """Bins (N,) minus their predecessor along ``axis`` of the table's ``shape``; the first stays."""
    return np.diff(bins.reshape(shape), axis=axis, prepend=0).reshape(-1)


def sums(residual: IntArray, shape: tuple[int, ...], axis: int) -> IntArray:
    """Inverse of :func:`differences`."""
    return np.cumsum(residual.reshape(shape), axis=axis, dtype=np.int64).reshape(-1)
