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
    """The same of an isotropic table in half and difference angles, of which it needs cosines only:
    z is cos_h cos_d -+ sin_h sin_d cos(phi_d), and n . (wi x wo) is 2 sin_h cos_d sin_d sin(phi_d)."""
    sin_h, sin_d, sin_p = (np.sin(axis) for axis in grid.axes.values())
    cos_h, cos_d, cos_p = (np.cos(axis) for axis in grid.axes.values())
    seen = np.zeros(int(np.pi * PER_RADIAN) + 2, bool)
    width = len(sin_d) * len(sin_p)
    used = table.mask.reshape(len(sin_h), width)
    across = np.abs(2.0 * (cos_d * sin_d)[:, None] * sin_p).reshape(width)
    #: Cells with the steepest and the flattest wi and wo, of each theta_h; the largest triple product.
    cells = np.zeros((len(sin_h), 4), np.intp)
    out_of_plane = np.zeros(len(sin_h))

    def look(part: slice) -> None:
        k = part.start // width
        here = used[k]
        if not here.any():
            cells[k] = -1
            return
        up, down = cos_h[k] * cos_d[:, None], (sin_h[k] * sin_d)[:, None] * cos_p
        which = np.flatnonzero(here)
        z_i, z_o = (z.reshape(width)[which] for z in (up - down, up + down))
        steepest = z_i.argmax(), z_i.argmin(), z_o.argmax(), z_o.argmin()
        cells[k] = part.start + which[list(steepest)]
        theta_i = np.arccos(np.clip(z_i, -1.0, 1.0))
        seen[np.rint(theta_i * PER_RADIAN).astype(np.int64)] = True
        out_of_plane[k] = np.abs(sin_h[k]) * across[which].max()

    in_parts(look, len(table), width)
    # The angles themselves from vectors: a cosine near 1 has lost half their digits. Which cell is nearest to
    # the normal is known to 2e-8 rad.
    chosen = cells[cells[:, 0] >= 0].T
    (steep_i, flat_i, steep_o, flat_o) = (
        directions.spherical_from_vector(table.directions(cells)[k >= 2])[0] for k, cells in enumerate(chosen)
    )
    return Domain(
        theta_i=(float(steep_i.min()), float(flat_i.max())),
        theta_o=(float(steep_o.min()), float(flat_o.max())),
        incidences=int(np.count_nonzero(seen)),
        in_plane=bool(out_of_plane.max() < FLAT),
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
    table.grid.row_components(part.start, part.stop, found)
    return found if used.all() else found[:, used]
