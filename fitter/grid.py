"""Product grids: coordinate systems, axes, and the directions of their cells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitter import directions
from fitter.errors import TableError

FloatArray = NDArray[np.float64]

#: Coordinate systems a grid may be regular in, with their axes in storage order (the last runs fastest).
GRID_AXES: Mapping[str, tuple[str, ...]] = {
    "half_difference": ("theta_h", "theta_d", "phi_d"),
    "spherical_isotropic": ("theta_i", "theta_o", "dphi"),
    "spherical": ("theta_i", "phi_i", "theta_o", "phi_o"),
}


@dataclass(frozen=True)
class Grid:
    """A product grid: ``axes`` maps each axis of ``GRID_AXES[system]``, in order, to increasing radians.

    In ``spherical_isotropic`` the incident azimuth is 0 and ``dphi`` is phi_o - phi_i, so that the
    specular side is dphi = pi. ``periodic`` names azimuth axes that close on themselves and their period.
    """

    system: str
    axes: Mapping[str, FloatArray]
    periodic: Mapping[str, float] = field(default_factory=dict[str, float])

    def __post_init__(self) -> None:
        if tuple(self.axes) != GRID_AXES.get(self.system):
            raise TableError(
                f"a {self.system!r} grid can't have the axes {tuple(self.axes)}", code="grid-axes",
                remedy=f"use one of {dict(GRID_AXES)}",
            )  # fmt: skip

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(len(axis) for axis in self.axes.values())

    @property
    def size(self) -> int:
        return int(np.prod(self.shape))

    def coordinates(self, index: NDArray[np.intp] | None = None) -> tuple[FloatArray, ...]:
        """Coordinates of the cells ``index`` (default all, in storage order), one (n,) array per axis."""
        if index is None:
            mesh = np.meshgrid(*self.axes.values(), indexing="ij")
            return tuple(axis.reshape(-1) for axis in mesh)
        where = np.unravel_index(index, self.shape)
        return tuple(axis[i] for axis, i in zip(self.axes.values(), where, strict=True))

    @property
    def rows(self) -> int:
        """How many rows of the last axis there are."""
        return self.size // self.shape[-1]

    def row_components(self, rows: NDArray[np.intp], out: FloatArray) -> None:
        """The components of wi and wo of the cells of whole rows of the last axis into ``out`` (6, cells)."""
        *outer, last = self.axes.values()
        width = len(last)
        where = np.unravel_index(rows, self.shape[:-1])
        c = [*(axis[i][:, None] for axis, i in zip(outer, where, strict=True)), last[None, :]]
        if self.system == "half_difference":
            by_row = [component.reshape(-1, width) for component in out]
            directions.half_difference_components(c[0], c[1], c[2], out=by_row)
            return
        if self.system == "spherical_isotropic":
            parts = (
                *directions.spherical_components(c[0], 0.0), *directions.spherical_components(c[1], c[2])
            )  # fmt: skip
        else:
            parts = (
                *directions.spherical_components(c[0], c[1]), *directions.spherical_components(c[2], c[3])
            )  # fmt: skip
        for row, part in zip(out, parts, strict=True):
            row.reshape(-1, width)[...] = part

    def directions(self, index: NDArray[np.intp] | None = None) -> tuple[FloatArray, FloatArray]:
        """``(wi, wo)``, each (n, 3), of the cells ``index`` (default all, in storage order)."""
        c = self.coordinates(index)
        if self.system == "half_difference":
            return directions.vectors_from_half_difference(c[0], c[1], c[2])
        if self.system == "spherical_isotropic":
            return directions.vector_from_spherical(c[0], 0.0), directions.vector_from_spherical(c[1], c[2])
        return directions.vector_from_spherical(c[0], c[1]), directions.vector_from_spherical(c[2], c[3])

    def locate(self, wi: ArrayLike, wo: ArrayLike) -> tuple[FloatArray, ...]:
        """Grid coordinates of direction pairs (n, 3): the inverse of :meth:`directions`, one (n,) per axis.

        Azimuths are brought into one period that starts at the axis' first node; ``dphi`` and ``phi_d``
        are folded where the axis covers only half a turn (isotropic surfaces are mirror-symmetric, and
        phi_d + pi is the reciprocal pair).
        """
        if self.system == "half_difference":
            wi, wo = np.asarray(wi, np.float64), np.asarray(wo, np.float64)
            return self.half_difference(
                wi[..., 0], wi[..., 1], wi[..., 2], wo[..., 0], wo[..., 1], wo[..., 2]
            )
        theta_i, phi_i = directions.spherical_from_vector(wi)
        theta_o, phi_o = directions.spherical_from_vector(wo)
        if self.system == "spherical_isotropic":
            return theta_i, theta_o, self._wrap("dphi", phi_o - phi_i)
        return theta_i, self._wrap("phi_i", phi_i), theta_o, self._wrap("phi_o", phi_o)

    def half_difference(self, *components: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """:meth:`locate` of the components of wi and of wo, for a grid in half and difference angles."""
        theta_h, _, theta_d, phi_d = directions.half_difference_from_components(*components)
        return theta_h, theta_d, self._wrap("phi_d", phi_d)

    def _wrap(self, name: str, angle: FloatArray) -> FloatArray:
        axis = self.axes[name]
        period = self.periodic.get(name, 2 * np.pi)
        wrapped = axis[0] + _modulo(angle - axis[0], period)
        if name == "dphi" and name not in self.periodic:
            folded = np.abs(np.mod(angle + np.pi, 2 * np.pi) - np.pi)
            return np.where((wrapped > axis[-1]) & (folded >= axis[0]), folded, wrapped)
        return wrapped


def _modulo(x: FloatArray, period: float) -> FloatArray:
    """``x`` in [0, period], in a tenth of the time of np.mod; what rounding puts below 0 is 0."""
    return np.maximum(x - period * np.floor(x * (1 / period)), 0.0)
