"""One slice of a grid in incoming and outgoing angles as a function of (theta_o, azimuth).

A slice is a sum, over the incidences of the grid that it is blended from and over channels, of
``coefficient * g^k``: g is bilinear between the k-th roots of the node values. k is 1 except where a lobe is
so narrow against the grid that straight lines between its nodes would create energy
(:mod:`fitter.sampling.energy`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.sampling.axes import Axis, Place, corners, fractions_at_ends
from fitter.sampling.envelope import Envelope, Method

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Node:
    """One incidence of the grid: its weight in the slice, values (T P, C) as measured, its root, and what
    its energy is known to."""

    weight: float
    value: FloatArray
    root: float
    energy_error: float = 0.0


@dataclass(frozen=True)
class SphericalSlice:
    """One incidence of a grid in incoming and outgoing angles.

    usable : (T P,). rotation : azimuth to add to the slice's own to come back to the sample's frame.
    """

    outgoing: tuple[Axis, ...]
    nodes: tuple[Node, ...]
    usable: BoolArray
    rotation: float
    extrapolated: bool
    preferred: Method = "rejection"

    def envelope(self, weights: FloatArray, acceptance: float, cells: int, method: Method) -> Envelope:
        from fitter.sampling.bilinear import BilinearEnvelope

        return BilinearEnvelope(SphericalField(self, weights), acceptance, cells, method)


@dataclass(frozen=True)
class _Term:
    coefficient: float
    nodes: FloatArray  # (T P,) roots of the values, NaN where not usable
    power: float


class SphericalField:
    """f+ of a slice, channels weighted; NaN outside the measured domain."""

    def __init__(self, part: SphericalSlice, weights: FloatArray) -> None:
        self.rotation, self.extrapolated = part.rotation, part.extrapolated
        self._theta, self._phi = part.outgoing
        self._shape = (len(self._theta.nodes), len(self._phi.nodes))
        self._hole = np.where(part.usable, 0.0, np.nan)
        self.count, self._weights = len(weights), weights
        self.energy_error = sum(node.weight * node.energy_error for node in part.nodes)
        self.linear = all(node.root == 1 for node in part.nodes)
        used = [node.value[part.usable] for node in part.nodes]
        self.clamps = any(bool((value < 0).any()) for value in used)
        self._channels = [self._terms(part.nodes, c, clamped=True) for c in np.eye(self.count)]
        self._weighted = self._terms(part.nodes, weights, clamped=True)
        self._raw = self._terms(part.nodes, weights, clamped=False) if self.clamps else self._weighted

    def _terms(self, nodes: Sequence[Node], weights: FloatArray, *, clamped: bool) -> list[_Term]:
        if self.linear:
            total = np.zeros(len(self._hole))
            for node in nodes:
                total += node.weight * ((np.maximum(node.value, 0.0) if clamped else node.value) @ weights)
            return [_Term(1.0, total + self._hole, 1.0)]
        found: list[_Term] = []
        for node in nodes:
            for channel in np.flatnonzero(weights):
                value = node.value[:, channel]
                value = np.maximum(value, 0.0) if clamped else value
                found.append(
                    _Term(
                        node.weight * weights[channel], powered(value, 1 / node.root) + self._hole, node.root
                    )
                )
        return found

    def edges(self, tallest: float, widest: float) -> tuple[FloatArray, FloatArray]:
        """Of theta and of azimuth: the sides of the grid's cells within the hemisphere, and what cuts those
        to ``tallest`` and ``widest``."""
        theta, phi = self._theta.breakpoints(0.0, np.pi / 2), self._phi.breakpoints(-np.pi, np.pi)
        return _cut(theta, tallest), _cut(phi, widest)

    def _places(self, theta: FloatArray, phi: FloatArray) -> tuple[Place, Place]:
        return self._theta.locate(theta), self._phi.locate(self._wrapped(phi))

    def _wrapped(self, phi: FloatArray) -> FloatArray:
        start = self._phi.nodes[0]
        return start + np.mod(phi - start, self._phi.period or 2 * np.pi)

    def _rows(self, start: FloatArray, end: FloatArray) -> tuple[Place, tuple[FloatArray, FloatArray]]:
        """Of intervals of theta inside one cell of the grid: their places, and fractions at both ends."""
        place = self._theta.locate(0.5 * (start + end))
        return place, fractions_at_ends(self._theta, place, 0.5 * (end - start))

    def _columns(self, start: FloatArray, end: FloatArray) -> tuple[Place, tuple[FloatArray, FloatArray]]:
        """The same of intervals of azimuth."""
        # The interval's own side of each node, which rounding at its ends would not tell.
        middle = self._wrapped(0.5 * (start + end))
        place = self._phi.locate(middle)
        low, high = fractions_at_ends(self._phi, place, 0.5 * (end - start))
        back = self._phi.mirrored(middle)
        return place, (np.where(back, high, low), np.where(back, low, high))

    def _ends(
        self, rectangles: FloatArray
    ) -> tuple[tuple[Place, Place], list[tuple[FloatArray, FloatArray]]]:
        """Of cells inside one cell of the grid: its places, and fractions at both ends, of theta and of
        azimuth."""
        theta0, theta1, phi0, phi1 = rectangles.T
        theta, phi = self._rows(theta0, theta1), self._columns(phi0, phi1)
        return (theta[0], phi[0]), [theta[1], phi[1]]

    def powers(self, rectangles: FloatArray) -> tuple[NDArray[Any], ...]:
        """What kernels need to know of cells where the field is not bilinear, see
        :func:`fitter.kernels.bilinear.fill`."""
        if self.linear:
            nothing = np.zeros((0, 4))
            return nothing.astype(np.int64), nothing, nothing, np.zeros(0), np.zeros(0), np.ones(1)
        places, ends = self._ends(rectangles)
        where = np.stack([index for index, _ in corners(places, self._shape)], axis=1)
        terms = [term for terms in self._channels for term in terms]
        return (
            where.astype(np.int64), np.stack([end for pair in ends for end in pair], axis=1),
            np.stack([term.nodes for term in terms]), np.array([term.power for term in terms]),
            np.array([term.coefficient for term in terms]), self._weights,
        )  # fmt: skip

    def _at_corners(self, rectangles: FloatArray, terms: Sequence[Sequence[_Term]]) -> FloatArray:
        """(len(terms), 4, K) values at (low, low), (low, high), (high, low), (high, high) of theta, phi."""
        places, ends = self._ends(rectangles)
        found = np.empty((len(terms), 4, len(rectangles)))
        for corner in range(4):
            s, t = ends[0][corner // 2], ends[1][corner % 2]
            at = (places[0]._replace(fraction=s), places[1]._replace(fraction=t))
            for k, some in enumerate(terms):
                found[k, corner] = self._blend(at, some)
        return found

    def corners_of_grid(self, theta: FloatArray, phi: FloatArray) -> FloatArray:
        """(4, R S) as :meth:`corners`, of all cells between the R + 1 and S + 1 :meth:`edges`."""
        row, down = self._rows(theta[:-1], theta[1:])
        column, across = self._columns(phi[:-1], phi[1:])
        found = np.zeros((2, 2, len(row.low), len(column.low)))
        for term in self._weighted:
            nodes = term.nodes.reshape(self._shape)
            for s, one in zip(down, found, strict=True):
                side = nodes[row.low]
                side += s[:, None] * (nodes[row.high] - side)
                for t, corner in zip(across, one, strict=True):
                    low = side.take(column.low, axis=1)
                    low += t * (side.take(column.high, axis=1) - low)
                    corner += term.coefficient * powered(low, term.power)
        found[:, :, ~row.measured] = np.nan
        found[:, :, :, ~column.measured] = np.nan
        return found.reshape(4, -1)

    def corners(self, rectangles: FloatArray, *, clamped: bool = True) -> FloatArray:
        """(K, 4) weighted values at corners of cells inside one cell of the grid; NaN where unmeasured."""
        return self._at_corners(rectangles, [self._weighted if clamped else self._raw])[0].T

    def corners_of_channels(self, rectangles: FloatArray) -> FloatArray:
        """(C, 4, K), as :meth:`corners` for every channel."""
        return self._at_corners(rectangles, self._channels)

    def _blend(self, places: tuple[Place, Place], terms: Sequence[_Term]) -> FloatArray:
        around = corners(places, self._shape)
        total = np.zeros(len(places[0].low))
        for term in terms:
            root = np.zeros(len(total))
            for index, weight in around:
                root += weight * term.nodes.take(index)
            total += term.coefficient * powered(root, term.power)
        total[~(places[0].measured & places[1].measured)] = np.nan
        return total

    def density(self, theta: FloatArray, phi: FloatArray, *, clamped: bool = True) -> FloatArray:
        """(M,) weighted value."""
        return self._blend(self._places(theta, phi), self._weighted if clamped else self._raw)

    def values(self, theta: FloatArray, phi: FloatArray) -> FloatArray:
        """(M, C) f+ of every channel."""
        places = self._places(theta, phi)
        return np.stack([self._blend(places, terms) for terms in self._channels], axis=1)


def _cut(edges: FloatArray, longest: float) -> FloatArray:
    """``edges``, and between those further apart than ``longest`` others."""
    pieces = np.ceil(np.diff(edges) / longest).astype(int)
    if (pieces == 1).all():
        return edges
    fine = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(edges, edges[1:], pieces, strict=False)]
    return np.append(np.concatenate(fine), edges[-1])


def powered(x: FloatArray, power: float | FloatArray) -> FloatArray:
    """x^power, with the sign of x."""
    if np.ndim(power) == 0 and power == 1:
        return x
    return np.sign(x) * np.abs(x) ** power
