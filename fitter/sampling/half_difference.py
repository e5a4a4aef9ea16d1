"""The field of a grid in half and difference angles, with the bound on cells in wo."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.parts import in_parts
from fitter.sampling.alias import AliasTable
from fitter.sampling.axes import Place, corners, multilinear
from fitter.sampling.axes import packed as packed_axes
from fitter.sampling.curvature import gain
from fitter.sampling.drawing import Kernel, in_lines
from fitter.sampling.majorants import AT_ONCE, MANY, ROUNDING
from fitter.sampling.maxima import BoxMaximum, WindowMaximum

if TYPE_CHECKING:
    from fitter.sampling.cells import ChartSlice
    from fitter.sampling.grid import GridInterpolant

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

# Added to every reach: the rounding of angles from vectors.
_SLACK = 1e-12


class WeightedTable:
    """What all incidences of one table and channel weighting share.

    weighted : (N,) f+ at the nodes, NaN where masked. windows, boxes : largest node values over ranges of
    phi_d at one (theta_h, theta_d), and over boxes of (theta_h, theta_d) and all phi_d.
    """

    def __init__(self, table: GridInterpolant, weights: FloatArray) -> None:
        self.weights = weights
        self.weighted = np.maximum(table.value, 0.0) @ weights
        # Where a node is masked nothing is ever drawn, so it has no part in a maximum.
        nodes = np.where(table.mask, self.weighted, 0.0).reshape(table.grid.shape)
        self.weighted[~table.mask] = np.nan
        axis = table.axes[2]
        self.windows = WindowMaximum(nodes, axis.nodes, axis.period)
        self.boxes = BoxMaximum(nodes.max(axis=2))


class HalfDifferenceField:
    """Trilinear in (theta_h, theta_d, phi_d), which are not aligned with the cells in wo.

    The chart is (theta_o, azimuth from that of wi), its measure that of the projected disk: cos(theta) dw =
    d(sin^2 theta)/2 dphi, and the field is f+ itself.
    """

    # Square enough to begin with; everything else is refinement.
    _BEGIN = (24, 96)

    def __init__(self, table: GridInterpolant, part: ChartSlice, weights: FloatArray) -> None:
        self._table = table
        self._shared = self._table.weighted(weights)
        self.extrapolated = part.extrapolated
        theta_i, phi_i = directions.spherical_from_vector(part.wi)
        self._rotation = float(phi_i)
        self._wi = directions.vector_from_spherical(theta_i, 0.0)
        self._incidence = float(self._wi[0]), float(self._wi[2])
        self._axes = packed_axes(self._table.axes)
        self.clamps = self._table.has_negatives

    def edges(self) -> tuple[FloatArray, FloatArray]:
        return np.linspace(0, np.pi / 2, self._BEGIN[0] + 1), np.linspace(-np.pi, np.pi, self._BEGIN[1] + 1)

    def _places(self, theta: FloatArray, phi: FloatArray) -> list[Place]:
        return self._around(*directions.spherical_components(theta, phi))

    def _around(self, x: FloatArray, y: FloatArray, z: FloatArray) -> list[Place]:
        """Of components in the frame where wi has azimuth 0."""
        coordinates = self._table.grid.half_difference(*self._wi[:, None], x, y, z)
        return [axis.locate(x) for axis, x in zip(self._table.axes, coordinates, strict=True)]

    def measures(self, cells: FloatArray) -> FloatArray:
        # The difference of squares of sines, written without cancellation.
        theta0, theta1, phi0, phi1 = cells.T
        return 0.5 * np.sin(theta1 - theta0) * np.sin(theta1 + theta0) * (phi1 - phi0)

    def measure(self, a: FloatArray, b: FloatArray) -> FloatArray:
        return 0.5 * np.sin(2 * a)

    def solid_angle(self, a: FloatArray, b: FloatArray) -> FloatArray:
        return 1 / np.maximum(np.cos(a), 1e-300)

    def tall(self, cells: FloatArray) -> NDArray[np.bool_]:
        """The longer side as seen on the sphere."""
        theta0, theta1, phi0, phi1 = cells.T
        return theta1 - theta0 >= np.sin(theta1) * (phi1 - phi0)

    def kernel(self, alias: AliasTable, cells: FloatArray, majorant: FloatArray, integral: float) -> Kernel:
        from fitter.kernels import half_difference

        theta0, theta1, phi0, phi1 = cells.T
        change = np.sin(theta1 - theta0) * np.sin(theta1 + theta0)
        middle = 0.5 * (phi0 + phi1)
        rows = (
            np.sin(theta0) ** 2, np.cos(theta0) ** 2, change, np.cos(middle), np.sin(middle),
            0.5 * (phi1 - phi0), majorant,
        )  # fmt: skip
        return Kernel(
            partial(
                half_difference.fill, *alias.boxes, in_lines(rows, 8),
                *self._axes, self._incidence,
                (float(np.cos(self._rotation)), float(np.sin(self._rotation))), self._shared.weighted,
                self._table.value, integral,
            )
        )  # fmt: skip

    def directions(self, a: FloatArray, b: FloatArray) -> FloatArray:
        return directions.vector_from_spherical(a, b + self._rotation)

    def coordinates(self, wo: FloatArray) -> tuple[FloatArray, FloatArray]:
        theta, phi = directions.spherical_from_vector(wo)
        return theta, phi - self._rotation

    def field(self, a: FloatArray, b: FloatArray, *, clamped: bool = True) -> FloatArray:
        def look_up(index: IndexArray) -> FloatArray:
            if clamped:
                return self._shared.weighted.take(index)
            return np.where(self._table.mask[index], self._table.value[index] @ self._shared.weights, np.nan)

        return self._blend(self._places(a, b), look_up)

    def gain(self, a: FloatArray, b: FloatArray, weight: FloatArray) -> float:
        shape = self._table.grid.shape
        depends = np.zeros(len(self._shared.weighted))
        for index, share in corners(self._places(a, b), shape):
            depends += np.bincount(index, share * weight, len(depends))
        return gain(self._shared.weighted.reshape(shape), self._table.axes, depends.reshape(shape))

    def place(self, a: FloatArray, b: FloatArray) -> tuple[NDArray[Any], ...]:
        return packed(self._places(a, b))

    def channels(self, place: tuple[NDArray[Any], ...]) -> FloatArray:
        def look_up(index: IndexArray) -> FloatArray:
            usable = self._table.mask[index][:, None]
            return np.where(usable, np.maximum(self._table.value[index], 0.0), np.nan)

        return self._blend(unpacked(place), look_up)

    def _blend(self, places: list[Place], look_up: Callable[[IndexArray], FloatArray]) -> FloatArray:
        found = multilinear(places, self._table.grid.shape, look_up)
        measured = np.logical_and.reduce([place.measured for place in places])
        if not measured.all():
            found[~measured] = np.nan
        return found

    def bound(self, cells: FloatArray) -> FloatArray:
        """Maximum of B over a box in (theta_h, theta_d, phi_d) that contains the image of the cell.

        1. Radius. With c the cell's centre, every w of the cell has angle(w, c) <= r, where by the haversine
           formula sin^2(r/2) = sin^2(dtheta/4) + sin(theta_c) sin(theta_1) sin^2(dphi/4), because
           sin(theta) <= sin(theta_1) on the cell.
        2. Difference angle. 2 theta_d = angle(wi, w), and by the triangle inequality
           |angle(wi, w) - angle(wi, c)| <= angle(w, c) <= r: theta_d is within r/2 of its value at c.
        3. Half vector. h = (wi + w)/|wi + w| and |wi + w| = 2 cos(theta_d). The derivative of v/|v| is a
           projection over |v|, so |dh| <= |dw| / (2 cos(theta_d)). Along the great circle from c to w, of
           length <= r, every point is within r of c, so theta_d <= theta_d(c) + r/2 by 2. Hence
           angle(h, h(c)) <= reach_h = r / (2 cos(theta_d(c) + r/2)), and theta_h, the angle between h and the
           normal n, is within reach_h of its value at c. Where theta_d(c) + r/2 >= pi/2 nothing is assumed.
        4. Azimuth. phi_d is the azimuth of the fixed wi in the frame (e_x, e_y, h), e_y along n x h. When h
           moves by dh the frame turns by d(phi_h) n + d(theta_h) e_y, whose part along h is at most
           |dh| cot(theta_h) and across h at most |dh|; the azimuth of a fixed vector at polar angle theta_d
           changes by at most the first plus cot(theta_d) times the second. So along the same path
           |d(phi_d)| <= |dh| (cot(theta_h) + cot(theta_d)), both at their smallest angles of 2 and 3; where
           one of those reaches 0 nothing is assumed of phi_d.
        5. Values. B is the bilinear interpolant, in (theta_h, theta_d), of the largest node value over the
           range of phi_d, the nodes around the range included. The field is an average, with those bilinear
           weights, of interpolants in phi_d, each at most the largest of its nodes: field <= B. On a
           rectangle inside one grid cell B is largest at a corner, so over a box with at most one node line
           inside in each direction B is largest at one of the 3 x 3 points where the box's sides and those
           lines cross; over a larger box the largest node around it, over all phi_d, bounds B.
        """
        from fitter.kernels.half_difference_cells import bounds

        found = np.empty(len(cells))
        windows = self._shared.windows
        nodes, _, about = self._axes

        def some(part: slice) -> None:
            bounds(
                cells[part], self._incidence, nodes, about, self._shared.boxes.sparse, windows.around,
                windows.count, windows.levels, windows.whole, _SLACK, found[part],
            )  # fmt: skip

        in_parts(some, len(cells), AT_ONCE, MANY)
        return found * (1 + ROUNDING)

    def integrals(
        self, cells: FloatArray, x: FloatArray, share: FloatArray, *, clamped: bool = True
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        from fitter.kernels.half_difference_cells import integrals

        table = self._shared.weighted
        if not clamped:
            table = np.where(self._table.mask, self._table.value @ self._shared.weights, np.nan)
        found, known = np.empty(len(cells)), np.empty(len(cells), np.int64)

        def some(part: slice) -> None:
            integrals(cells[part], x, share, *self._axes, self._incidence, table, found[part], known[part])

        in_parts(some, len(cells), AT_ONCE, MANY)
        return found, known


def packed(places: list[Place]) -> tuple[NDArray[Any], ...]:
    """Places as one flat tuple of arrays."""
    return tuple(column for place in places for column in place)


def unpacked(place: tuple[NDArray[Any], ...]) -> list[Place]:
    """Inverse of :func:`packed`."""
    return [Place(*place[k : k + 4]) for k in range(0, len(place), 4)]
