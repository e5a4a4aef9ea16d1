"""Fill values: numbers that a file holds where nothing was measured. One set of rules for every format.

What no reflectance can be is masked; what a reflectance could be, though it looks like a fill value, is left
alone and told by the quality check, unless the reader is asked to leave it out, too (``fills="floors"``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.metadata import Quantity

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: "mask": what can't have been measured. "floors": repeated zeros and exactly constant lowest values, too.
Fills = Literal["mask", "keep", "floors"]

#: Numbers that programs write for "no data", in the quantity of the file. A larger size is no reflectance.
_NO_DATA = (-1.0, -9.0, -99.0, -999.0, -9999.0, -99999.0, -32768.0, 999.0, 9999.0, 99999.0, 999999.0)
_IMPOSSIBLE = 1e10
_NOTHING = max(x for x in _NO_DATA if x < 0), min(x for x in _NO_DATA if x > 0)
#: Such a number is one if it occurs so often and everything else is so many times smaller.
_FEWEST, _APART = 3, 10.0
#: Zeros of one incidence, and measured samples beside them, from which on a cut is told from chance.
_FEWEST_ZEROS = 5
#: Samples within this angle (radians) of a cut, and the line through them, are no lower than so much of their
#: median.
_BESIDE, _STEADY = float(np.deg2rad(15.0)), 0.25
#: Rounded values fall to zero by themselves: a cut falls from so many of their last digits.
_DIGITS = 10
_INCIDENCE = 1e-4

#: Share of one exactly repeated value that counts, and fewest times that it occurs.
REPEATED, _REPEATED_FEWEST = 0.005, 5
#: How much more often than the next ones a value has to occur: rounding makes many values repeat alike.
_STANDS_OUT = 4
#: A repeated value stands at directions whose cosines spread at least this much, not at one direction's cell.
_SPREAD = 0.05
#: A floor that is masked without being asked for occurs so often.
_FLOOR_FEWEST = 20


@dataclass(frozen=True)
class Found:
    """Samples (n,) that hold fill values, and a sentence for each kind."""

    rows: BoolArray
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Repeated:
    """A value that stands out by how often it occurs: what it is, how often, from which cos theta_o down."""

    kind: Literal["zero", "floor", "ceiling", "constant"]
    value: float
    count: int
    cos_o: float


def find_fills(
    value: FloatArray,
    quantity: Quantity,
    wi: FloatArray,
    wo: FloatArray,
    *,
    stated: BoolArray | None = None,
    floors: bool = False,
) -> Found:
    """Fill values among ``value`` (n, C), given in the file's own ``quantity``, at directions (n, 3).

    stated : (n,) what the format itself marks so. floors : repeated zeros and constant lowest values count.
    Directions below the horizon are left out: they are masked anyway.
    """
    usable = (wi[:, 2] > 0) & (wo[:, 2] >= 0)
    rows = np.zeros(len(value), bool)
    notes: list[str] = []
    if stated is not None:
        rows |= stated & usable
        if rows.any():
            notes.append(_told(rows, "zeros up to the end of their line, as the format writes for no data"))
    usable &= ~rows
    sentinels = _sentinels(value, usable, notes)
    rows |= sentinels
    usable &= ~sentinels
    cut = _beyond_a_cut(value, wi, wo, usable)
    if cut.any():
        notes.append(_told(cut, "exactly 0 from some angle on at their incidence, or all over it"))
    rows |= cut
    usable &= ~cut
    constant = _floors(value, quantity, wo, usable, every=floors)
    if constant.any():
        kind = "a constant lowest value" if floors else "a constant lowest value of f_r cos theta_o"
        notes.append(_told(constant, f"{kind}: a detection limit or a fill value"))
    return Found(rows | constant, tuple(notes))


def no_data(value: FloatArray, option: Fills) -> tuple[BoolArray | None, tuple[str, ...]]:
    """Numbers for "no data" among ``value`` (n, C), and sentences, for grids whose directions stay unmade."""
    notes: list[str] = []
    if option == "keep":
        return None, ()
    rows = _sentinels(value, np.ones(len(value), bool), notes)
    return (rows if rows.any() else None), tuple(notes)


def trailing_zeros(values: FloatArray, axis: int) -> BoolArray:
    """Zeros of ``values`` (..., C) with nothing but zeros after them along ``axis``, in every channel.

    Tables of polar grids about the specular direction are filled so where the grid leaves the measured part.
    """
    zero = np.logical_and.reduce(values == 0, axis=-1, keepdims=True)
    after = np.flip(np.logical_and.accumulate(np.flip(zero, axis), axis), axis)
    return np.asarray(after[..., 0])


def repeated(value: FloatArray, cos_o: FloatArray) -> Repeated | None:
    """The value among finite ones (n,) that stands out by how often it occurs, None where none does.

    cos_o : (n,) of the same samples. Values count as equal when they agree to ten digits.
    """
    rounded = _rounded(value)
    unique, count = np.unique(rounded, return_counts=True)
    order = np.argsort(-count, kind="stable")
    top = int(order[0])
    most = int(count[top])
    beside = int(count[order[2]]) if len(order) > 2 else 1
    if most < max(_REPEATED_FEWEST, REPEATED * len(value)) or most <= _STANDS_OUT * beside:
        return None
    there = cos_o[rounded == unique[top]]
    if float(np.ptp(there)) < _SPREAD:
        return None
    positive = unique[unique > 0]
    kind: Literal["zero", "floor", "ceiling", "constant"] = "constant"
    if most > 0.95 * len(value):
        kind = "constant"
    elif unique[top] == 0:
        kind = "zero"
    elif top == 0 or (len(positive) and unique[top] == positive[0]):
        kind = "floor"
    elif top == len(unique) - 1:
        kind = "ceiling"
    return Repeated(kind, float(unique[top]), most, float(there.max()))


def _sentinels(value: FloatArray, usable: BoolArray, notes: list[str]) -> BoolArray:
    """Samples with a number for "no data" in some channel; a sentence for each number goes to ``notes``."""
    rows = np.zeros(len(value), bool)
    told: dict[float, BoolArray] = {}
    for column in value.T:
        # What lies between them needs no closer look.
        if _NOTHING[0] < column.min() and column.max() < _NOTHING[1]:
            continue
        left = usable & np.isfinite(column)
        for sign in (-1.0, 1.0):
            # Damaged bytes may be a NaN that signals when it is multiplied.
            with np.errstate(invalid="ignore"):
                signed = sign * column
            # One file may have several: -999 for one reason, -9999 for another.
            while (number := _outermost(signed, left, sign)) is not None:
                here = left & (column == number)
                told[number] = told.get(number, np.zeros(len(value), bool)) | here
                rows |= here
                left &= ~here
    notes += [_told(which, f"the number {number:g}, written for no data") for number, which in told.items()]
    return rows


def _outermost(column: FloatArray, left: BoolArray, sign: float) -> float | None:
    """The largest of ``column`` (n,), times ``sign``, if it is a number for "no data" and not a measured one.

    A negative number is held against other negative ones: no reflectance is any of them.
    """
    there = column[left]
    if not len(there):
        return None
    largest = float(there.max())
    if largest < _IMPOSSIBLE and sign * largest not in _NO_DATA:
        return None
    rest = there[there < largest]
    # A table of nothing else has no measure of what is large.
    if len(there) - len(rest) < _FEWEST or not len(rest) or largest < _APART * float(rest.max()):
        return None
    return sign * largest


def _beyond_a_cut(value: FloatArray, wi: FloatArray, wo: FloatArray, usable: BoolArray) -> BoolArray:
    """Zeros in every channel from some theta_o on at their incidence, or at every direction of it.

    What is measured falls to nothing gradually; a step from well above the last digit to exactly 0 at all
    azimuths is the end of what was measured.
    """
    rows = np.zeros(len(value), bool)
    zero = usable & np.logical_and.reduce(value == 0, axis=1)
    if np.count_nonzero(zero) < _FEWEST_ZEROS:
        return rows
    level = np.where(usable, value.mean(axis=1), np.nan)
    digit = _last_digit(value[usable & ~zero])
    for group in _incidences(wi, usable):
        zeros, others = group[zero[group]], group[~zero[group]]
        if len(zeros) < _FEWEST_ZEROS:
            continue
        if not len(others):
            rows[zeros] = bool((usable & ~zero).any())
        elif len(others) >= _FEWEST_ZEROS and _is_cut(wo, level, zeros, others, digit):
            rows[zeros] = True
    return rows


def _is_cut(
    wo: FloatArray, level: FloatArray, zeros: NDArray[np.intp], others: NDArray[np.intp], digit: float
) -> bool:
    theta, _ = directions.spherical_from_vector(wo[others])
    last = float(theta.max())
    first, _ = directions.spherical_from_vector(wo[zeros])
    if float(first.min()) <= last + 1e-9:
        return False
    near = theta > last - _BESIDE
    beside, at = level[others[near]], theta[near]
    if not np.isfinite(beside).all():
        return False
    lowest, typical = float(beside.min()), float(np.median(beside))
    # Where their line leads to by the first zero: what fades away gets there by itself.
    slope = float(np.polyfit(at, beside, 1)[0]) if np.ptp(at) > 1e-3 else 0.0
    expected = float(beside.mean()) + slope * (float(first.min()) - float(at.mean()))
    return min(lowest, expected) >= max(_STEADY * typical, _DIGITS * digit) and lowest > 0


def _last_digit(value: FloatArray) -> float:
    """The decimal step that all values are rounded to, 0 where they have more than nine decimals."""
    finite = value[np.isfinite(value)]
    finite = finite[:: max(len(finite) // 4096, 1)]
    for decimals in range(10):
        scaled = finite * 10.0**decimals
        if np.allclose(scaled, np.round(scaled), rtol=1e-12, atol=1e-6):
            return 10.0**-decimals
    return 0.0


def _incidences(wi: FloatArray, usable: BoolArray) -> Sequence[NDArray[np.intp]]:
    """The usable samples of each incidence."""
    rows = np.flatnonzero(usable)
    key = np.round(wi[rows] / _INCIDENCE).astype(np.int64)
    _, label = np.unique(key, axis=0, return_inverse=True)
    order = np.argsort(label.reshape(-1), kind="stable")
    count = np.bincount(label.reshape(-1))
    return np.split(rows[order], np.cumsum(count)[:-1])


def _floors(
    value: FloatArray, quantity: Quantity, wo: FloatArray, usable: BoolArray, *, every: bool
) -> BoolArray:
    """Samples at a repeated lowest value: f_r of a diffuse surface is constant; f_r cos theta_o never."""
    rows = np.zeros(len(value), bool)
    if not every and quantity != "ccbrdf":
        return rows
    for column in value.T:
        here = usable & np.isfinite(column)
        found = repeated(column[here], wo[here, 2]) if here.any() else None
        if found is None or found.kind not in (("zero", "floor") if every else ("floor",)):
            continue
        clear = found.count >= _FLOOR_FEWEST and found.value >= _DIGITS * _last_digit(column[here])
        if every or clear:
            rows |= here & (_rounded(column) == found.value)
    return rows


def _rounded(value: FloatArray) -> FloatArray:
    """To ten significant digits: a cosine may have been divided out and multiplied in again."""
    with np.errstate(invalid="ignore", over="ignore", under="ignore"):
        size = np.where((value != 0) & np.isfinite(value), np.abs(value), 1.0)
        exponent = np.floor(np.log10(size))
        # Two factors: one alone would overflow for the smallest numbers that float64 holds.
        half = np.trunc(exponent / 2)
        scaled = value * 10.0 ** (-half) * 10.0 ** (half - exponent)
        return np.round(scaled, 9) * 10.0**half * 10.0 ** (exponent - half)


def _told(rows: BoolArray, what: str) -> str:
    count = int(np.count_nonzero(rows))
    return f"{count:,} samples hold {what}: fill values, masked."
