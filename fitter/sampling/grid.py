"""The interpolant of a product grid: multilinear in the grid's own coordinates.

Periodic axes close on themselves. An axis of cell centres keeps its last value up to the normal, the
horizon or the plane of incidence. A cell that touches a masked node is not part of the measured domain:
values there use the usable nodes, weights scaled to sum to 1, or the nearest usable node, and are flagged.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitter import directions
from fitter.grid import Grid
from fitter.sampling.axes import Axis, axes_of, corners
from fitter.sampling.energy import GridEnergy, grid_energy
from fitter.sampling.envelope import JointEnvelope, Method, no_inversion
from fitter.sampling.interpolant import Slice, in_chunks, pairs
from fitter.sampling.spherical import Node, SphericalSlice, powered

if TYPE_CHECKING:
    from fitter.sampling.half_difference import WeightedTable

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]

# A corner with less weight than this is not touched: a query on a node must not see its neighbours.
_NO_WEIGHT = 1e-9
_PLANE = 1e-3  # sine of the azimuth up to which a direction is in the plane of incidence
_CHUNK = 1 << 16
_KIND = "a grid in half and difference angles"


class GridInterpolant:
    """Multilinear on ``grid`` with values (N, C) in 1/sr and mask (N,) in its storage order."""

    def __init__(self, grid: Grid, value: FloatArray, mask: BoolArray) -> None:
        self.grid = grid
        self.value = value
        self.mask = mask
        self.axes: tuple[Axis, ...] = axes_of(grid)
        self._weighted: WeightedTable | None = None
        self._energies: dict[int, GridEnergy] = {}

    @property
    def in_plane(self) -> bool:
        axes = self.grid.axes
        if self.grid.system == "spherical":
            relative = axes["phi_o"][None, :] - axes["phi_i"][:, None]
        else:
            relative = axes["phi_d" if self.grid.system == "half_difference" else "dphi"]
            if self.grid.system == "half_difference" and len(relative) == 1:
                return False  # one phi_d node: the table is constant in phi_d, not confined to a plane
        return bool(np.abs(np.sin(relative)).max() < _PLANE)

    @cached_property
    def has_negatives(self) -> bool:
        """Whether clamping would change anything."""
        return bool((self.value[self.mask] < 0).any())

    def weighted(self, weights: FloatArray) -> WeightedTable:
        """What the sampler's slices in half and difference angles share; kept for the last weights."""
        from fitter.sampling.half_difference import WeightedTable

        if self._weighted is None or not np.array_equal(self._weighted.weights, weights):
            self._weighted = WeightedTable(self, weights)
        return self._weighted

    def __getstate__(self) -> dict[str, Any]:
        kept = ("grid", "value", "mask", "axes")  # what was computed from them is computed again
        return {**{name: vars(self)[name] for name in kept}, "_weighted": None, "_energies": {}}

    @cached_property
    def _nearest(self) -> NDArray[np.int32]:
        """(N,) the nearest usable node of each, in steps of the grid."""
        from scipy import ndimage  # a fit needs none of it

        found = ndimage.distance_transform_edt(
            ~self.mask.reshape(self.grid.shape), return_distances=False, return_indices=True
        )
        assert found is not None
        return np.ravel_multi_index(tuple(found), self.grid.shape).reshape(-1).astype(np.int32)

    def evaluate(self, wi: ArrayLike, wo: ArrayLike) -> tuple[FloatArray, BoolArray]:
        """``(values, extrapolated)``, (M, C) in 1/sr and (M,), of direction pairs (M, 3) or (3,)."""
        return in_chunks(self._evaluate, wi, wo, self.value.shape[1], _CHUNK)

    def _evaluate(self, wi: FloatArray, wo: FloatArray) -> tuple[FloatArray, BoolArray]:
        coordinates = self.grid.locate(wi, wo)
        places = [axis.locate(x) for axis, x in zip(self.axes, coordinates, strict=True)]
        outside = (wi[:, 2] <= 0) | (wo[:, 2] <= 0)
        for place in places:
            outside |= ~place.measured
        if self.in_plane:
            cross = wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0]
            outside |= np.abs(cross) > _PLANE * np.hypot(wi[:, 0], wi[:, 1]) * np.hypot(wo[:, 0], wo[:, 1])
        around = corners(places, self.grid.shape)
        incoming: list[tuple[IndexArray, FloatArray]] = []
        if self.grid.system != "half_difference":
            incoming = corners(places[:-2], self.grid.shape[:-2])
        roots = [self._roots(node, weight) for node, weight in incoming]
        if any((root != 1).any() for root in roots):
            total, share, missing = self._by_roots(roots, around)
        else:
            total, share, missing = self._sums(around)
        outside |= missing
        known = share > _NO_WEIGHT
        values = total / np.where(known, share, 1.0)[:, None]
        if not known.all():
            heaviest = np.argmax([weight for _, weight in around], axis=0)
            index = np.stack([index for index, _ in around])[heaviest, np.arange(len(wi))]
            values[~known] = self.value[self._nearest[index[~known]]]
        return values, outside

    def _sums(
        self, around: list[tuple[IndexArray, FloatArray]], power: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Weighted values (or their roots) and weights of the usable corners, and where one is missing."""
        total, share = 0.0, 0.0
        missing = np.zeros(around[0][0].shape, bool)
        for index, weight in around:
            usable = self.mask[index]
            missing |= ~usable & (weight > _NO_WEIGHT)
            weight = np.where(usable, weight, 0.0)
            value = np.where(usable[:, None], self.value[index], 0.0)
            total = total + weight[:, None] * (value if power is None else powered(value, power))
            share = share + weight
        return np.asarray(total), np.asarray(share), missing

    def _by_roots(
        self, roots: list[FloatArray], around: list[tuple[IndexArray, FloatArray]]
    ) -> tuple[FloatArray, FloatArray, BoolArray]:
        """As :meth:`_sums`; between outgoing angles, roots are what is interpolated. ``roots`` : (M,) of each
        incoming corner."""
        total, share, missing = 0.0, 0.0, np.zeros(len(around[0][0]), bool)
        for k, one in enumerate(roots):
            root = one[:, None]
            some, of, gone = self._sums(around[4 * k : 4 * k + 4], 1 / root)
            known = of > 0
            mean = powered(some / np.where(known, of, 1.0)[:, None], root)
            total, share, missing = total + of[:, None] * mean, share + of, missing | gone
        return np.asarray(total), np.asarray(share), missing

    def energy(self, incidence: int) -> GridEnergy:
        """What interpolation does to the energy of one incidence of an in/out grid, in storage order."""
        if incidence not in self._energies:
            theta, phi = self.axes[-2:]
            size = len(theta.nodes) * len(phi.nodes)
            index = np.arange(incidence * size, (incidence + 1) * size)
            self._energies[incidence] = grid_energy(theta, phi, self.value[index], self.mask[index])
        return self._energies[incidence]

    def _roots(self, node: IndexArray, weight: FloatArray) -> FloatArray:
        """(M,) what power the interpolation between the outgoing angles of incidences is of; 1 is linear. Of
        incidences without weight nothing is asked."""
        needed, where = np.unique(np.where(weight > _NO_WEIGHT, node, -1), return_inverse=True)
        roots = np.array([1.0 if k < 0 else self.energy(int(k)).root for k in needed])
        return roots[where.reshape(-1)]

    def slice(self, wi: ArrayLike) -> Slice:
        """The interpolant at the one incidence ``wi`` (3,)."""
        w = pairs(wi, wi)[0][0]
        if self.grid.system == "half_difference":
            from fitter.sampling.cells import ChartSlice
            from fitter.sampling.half_difference import HalfDifferenceField

            return ChartSlice(
                w, bool(w[2] <= 0), _KIND, lambda part, weights: HalfDifferenceField(self, part, weights)
            )
        theta, phi = (float(angle) for angle in directions.spherical_from_vector(w))
        outgoing, incoming = self.axes[-2:], self.axes[:-2]
        rotation = phi if self.grid.system == "spherical_isotropic" else 0.0
        coordinates = self.grid.locate(w[None], w[None])[: len(incoming)]
        places = [axis.locate(x) for axis, x in zip(incoming, coordinates, strict=True)]
        extrapolated = theta >= np.pi / 2 or not all(bool(place.measured[0]) for place in places)
        shape = (*(len(axis.nodes) for axis in outgoing), self.value.shape[1])
        per_incidence = self.value.reshape(-1, shape[0] * shape[1], shape[2])
        usable_there = self.mask.reshape(-1, shape[0] * shape[1])
        usable = np.ones(shape[0] * shape[1], bool)
        nodes: list[Node] = []
        for index, weight in corners(places, [len(axis.nodes) for axis in incoming]):
            if weight[0] > _NO_WEIGHT:
                known = usable_there[index[0]]
                usable &= known
                there = np.where(known[:, None], per_incidence[index[0]], 0.0)
                energy = self.energy(int(index[0]))
                nodes.append(Node(float(weight[0]), there, energy.root, energy.left))
        return SphericalSlice(outgoing, tuple(nodes), usable, rotation, extrapolated)

    def joint(
        self, weights: FloatArray, acceptance: float, cells: int, method: Method | None
    ) -> JointEnvelope:
        """What pairs (wi, wo) are drawn from."""
        if self.grid.system != "half_difference":
            from fitter.sampling.joint import of_spherical

            return of_spherical(self, weights, acceptance, cells, method or "rejection")
        from fitter.sampling.joint_half_difference import HalfDifferenceJoint

        if method == "inversion":
            raise no_inversion(_KIND)
        return HalfDifferenceJoint(self, weights, acceptance)
