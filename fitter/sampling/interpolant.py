"""The interpolant of a table: the function its samples stand for, one definition per kind of table.

Grids are interpolated multilinearly in their own coordinates (:mod:`fitter.sampling.grid`), scattered
tables scan by scan on triangles (:mod:`fitter.sampling.scattered`). ``docs/raw-tables.md`` says the same
for readers who don't read code.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitter.errors import TableError

if TYPE_CHECKING:
    from fitter.sampling.envelope import Envelope, JointEnvelope, Method
    from fitter.table import Table

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


class Slice(Protocol):
    """The interpolant at one incidence, as a function of wo.

    extrapolated : True when the incidence lies outside the measured ones.
    preferred : how directions are drawn where nobody asks for another way.
    """

    @property
    def extrapolated(self) -> bool: ...

    @property
    def preferred(self) -> Method: ...

    def envelope(self, weights: FloatArray, acceptance: float, cells: int, method: Method) -> Envelope:
        """What the sampler draws candidates from; ``weights`` (C,) sum to 1.

        Raises SpecError where ``method`` is "inversion" and the interpolant can't be inverted exactly.
        """
        ...


class Interpolant(Protocol):
    """f_r(wi, wo) in 1/sr everywhere, with a flag where the table was not measured.

    in_plane : True when the table covers the plane of incidence only, which has no solid angle.
    """

    @property
    def in_plane(self) -> bool: ...

    def evaluate(self, wi: ArrayLike, wo: ArrayLike) -> tuple[FloatArray, BoolArray]:
        """``(values, extrapolated)``, (M, C) in 1/sr and (M,), of direction pairs (M, 3) or (3,)."""
        ...

    def slice(self, wi: ArrayLike) -> Slice:
        """The interpolant at the one incidence ``wi`` (3,)."""
        ...

    def joint(
        self, weights: FloatArray, acceptance: float, cells: int, method: Method | None
    ) -> JointEnvelope:
        """What pairs (wi, wo) are drawn from; as :meth:`Slice.envelope`."""
        ...


def interpolant(table: Table) -> Interpolant:
    """The interpolant of ``table``, built on first use and kept with the table."""
    if table.between is not None:
        return table.between
    kept = vars(table)
    if "_interpolant" not in kept:
        if table.grid is not None:
            from fitter.sampling.grid import GridInterpolant

            kept["_interpolant"] = GridInterpolant(table.grid, table.value, table.mask)
        else:
            from fitter.sampling.scattered import ScatteredInterpolant

            use = table.mask
            kept["_interpolant"] = ScatteredInterpolant.build(
                table.wi[use], table.wo[use], table.value[use], isotropic=table.symmetry == "isotropic"
            )
    return kept["_interpolant"]


def in_chunks(
    work: Callable[[FloatArray, FloatArray], tuple[FloatArray, BoolArray]],
    wi: ArrayLike, wo: ArrayLike, channels: int, size: int,
) -> tuple[FloatArray, BoolArray]:  # fmt: skip
    """``work`` of direction pairs, at most ``size`` at a time: (M, channels) values and (M,) flags."""
    wi, wo = pairs(wi, wo)
    values = np.empty((len(wi), channels))
    extrapolated = np.empty(len(wi), bool)
    for start in range(0, len(wi), size):
        part = slice(start, start + size)
        values[part], extrapolated[part] = work(wi[part], wo[part])
    return values, extrapolated


def pairs(wi: ArrayLike, wo: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Both as (M, 3) float64. Raises TableError for shapes that don't match or numbers that aren't finite."""
    wi, wo = np.asarray(wi, np.float64), np.asarray(wo, np.float64)
    if wi.ndim > 2 or wo.ndim > 2 or wi.shape[-1:] != (3,) or wo.shape[-1:] != (3,):
        raise TableError(
            f"wi has shape {wi.shape}, wo {wo.shape}, expected (M, 3) or (3,)", code="bad-directions",
            parameter="wi, wo", remedy="give unit vectors away from the surface, one a row",
        )  # fmt: skip
    wi, wo = np.atleast_2d(wi), np.atleast_2d(wo)
    if len(wi) != len(wo) and 1 not in (len(wi), len(wo)):
        raise TableError(
            f"{len(wi)} incident directions can't be paired with {len(wo)} scattered ones",
            code="bad-directions", parameter="wi, wo",
            remedy="give as many of one as of the other, or one of either",
        )  # fmt: skip
    wi, wo = np.broadcast_arrays(wi, wo)
    if not (np.isfinite(wi).all() and np.isfinite(wo).all()):
        raise TableError(
            "a direction is not finite", code="bad-directions", parameter="wi, wo",
            remedy="give unit vectors away from the surface",
        )  # fmt: skip
    return wi, wo
