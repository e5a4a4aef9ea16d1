"""The best single cosine lobe beside given columns, by branch and bound over everything that it can be.

A lobe of Lafortune's model, c_i = b_i^n with b_i = z_i cos gamma - s_i sin gamma (z = zi zo, s = xi xo +
yi yo), lives on the samples of the largest b. For large n these are few, and other ones for every gamma: the
objective over (gamma, n) has as many narrow basins as there are samples on the convex hull of (z, s), some of
them 1e-5 rad wide. No number of random starts finds the best of them.

Cells of (gamma, ln n) are halved until the column hardly turns within one. In polar coordinates (z, s) =
r (cos phi, sin phi) a sample is b = r cos(gamma + phi), whose range over a cell is known exactly, so that the
samples that can matter in a cell are found once and only looked through again by its halves. By
Cauchy-Schwarz a lobe can't explain more than the positive residuals of the samples that it lives on: cells
that so can't beat the best lobe known are dropped, which is nearly all narrow ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
#: How far, as a logarithm, a weighted sample may be below the largest of its column and still count.
REACH = 16.0
#: Samples no further below than this are the core of a lobe; the others count with their largest share.
CORE = 4.0
#: A cell is done when the column turns by no more than this, in rad, from its centre.
STEP = 0.4
#: Columns whose largest entry has a smaller logarithm can't be held: squares of their sums vanish.
LEAST = -330.0
#: Cells by side that the scan begins with, and (cell, sample) pairs looked through at a time.
WIDE, HIGH, AT_ONCE = 16, 7, 500_000
#: Cells of half a width in gamma below this over n, or over 1, are not split further: the edge of a lobe with
#: n < 1 moves over samples in steps.
SMALLEST = 2e-3
#: Pairs that one scan looks through at most: some seconds.
MOST = 10_000_000
STEEPEST = 0.5 * math.pi - 1e-9
#: The logarithm of 0.
NOTHING = -1e5


class Polar(NamedTuple):
    """Samples as a lobe sees them: ln r, phi and the logarithm of the weight, (n,) each."""

    log_r: FloatArray
    phi: FloatArray
    log_w: FloatArray

    @staticmethod
    def of(z: FloatArray, s: FloatArray, weight: FloatArray) -> Polar:
        """``weight`` > 0. The samples of wi, wo with z = zi zo and s = xi xo + yi yo."""
        return Polar(np.log(np.maximum(np.hypot(z, s), 1e-300)), np.arctan2(s, z), np.log(weight))

    def angle(self, gamma: FloatArray, index: IntArray) -> FloatArray:
        """gamma + phi of the samples ``index``, within half a turn."""
        found = gamma + self.phi[index]
        return found - 2 * math.pi * np.round(found / (2 * math.pi))


class Leaves(NamedTuple):
    """Done cells: (gamma, ln n) at their centres and half their widths (m, 2), and by how much the best lobe
    there lowers the objective (m,)."""

    centre: FloatArray
    half: FloatArray
    gain: FloatArray

    def best(self, count: int, least: float) -> FloatArray:
        """The centres (S, 2) of the best cells of which no two are near each other and all gain ``least``."""
        chosen: list[int] = []
        for k in np.argsort(-self.gain, kind="stable")[: 100 * count]:
            if len(chosen) == count or self.gain[k] <= max(least, 0.0):
                break
            apart = np.abs(self.centre[chosen] - self.centre[k]) > 1.2 * (self.half[chosen] + self.half[k])
            if apart.any(axis=1).all():
                chosen.append(int(k))
        return self.centre[chosen]


@dataclass(frozen=True)
class Beside:
    """What a lobe is sought beside: the residual (n,) of the weighted target from the best non-negative
    combination of given weighted columns; those in it as coefficients (K,) and an orthonormal basis (K, n),
    of which ``unmix`` (K, K) makes coefficients."""

    residual: FloatArray
    coefficients: FloatArray
    basis: FloatArray
    unmix: FloatArray

    @staticmethod
    def of(columns: FloatArray, coefficients: FloatArray, residual: FloatArray) -> Beside:
        """``columns`` (K, n), and the best coefficients (K,) >= 0 of them."""
        used = coefficients > 0
        q, r = np.linalg.qr(columns[used].T)
        return Beside(residual, coefficients[used], q.T, np.linalg.inv(r))


@dataclass
class _Cells:
    """Cells: centre and half widths (m,), how many samples each has (m,), and which (pairs,)."""

    gamma: FloatArray
    log_n: FloatArray
    half_gamma: FloatArray
    half_log_n: FloatArray
    count: IntArray
    index: IntArray

    def __len__(self) -> int:
        return len(self.gamma)

    @property
    def start(self) -> IntArray:
        return np.concatenate([np.zeros(1, np.intp), np.cumsum(self.count)[:-1]])

    @property
    def cell(self) -> IntArray:
        """(pairs,) the cell of each."""
        return np.repeat(np.arange(len(self)), self.count)

    def picked(self, cells: NDArray[np.bool_], pairs: NDArray[np.bool_]) -> _Cells:
        """The cells (m,) with those of their samples (pairs,) that are True."""
        pairs = pairs & cells[self.cell]
        count = np.bincount(self.cell[pairs], minlength=len(self))
        return _Cells(
            self.gamma[cells], self.log_n[cells], self.half_gamma[cells], self.half_log_n[cells],
            count[cells], self.index[pairs],
        )  # fmt: skip

    def joined(self, other: _Cells) -> _Cells:
        return _Cells(
            *(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self))
        )

    def split(self) -> Iterator[_Cells]:
        """Two parts of about as many pairs each."""
        ends = np.cumsum(self.count)
        middle = int(np.clip(np.searchsorted(ends, ends[-1] // 2), 1, len(self) - 1))
        at = int(ends[middle - 1])
        for cells, pairs in ((slice(middle, None), slice(at, None)), (slice(middle), slice(at))):
            yield _Cells(
                self.gamma[cells], self.log_n[cells], self.half_gamma[cells], self.half_log_n[cells],
                self.count[cells], self.index[pairs],
            )  # fmt: skip


def scan(
    polar: Polar, beside: Beside, box: tuple[FloatArray, FloatArray], known: float = 0.0,
    step: float = STEP,
) -> Leaves:  # fmt: skip
    """The cells in which a lobe may lower the objective by more than ``known``.

    box : (lower, upper) of (gamma, ln n). The gain at a cell's centre is less than the largest within it by
    up to sin(step)^2 of itself.
    """
    found = [Leaves(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))]
    best, looked = known, 0
    share = np.square(beside.basis).sum(axis=0)
    stack = _first(len(polar.phi), box)
    while stack:
        cells = stack.pop()
        if len(cells.index) > AT_ONCE and len(cells) > 1:
            stack += cells.split()
            continue
        while stack and len(cells.index) + len(stack[-1].index) < AT_ONCE:
            cells = cells.joined(stack.pop())
        looked += len(cells.index)
        if looked > MOST:
            break
        cells, ranges = _ranges(polar, cells)
        if not len(cells):
            continue
        alive = _bound(cells, ranges, beside.residual, share) > best
        pairs = alive[cells.cell]
        cells, ranges = cells.picked(alive, pairs), ranges.picked(pairs)
        if not len(cells):
            continue
        by_gamma, by_n = _turns(cells, ranges)
        small = cells.half_gamma * np.maximum(np.exp(cells.log_n), 1.0) < SMALLEST
        by_gamma[small] = 0.0
        done = np.maximum(by_gamma, by_n) <= step
        if done.any():
            own = cells.picked(done, np.ones(len(cells.index), bool))
            centre = np.stack([own.gamma, own.log_n], axis=1)
            half = np.stack([own.half_gamma, own.half_log_n], axis=1)
            leaves = Leaves(centre, half, _gain(polar, own, beside))
            best = max(best, float(leaves.gain.max()))
            found.append(leaves)
        if not done.all():
            rest = cells.picked(~done, np.ones(len(cells.index), bool))
            stack += _halves(rest, (by_gamma >= by_n)[~done])
    return Leaves(*(np.concatenate(part) for part in zip(*found, strict=True)))


def _first(samples: int, box: tuple[FloatArray, FloatArray]) -> list[_Cells]:
    """The whole box, broad lobes last: popped first, they explain what prunes the narrow ones."""
    (low_g, low_n), (high_g, high_n) = box
    half_g, half_n = 0.5 * (high_g - low_g) / WIDE, 0.5 * (high_n - low_n) / HIGH
    gamma = low_g + half_g * (2 * np.arange(WIDE) + 1)
    return [
        _Cells(
            gamma, np.full(WIDE, low_n + half_n * (2 * row + 1)), np.full(WIDE, half_g),
            np.full(WIDE, half_n), np.full(WIDE, samples), np.tile(np.arange(samples), WIDE),
        )
        for row in reversed(range(HIGH))
    ]  # fmt: skip


def _halves(cells: _Cells, by_gamma: NDArray[np.bool_]) -> list[_Cells]:
    half_g = np.where(by_gamma, 0.5 * cells.half_gamma, cells.half_gamma)
    half_n = np.where(by_gamma, cells.half_log_n, 0.5 * cells.half_log_n)
    return [
        _Cells(
            np.where(by_gamma, cells.gamma + sign * half_g, cells.gamma),
            np.where(by_gamma, cells.log_n, cells.log_n + sign * half_n),
            half_g, half_n, cells.count, cells.index,
        )
        for sign in (1.0, -1.0)
    ]  # fmt: skip


class _Ranges(NamedTuple):
    """Of each (cell, sample) pair: the logarithm of its entry of the column, over that of the sample that is
    largest at the cell's centre, at least and at most in the cell; gamma + phi and ln b at the centre.
    ``top`` (m,) : the pair of that largest sample of each cell."""

    least: FloatArray
    most: FloatArray
    angle: FloatArray
    log_b: FloatArray
    top: IntArray

    def picked(self, pairs: NDArray[np.bool_]) -> _Ranges:
        """Those of the pairs (pairs,) that are True; a cell has its largest sample or none."""
        top = (np.cumsum(pairs) - 1)[self.top[pairs[self.top]]]
        return _Ranges(self.least[pairs], self.most[pairs], self.angle[pairs], self.log_b[pairs], top)


def _ranges(polar: Polar, cells: _Cells) -> tuple[_Cells, _Ranges]:
    """The cells without the samples that can't matter anywhere in them.

    ln(b_i/b_j) is monotonic in gamma, so that extremes over a cell are at its corners.
    """
    cell, start = cells.cell, cells.start
    angle = polar.angle(cells.gamma[cell], cells.index)
    log_r, log_w = polar.log_r[cells.index], polar.log_w[cells.index]
    half, n = cells.half_gamma[cell], np.exp(cells.log_n)[cell]
    log_b = log_r + _log_cos(angle)
    top = _first_of_largest(log_w + n * log_b, cell, start)
    least, most = np.full(len(cell), np.inf), np.full(len(cell), -np.inf)
    over = log_w - log_w[top][cell]
    highest = np.full(len(cells), -np.inf)
    for side in (-1.0, 1.0):
        here = log_r + _log_cos(angle + side * half)
        highest = np.maximum(highest, np.maximum.reduceat(here, start))
        here = here - here[top][cell]
        for end in (-1.0, 1.0):
            value = over + np.exp(cells.log_n + end * cells.half_log_n)[cell] * here
            np.minimum(least, value, out=least)
            np.maximum(most, value, out=most)
    # The coefficients of a lobe are divided by the largest of them.
    lead = np.maximum(np.abs(np.cos(cells.gamma)), np.abs(np.sin(cells.gamma))) - cells.half_gamma
    highest = highest - np.log(np.maximum(lead, math.sqrt(0.5)) * np.cos(cells.half_gamma))
    heaviest = np.maximum(np.maximum.reduceat(log_w, start), 0.0)
    held = np.exp(cells.log_n - cells.half_log_n) * highest + heaviest > LEAST
    pairs = (most > -REACH) & held[cell]
    return cells.picked(held, pairs), _Ranges(least, most, angle, log_b, top).picked(pairs)


def _log_cos(angle: FloatArray) -> FloatArray:
    """ln cos, of what is not positive that of nothing."""
    cosine = np.cos(angle)
    return np.where(cosine > 1e-9, np.log(np.maximum(cosine, 1e-9)), NOTHING)


def _first_of_largest(value: FloatArray, cell: IntArray, start: IntArray) -> IntArray:
    """(m,) position of the largest value of each cell."""
    largest = np.flatnonzero(value == np.maximum.reduceat(value, start)[cell])
    return largest[np.unique(cell[largest], return_index=True)[1]]


def _bound(cells: _Cells, ranges: _Ranges, residual: FloatArray, share: FloatArray) -> FloatArray:
    """(m,) by how much a lobe of each cell can lower the objective at most: c.r squared over c.c, from the
    ranges of c, and by Cauchy-Schwarz over the positive residuals of its core."""
    start, own = cells.start, residual[cells.index]
    positive, negative = np.maximum(own, 0.0), np.minimum(own, 0.0)
    at_least, at_most = np.exp(np.minimum(ranges.least, 50.0)), np.exp(np.minimum(ranges.most, 50.0))
    along = np.add.reduceat(at_most * positive + at_least * negative, start)
    by_ranges = np.square(np.maximum(along, 0.0)) / np.add.reduceat(np.square(at_least), start)
    core = ranges.most > -CORE
    squares = np.add.reduceat(np.where(core, positive * positive, 0.0), start)
    tail = np.add.reduceat(np.where(core, 0.0, at_most * positive), start)
    given = np.minimum(np.add.reduceat(share[cells.index], start), 0.95)
    return np.minimum(by_ranges, np.square(np.sqrt(squares) + tail)) / (1.0 - given)


def _turns(cells: _Cells, ranges: _Ranges) -> tuple[FloatArray, FloatArray]:
    """(m,) by what angle a column of each cell turns from its centre to its edge in gamma, and in ln n:
    the standard deviation of its logarithmic slopes, each sample counted by the most that it can be."""
    start, cell = cells.start, cells.cell
    p = np.exp(2.0 * np.minimum(ranges.most, 0.0))
    total = np.add.reduceat(p, start)
    n = np.exp(cells.log_n)[cell]
    found: list[FloatArray] = []
    for slope, half in (
        (n * np.tan(np.clip(ranges.angle, -STEEPEST, STEEPEST)), cells.half_gamma),
        (n * np.maximum(ranges.log_b, -20.0), cells.half_log_n),
    ):
        # At the edge of a lobe slopes have no bound, and yet a sample can't do more than come or go.
        moved = np.clip((slope - slope[ranges.top][cell]) * half[cell], -1.0, 1.0)
        mean = (np.add.reduceat(p * moved, start) / total)[cell]
        found.append(np.sqrt(np.add.reduceat(p * np.square(moved - mean), start) / total))
    return found[0], found[1]


def _gain(polar: Polar, cells: _Cells, beside: Beside) -> FloatArray:
    """(m,) by how much the best lobe at each centre lowers the objective, the given columns adjusted."""
    start, cell = cells.start, cells.cell
    angle = polar.angle(cells.gamma[cell], cells.index)
    cosine = np.cos(angle)
    some = cosine > 1e-9
    log_b = np.log(np.where(some, cosine, 1.0)) + polar.log_r[cells.index]
    log_c = np.where(some, np.exp(cells.log_n)[cell] * log_b + polar.log_w[cells.index], -np.inf)
    top = np.maximum.reduceat(log_c, start)
    column = np.exp(log_c - np.where(np.isfinite(top), top, 0.0)[cell])
    along = np.add.reduceat(column * beside.residual[cells.index], start)
    square = np.add.reduceat(column * column, start)
    inside = np.empty((len(beside.basis), len(cells)))
    for k, one in enumerate(beside.basis):
        inside[k] = np.add.reduceat(column * one[cells.index], start)
    square = np.maximum(square - np.square(inside).sum(axis=0), 1e-9)
    # The given columns give way, but not below 0.
    gives = beside.unmix @ inside
    room = np.where(gives > 0, beside.coefficients[:, None] / np.maximum(gives, 1e-300), np.inf)
    strength = np.minimum(np.maximum(along, 0.0) / square, room.min(axis=0, initial=np.inf))
    lead = np.log(np.maximum(np.abs(np.cos(cells.gamma)), np.abs(np.sin(cells.gamma))))
    held = top - np.exp(cells.log_n) * lead > LEAST
    return np.where(held, strength * (2.0 * along - strength * square), 0.0)
