"""One axis of a product grid: between which nodes a coordinate lies, and whether that was measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitter.grid import Grid

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]

#: A coordinate this close (radians) to a measured one is that one: instruments repeat to about 1e-4.
SAME_ANGLE = 1e-4
# What counts as inside an axis, radians.
_SLACK = 1e-7
# An axis that ends within this many spacings of a natural end (the normal, the horizon, the plane of
# incidence) holds cell centres: its last value stands up to that end.
_TO_THE_END = 0.75
_NATURAL_END: Mapping[str, float] = {
    "theta_h": np.pi / 2, "theta_d": np.pi / 2, "theta_i": np.pi / 2, "theta_o": np.pi / 2, "dphi": np.pi,
}  # fmt: skip
# Cell edges that differ by rounding only.
_ROUNDING = 1e-12
# Equal buckets of an axis at most; with more, nodes are found by bisection.
_BUCKETS = 1 << 15


class Place(NamedTuple):
    """Between nodes ``low`` and ``high`` at ``fraction`` in [0, 1]; ``measured`` False outside the axis."""

    low: IndexArray
    high: IndexArray
    fraction: FloatArray
    measured: BoolArray


@dataclass(frozen=True)
class Axis:
    """nodes : increasing, radians; period : None for an axis that doesn't close on itself."""

    name: str
    nodes: FloatArray
    period: float | None

    @cached_property
    def extent(self) -> tuple[float, float]:
        """Coordinates over which the axis is defined, up to the natural ends where it reaches them."""
        first, last = float(self.nodes[0]), float(self.nodes[-1])
        if self.period is not None:
            return first, first + self.period
        if len(self.nodes) == 1:
            free = self.name == "phi_d"  # tables without that axis take it as one node
            return (-np.inf, np.inf) if free else (first - SAME_ANGLE, last + SAME_ANGLE)
        natural = _NATURAL_END.get(self.name)
        if natural is not None:
            start, end = self.nodes[1] - first, last - self.nodes[-2]
            if 0 < first <= _TO_THE_END * start:
                first = 0.0
            if 0 < natural - last <= _TO_THE_END * end:
                last = natural
        return first, last

    def fold(self, x: FloatArray) -> FloatArray:
        """Azimuth differences beyond an axis that covers half a turn, mirrored into it."""
        if self.name != "dphi" or self.period is not None:
            return x
        folded = np.abs(np.mod(x + np.pi, 2 * np.pi) - np.pi)
        return np.where((x > self.nodes[-1]) | (x < self.nodes[0]), folded, x)

    def mirrored(self, x: FloatArray) -> BoolArray:
        """(M,) where :meth:`fold` turns the sense of the coordinate round."""
        return (self.fold(x) != x) & (np.mod(x + np.pi, 2 * np.pi) < np.pi)

    @cached_property
    def buckets(self) -> tuple[float, IndexArray, FloatArray] | None:
        """Buckets per radian, the last node at or below each bucket's start, and the nodes followed by an
        end that nothing passes. No bucket holds more than one node inside. None: there would be too many.
        """
        nodes = self.nodes
        span, least = float(nodes[-1] - nodes[0]), float(np.diff(nodes).min())
        if not 0 < span / least * 1.01 < _BUCKETS:
            return None
        count = int(np.ceil(span / least * 1.01))
        start = nodes[0] + np.arange(count + 1) * (span / count)
        # Rounding may put a coordinate into the bucket before: its start is moved down by as much.
        first = np.searchsorted(nodes, start - 1e-3 * least, side="right") - 1
        return count / span, np.maximum(first, 0), np.append(nodes[1:], np.inf)

    def below(self, x: FloatArray) -> IndexArray:
        """(M,) the last node at or below each coordinate, 0 before the first; found without bisection."""
        if self.buckets is None:
            return np.maximum(np.searchsorted(self.nodes, x, side="right") - 1, 0)
        scale, first, following = self.buckets
        at = x - self.nodes[0]
        at *= scale
        bucket = np.clip(at, 0, len(first) - 1, out=at).astype(np.intp)
        index = first.take(bucket)
        index += following.take(index) <= x
        return index

    def locate(self, x: FloatArray) -> Place:
        """Where coordinates (M,), as :meth:`fitter.grid.Grid.locate` returns them, lie."""
        x = self.fold(x)
        low, high = self.extent
        measured = (x >= low - _SLACK) & (x <= high + _SLACK)
        n = len(self.nodes)
        if n == 1:
            zero = np.zeros(x.shape, np.intp)
            return Place(zero, zero, np.zeros(x.shape), measured | (self.period is not None))
        if self.period is not None:
            i = self.below(x)
            following = np.append(self.nodes[1:], self.nodes[0] + self.period)
            low = self.nodes.take(i)
            t = np.clip((x - low) / (following.take(i) - low), 0.0, 1.0)
            return Place(i, np.where(i + 1 < n, i + 1, 0), t, np.ones(x.shape, bool))
        i = np.minimum(self.below(x), n - 2)
        low = self.nodes.take(i)
        t = (x - low) / (self.nodes.take(i + 1) - low)
        # Beyond an end both corners are the end node, so that its neighbour (masked or not) has no say.
        return Place(
            np.where(t >= 1.0, i + 1, i), np.where(t <= 0.0, i, i + 1), np.clip(t, 0.0, 1.0), measured
        )

    def breakpoints(self, low: float, high: float) -> FloatArray:
        """Where the piecewise linear function of this axis may bend or end, in [low, high], ends included.

        Azimuths are taken on every branch (+-2 pi, and mirrored where the axis folds).
        """
        marks = np.concatenate([self.nodes, self.extent])
        marks = marks[np.isfinite(marks)]
        if self.name == "dphi":
            marks = np.concatenate([marks, -marks])
        if not self.name.startswith("theta"):
            marks = np.concatenate([marks - 2 * np.pi, marks, marks + 2 * np.pi])
        marks = np.sort(np.concatenate([marks[(marks > low) & (marks < high)], [low, high]]))
        keep = np.append(np.diff(marks) > _ROUNDING, True)
        keep[0] = True
        return marks[keep]


def axes_of(grid: Grid) -> tuple[Axis, ...]:
    """The axes of a grid in storage order."""
    return tuple(
        Axis(name, np.asarray(nodes, np.float64), grid.periodic.get(name))
        for name, nodes in grid.axes.items()
    )


def packed(axes: Sequence[Axis]) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Axes for kernels: nodes (A, n), after the last one that where the axis begins again; the node at the
    start of each of equal buckets (A, m); and (A, 7) how many nodes and how many buckets, buckets per radian
    (0: none), extent, period (0: none), nodes per radian (0: not evenly spaced)."""
    most = max(len(axis.nodes) for axis in axes) + 1
    buckets = [(0.0, np.zeros(1, np.intp)) if axis.buckets is None else axis.buckets[:2] for axis in axes]
    nodes, about = np.full((len(axes), most), np.inf), np.zeros((len(axes), 7))
    first = np.zeros((len(axes), max(len(some) for _, some in buckets)), np.int64)
    for k, (axis, (scale, some)) in enumerate(zip(axes, buckets, strict=True)):
        n, (low, high) = len(axis.nodes), axis.extent
        nodes[k, :n], first[k, : len(some)] = axis.nodes, some
        if axis.period is not None:
            nodes[k, n] = axis.nodes[0] + axis.period
        about[k] = n, len(some), scale, low - _SLACK, high + _SLACK, axis.period or 0.0, _even(axis)
    return nodes, first, about


def _even(axis: Axis) -> float:
    """Nodes per radian, 0 where they are not evenly spaced but for rounding."""
    end = [] if axis.period is None else [axis.nodes[0] + axis.period]
    step = np.diff(np.append(axis.nodes, end))
    even = len(step) > 0 and float(np.ptp(step)) < _ROUNDING * float(step.mean())
    return 1 / float(step.mean()) if even else 0.0


def fractions_at_ends(axis: Axis, place: Place, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fractions at both ends of intervals of width 2 ``half`` in one cell, of their middles' places."""
    width = axis.nodes[place.high] - axis.nodes[place.low]
    if axis.period is not None:
        width = np.mod(width, axis.period)
    step = np.where(width > 0, half / np.where(width > 0, width, 1.0), 0.0)
    return np.clip(place.fraction - step, 0.0, 1.0), np.clip(place.fraction + step, 0.0, 1.0)


def multilinear(
    places: Sequence[Place], shape: Sequence[int], look_up: Callable[[IndexArray], FloatArray]
) -> FloatArray:
    """Between the corners of the cells that ``places`` (one per axis) lie in, axis by axis from the last.

    look_up : values (M,) or (M, C) at flat indices (M,), which may be overwritten.
    """
    strides = np.cumprod([1, *shape[:0:-1]])[::-1]

    def along(axis: int, start: IndexArray | int) -> FloatArray:
        if axis == len(places):
            return look_up(np.asarray(start))
        place, stride = places[axis], strides[axis]
        low, high = along(axis + 1, start + place.low * stride), along(axis + 1, start + place.high * stride)
        high -= low
        high *= place.fraction if high.ndim == 1 else place.fraction[:, None]
        high += low
        return high

    return along(0, 0)


def corners(places: Sequence[Place], shape: Sequence[int]) -> list[tuple[IndexArray, FloatArray]]:
    """``(flat index, weight)`` of the 2^d corners of the cells that ``places`` (one per axis) lie in."""
    strides = np.cumprod([1, *shape[:0:-1]])[::-1]
    found: list[tuple[IndexArray, FloatArray]] = []
    for sides in product((0, 1), repeat=len(places)):
        index = np.zeros(places[0].low.shape, np.intp)
        weight = np.ones(places[0].low.shape)
        for side, place, stride in zip(sides, places, strides, strict=True):
            index = index + (place.high if side else place.low) * stride
            weight = weight * (place.fraction if side else 1.0 - place.fraction)
        found.append((index, weight))
    return found


class Span:
    """Intervals on an axis. first, last : nodes that enclose each; few : at most one node strictly inside."""

    def __init__(self, axis: Axis, low: FloatArray, high: FloatArray) -> None:
        self._axis = axis
        nodes, n = axis.nodes, len(axis.nodes)
        self.low, self.high = np.clip(low, nodes[0], nodes[-1]), np.clip(high, nodes[0], nodes[-1])
        self.first = np.clip(np.searchsorted(nodes, self.low, side="right") - 1, 0, n - 1)
        self.last = np.clip(np.searchsorted(nodes, self.high, side="left"), 0, n - 1)
        self.few = self.last - self.first <= 2

    def take(self, index: IndexArray) -> Span:
        """Only the intervals ``index``."""
        return Span(self._axis, self.low[index], self.high[index])

    @property
    def nodes(self) -> list[IndexArray]:
        """The (up to three different) nodes around intervals that hold at most one."""
        n = len(self._axis.nodes)
        return [np.minimum(self.first + k, n - 1) for k in range(3)]

    @property
    def fractions(self) -> list[list[FloatArray]]:
        """Weights of the three nodes at both ends and at the node inside (or again at an end)."""
        x = [self._axis.nodes[index] for index in self.nodes]
        found: list[list[FloatArray]] = []
        for point in (self.low, np.clip(x[1], self.low, self.high), self.high):
            left = _ratio(point - x[0], x[1] - x[0])
            right = _ratio(point - x[1], x[2] - x[1])
            found.append([1 - left, left * (1 - right), right])
        return found


def _ratio(step: FloatArray, width: FloatArray) -> FloatArray:
    return np.clip(np.where(width > 0, step / np.where(width > 0, width, 1.0), 0.0), 0.0, 1.0)
