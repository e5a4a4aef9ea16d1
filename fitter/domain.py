"""Domain: the range of directions that a table's usable samples cover."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.parts import ROWS, in_parts
from fitter.repeats import STEP

if TYPE_CHECKING:
    from fitter.grid import Grid
    from fitter.table import Table

FloatArray = NDArray[np.float64]
#: Angles of incidence are told apart to a hundred-thousandth of a radian.
PER_RADIAN = 1e5
#: The largest n . (wi x wo) of a table whose directions lie in one plane.
FLAT = 1e-3


@dataclass(frozen=True)
class Domain:
    """The range of directions a table was measured over (radians); outside it values are extrapolated."""

    theta_i: tuple[float, float]
    theta_o: tuple[float, float]
    incidences: int
    in_plane: bool

    def to_dict(self) -> dict[str, Any]:
        return {
            "theta_i_deg": [float(np.rad2deg(a)) for a in self.theta_i],
            "theta_o_deg": [float(np.rad2deg(a)) for a in self.theta_o],
            "incidences": self.incidences,
            "in_plane": self.in_plane,
        }


def domain(table: Table) -> Domain:
    """Range of the usable samples."""
    isotropic = table.symmetry == "isotropic"
    if isotropic and table.grid is not None and table.grid.system == "half_difference":
        return _of_half_difference(table, table.grid)
    # Polar angles of incidence that occur, and where azimuths count keys of both: one integer per incidence,
    # because unique rows of a million-row array take a second.
    seen = np.zeros(int(np.pi * PER_RADIAN) + 2, bool)
    keys: list[NDArray[np.int64]] = []
    spans: list[FloatArray] = []

    def look(part: slice) -> None:
        xi, yi, zi, xo, yo, zo = _usable_components(table, part)
        if not len(xi):
            return
        theta_i = directions.polar_from_components(xi, yi, zi)
        theta_o = directions.polar_from_components(xo, yo, zo)
        # Out of plane where the triple product n . (wi x wo) is not zero.
        out_of_plane = np.abs(xi * yo - yi * xo)
        key = np.rint(theta_i * PER_RADIAN).astype(np.int64)
        if isotropic:
            seen[key] = True
        else:
            azimuth = np.where(theta_i > STEP, np.arctan2(yi, xi), 0.0)
            keys.append(key * 1_000_000 + np.rint(azimuth * PER_RADIAN).astype(np.int64))
        low = theta_i.min(), theta_o.min(), 0.0
        spans.append(np.array([low, (theta_i.max(), theta_o.max(), out_of_plane.max())]))

    # Whole rows of a grid's last axis.
    width = 1 if table.grid is None else table.grid.shape[-1]
    in_parts(look, len(table), width * max(1, ROWS // width))
    low, high = np.min([span[0] for span in spans], axis=0), np.max([span[1] for span in spans], axis=0)
    return Domain(
        theta_i=(float(low[0]), float(high[0])),
        theta_o=(float(low[1]), float(high[1])),
        incidences=int(np.count_nonzero(seen)) if isotropic else _distinct(np.concatenate(keys)),
        in_plane=bool(high[2] < FLAT),
    )


def _of_half_difference(table: Table, grid: Grid) -> Domain:
    """The same of an isotropic table in half and difference angles, theta_h by theta_h, from cosines: in less
    than half the time."""
    theta_h, theta_d, phi_d = grid.axes.values()
    width = len(theta_d) * len(phi_d)
    seen = np.zeros(int(np.pi * PER_RADIAN) + 2, bool)
    # Cells of each theta_h: steepest and flattest wi, steepest and flattest wo. Where one is out of plane.
    ends: list[NDArray[np.intp]] = []
    outside: list[int] = []

    def look(part: slice) -> None:
        which = np.flatnonzero(table.mask[part])
        if not len(which):
            return
        found = directions.half_difference_components(theta_h[part.start // width], theta_d[:, None], phi_d)
        xi, yi, zi, xo, yo, zo = (component.reshape(width) for component in found)
        z_i, z_o = zi[which], zo[which]
        ends.append(part.start + which[[z_i.argmax(), z_i.argmin(), z_o.argmax(), z_o.argmin()]])
        seen[np.rint(np.arccos(np.clip(z_i, -1.0, 1.0)) * PER_RADIAN).astype(np.int64)] = True
        # Once is enough.
        if not outside and np.abs(xi * yo - yi * xo)[which].max() >= FLAT:
            outside.append(part.start)

    in_parts(look, len(table), width)
    # The angles themselves from vectors: a cosine near 1 has lost half their digits. Which cell is nearest to
    # the normal is known to 2e-8 rad.
    steep_i, flat_i, steep_o, flat_o = (
        directions.spherical_from_vector(table.directions(cells)[k >= 2])[0]
        for k, cells in enumerate(np.array(ends).T)
    )
    return Domain(
        theta_i=(float(steep_i.min()), float(flat_i.max())),
        theta_o=(float(steep_o.min()), float(flat_o.max())),
        incidences=int(np.count_nonzero(seen)),
        in_plane=not outside,
    )


def _distinct(keys: NDArray[np.int64]) -> int:
    keys.sort()  # in a fifth of the time that np.unique takes for so many
    return 1 + int(np.count_nonzero(np.diff(keys)))


def _usable_components(table: Table, part: slice) -> FloatArray:
    """(6, n), x y z of wi and of wo, of the usable samples in ``part``: whole rows of a grid."""
    used = table.mask[part]
    if table.grid is None:
        return np.hstack([table.wi[part][used], table.wo[part][used]]).T
    found = np.empty((6, len(used)))
    width = table.grid.shape[-1]
    first, last = part.start // width, part.stop // width
    assert (first * width, last * width) == (part.start, part.stop), "parts are whole rows"
    table.grid.row_components(np.arange(first, last), found)
    return found if used.all() else found[:, used]
