"""What interpolation does to the energy of a grid in incoming and outgoing angles, and what is done about it.

The integral of a bilinear interpolant is a sum over the nodes, and such sums of smooth functions are exact
far beyond the order of the interpolation: until the lobe is so narrow that the sum depends on where the
nodes happen to lie on it. That is seen from the table itself: the sums over every second node, along one
axis, then differ. If the lobe's spectrum falls exponentially, a sum at some spacing exceeds the integral by
at most the factor (1 + q)/(1 - q) (Poisson's summation formula), with q squared whenever the spacing is
halved. The larger of the two sums over every second node exceeds the one over all by 1 + a = (1 + q)^2/(1 +
q^2), which gives q = (1 - sqrt(1 - a^2))/a, and the excess at the grid's own spacing, which nothing could be
compared with, is 2 q^2/(1 - q^2).

That is an upper estimate: lobes with long tails have 0.6 to 0.8 of it, Gaussian ones 0.1 to 0.3, and the
nodes of a lobe that narrow don't tell which it is. Half of it is taken out: where that is worth it the node
values' k-th roots are interpolated, and their power taken. The larger k, the narrower the flanks between
nodes; k is chosen so that the integral is the sum less that excess.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter.sampling.arcs import moments
from fitter.sampling.axes import Axis

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: Of the upper estimate, what is taken for the excess; and the most that is.
_SHARE, _MOST = 0.5, 0.7
#: An excess below this share is left alone.
WORTH = 0.02
_ROOTS = (1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0)
# Axes with fewer nodes can't be thinned out.
_FEWEST = 6
_POINTS = 3


@dataclass(frozen=True)
class GridEnergy:
    """One incidence. excess : estimated relative gain of energy by bilinear interpolation.

    root : what is interpolated is the root-th root; 1 is bilinear. left : what the energy is known to: the
    excess, which is no better known than to its own size, or by how much the best root misses it.
    """

    excess: float
    root: float
    left: float


def grid_energy(theta: Axis, phi: Axis, value: FloatArray, mask: BoolArray) -> GridEnergy:
    """Of the values (n, C) and mask (n,) of one incidence, in storage order; channels are averaged."""
    shape = len(theta.nodes), len(phi.nodes)
    usable = mask.reshape(shape)
    weight = np.outer(_weights(theta, polar=True), _weights(phi, polar=False))
    mean = np.where(usable, np.maximum(value, 0.0).mean(axis=1).reshape(shape), 0.0)
    return _of_slice(theta, phi, mean, np.where(usable, weight, 0.0))


def _of_slice(theta: Axis, phi: Axis, value: FloatArray, weight: FloatArray) -> GridEnergy:
    total = float((value * weight).sum())
    if not np.isfinite(total) or total <= 0:
        return GridEnergy(0.0, 1.0, 0.0)
    excess = _excess(value, weight)
    if excess < WORTH:
        return GridEnergy(excess, 1.0, excess)
    wanted = total / (1 + excess)
    # The larger the root, the less energy: halve the list of roots until two neighbours enclose it.
    energies = {_ROOTS[0]: total}
    low, high = 0, len(_ROOTS)
    integral = _PowerIntegral(theta, phi, value, weight > 0)
    while high - low > 1:
        middle = (low + high) // 2
        energies[_ROOTS[middle]] = integral(_ROOTS[middle])
        low, high = (middle, high) if energies[_ROOTS[middle]] > wanted else (low, middle)
    root = min(energies, key=lambda k: abs(energies[k] - wanted))
    reached = energies[root]
    return GridEnergy(excess, root, max(abs(reached / wanted - 1), excess))


def _excess(value: FloatArray, weight: FloatArray) -> float:
    """Estimated relative excess of the sum over all nodes."""
    kept = 1.0
    for axis in (0, 1):
        across, of = (value * weight).sum(axis=axis), weight.sum(axis=axis)
        if len(of) < _FEWEST:
            continue
        parts = [across[k::2].sum() / of[k::2].sum() for k in (0, 1) if of[k::2].sum() > 0]
        a = min(max(parts) / (across.sum() / of.sum()) - 1, 0.999)
        if a > 1e-6:
            q = (1 - np.sqrt(1 - a * a)) / a
            kept *= 1 + _SHARE * 2 * q * q / (1 - q * q)
    return float(min(kept - 1, _MOST))


def _weights(axis: Axis, *, polar: bool) -> FloatArray:
    """(n,) integral of each node's hat function, times sin cos for polar angles."""
    low, high = (0.0, np.pi / 2) if polar else (-np.pi, np.pi)
    edges = axis.breakpoints(low, high)
    middle, width = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    place = axis.locate(middle if polar else _wrapped(axis, middle))
    spacing = axis.nodes[place.high] - axis.nodes[place.low]
    if axis.period is not None:
        spacing = np.mod(spacing, axis.period)
    half = np.where(spacing > 0, 0.5 * width / np.where(spacing > 0, spacing, 1.0), 0.0)
    first, second = moments(edges[:-1], width) if polar else (0.5 * width, 0.5 * width)
    first, second = np.where(place.measured, first, 0.0), np.where(place.measured, second, 0.0)
    start, end = place.fraction - half, place.fraction + half
    found = np.zeros(len(axis.nodes))
    np.add.at(found, place.low, first * (1 - start) + second * (1 - end))
    np.add.at(found, place.high, first * start + second * end)
    return found


def _wrapped(axis: Axis, phi: FloatArray) -> FloatArray:
    start = axis.nodes[0]
    return start + np.mod(phi - start, axis.period or 2 * np.pi)


class _PowerIntegral:
    """Integral of the power of interpolated roots, times sin cos, for any root."""

    def __init__(self, theta: Axis, phi: Axis, value: FloatArray, whole: BoolArray) -> None:
        x, points = np.polynomial.legendre.leggauss(_POINTS)
        self._value = np.maximum(value, 0.0)
        self._rows, self._row_weight = _lines(theta, x, points, polar=True)
        self._columns, self._column_weight = _lines(phi, x, points, polar=False)
        near = [(lines > 0).astype(np.float64) for lines in (self._rows, self._columns)]
        self._inside = near[0] @ (~whole).astype(np.float64) @ near[1].T == 0

    def __call__(self, root: float) -> float:
        found = self._rows @ self._value ** (1 / root) @ self._columns.T
        return float(self._row_weight @ (found**root * self._inside) @ self._column_weight)


def _lines(axis: Axis, x: FloatArray, points: FloatArray, *, polar: bool) -> tuple[FloatArray, FloatArray]:
    """``(matrix (M, n), weight (M,))``: the interpolation at all quadrature points, and their weights."""
    edges = axis.breakpoints(*((0.0, np.pi / 2) if polar else (-np.pi, np.pi)))
    half = 0.5 * np.diff(edges)
    at = (0.5 * (edges[1:] + edges[:-1])[:, None] + half[:, None] * x).reshape(-1)
    weight = (half[:, None] * points).reshape(-1)
    place = axis.locate(at if polar else _wrapped(axis, at))
    matrix = np.zeros((len(at), len(axis.nodes)))
    k = np.arange(len(at))
    np.add.at(matrix, (k, place.low), 1 - place.fraction)
    np.add.at(matrix, (k, place.high), place.fraction)
    weight = np.where(place.measured, weight, 0.0)
    return matrix, weight * (0.5 * np.sin(2 * at)) if polar else weight
