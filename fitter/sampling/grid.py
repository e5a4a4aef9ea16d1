"""The interpolant of a product grid: multilinear in the grid's own coordinates.

Periodic axes close on themselves. An axis of cell centres keeps its last value up to the normal, the
horizon or the plane of incidence. A cell that touches a masked node is not part of the measured domain:
values there use the usable nodes, weights scaled to sum to 1, or the nearest usable node, and are flagged.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from fitter import directions
from fitter.sampling.axes import Axis, axes_of, corners
from fitter.sampling.envelope import Envelope
from fitter.sampling.interpolant import Slice, in_chunks, pairs
from fitter.table import Grid

if TYPE_CHECKING:
    from fitter.sampling.half_difference import WeightedTable

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# A corner with less weight than this is not touched: a query on a node must not see its neighbours.
_NO_WEIGHT = 1e-9
_PLANE = 1e-3  # sine of the azimuth up to which a direction is in the plane of incidence
_CHUNK = 1 << 18


class GridInterpolant:
    """Multilinear on ``grid`` with values (N, C) in 1/sr and mask (N,) in its storage order."""

    def __init__(self, grid: Grid, value: FloatArray, mask: BoolArray) -> None:
        self.grid = grid
        self.value = value
        self.mask = mask
        self.axes: tuple[Axis, ...] = axes_of(grid)
        self._weighted: WeightedTable | None = None

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
        return {**{name: vars(self)[name] for name in kept}, "_weighted": None}

    @cached_property
    def _nearest(self) -> NDArray[np.int32]:
        """(N,) the nearest usable node of each, in steps of the grid."""
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
        total = np.zeros((len(wi), self.value.shape[1]))
        share = np.zeros(len(wi))
        around = corners(places, self.grid.shape)
        for index, weight in around:
            usable = self.mask[index]
            outside |= ~usable & (weight > _NO_WEIGHT)
            weight = np.where(usable, weight, 0.0)
            total += weight[:, None] * np.where(usable[:, None], self.value[index], 0.0)
            share += weight
        known = share > _NO_WEIGHT
        values = total / np.where(known, share, 1.0)[:, None]
        if not known.all():
            heaviest = np.argmax([weight for _, weight in around], axis=0)
            index = np.stack([index for index, _ in around])[heaviest, np.arange(len(wi))]
            values[~known] = self.value[self._nearest[index[~known]]]
        return values, outside

    def slice(self, wi: ArrayLike) -> Slice:
        """The interpolant at the one incidence ``wi`` (3,)."""
        w = pairs(wi, wi)[0][0]
        if self.grid.system == "half_difference":
            return HalfDifferenceSlice(self, w, bool(w[2] <= 0))
        theta, phi = (float(angle) for angle in directions.spherical_from_vector(w))
        outgoing, incoming = self.axes[-2:], self.axes[:-2]
        rotation = phi if self.grid.system == "spherical_isotropic" else 0.0
        coordinates = self.grid.locate(w[None], w[None])[: len(incoming)]
        places = [axis.locate(x) for axis, x in zip(incoming, coordinates, strict=True)]
        extrapolated = theta >= np.pi / 2 or not all(bool(place.measured[0]) for place in places)
        shape = (*(len(axis.nodes) for axis in outgoing), self.value.shape[1])
        per_incidence = self.value.reshape(-1, shape[0] * shape[1], shape[2])
        usable_there = self.mask.reshape(-1, shape[0] * shape[1])
        raw, clamped = np.zeros((2, shape[0] * shape[1], shape[2]))
        usable = np.ones(shape[0] * shape[1], bool)
        for index, weight in corners(places, [len(axis.nodes) for axis in incoming]):
            if weight[0] > _NO_WEIGHT:
                known = usable_there[index[0]]
                usable &= known
                there = np.where(known[:, None], per_incidence[index[0]], 0.0)
                raw += weight[0] * there
                clamped += weight[0] * np.maximum(there, 0.0)
        return SphericalSlice(outgoing, raw, clamped, usable, rotation, extrapolated)


@dataclass(frozen=True)
class SphericalSlice:
    """One incidence of a grid in incoming and outgoing angles: bilinear in (theta_o, azimuth).

    raw, clamped : (T P, C) node values as measured and clamped at 0; usable : (T P,).
    rotation : azimuth to add to the slice's own to come back to the sample's frame.
    """

    outgoing: tuple[Axis, ...]
    raw: FloatArray
    clamped: FloatArray
    usable: BoolArray
    rotation: float
    extrapolated: bool

    def envelope(self, weights: FloatArray, acceptance: float, cells: int) -> Envelope:
        from fitter.sampling.cells import CellEnvelope
        from fitter.sampling.majorants import SphericalField

        return CellEnvelope(SphericalField(self, weights), acceptance, cells)


@dataclass(frozen=True)
class HalfDifferenceSlice:
    """One incidence ``wi`` (3,) of a grid in half and difference angles."""

    interpolant: GridInterpolant
    wi: FloatArray
    extrapolated: bool

    def envelope(self, weights: FloatArray, acceptance: float, cells: int) -> Envelope:
        from fitter.sampling.cells import CellEnvelope
        from fitter.sampling.half_difference import HalfDifferenceField

        return CellEnvelope(HalfDifferenceField(self, weights), acceptance, cells)
