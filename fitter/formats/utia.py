"""UTIA BRDF database (Filip and Vavra 2014): bare float64 planes, or a picture, over pairs of directions.

Index: plane, then theta_i, phi_i, theta_v, phi_v, the last running fastest; theta 0, 15 ... 75 deg, phi 0,
7.5 ... 352.5 deg. The layout is that of the reader the database's authors published; no file states it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.formats.assemble import Reading, build, stated_quantity, to_brdf
from fitter.formats.fills import no_data
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format
from fitter.formats.source import Source
from fitter.grid import Grid
from fitter.metadata import Channel, Quantity
from fitter.table import Table

FloatArray = NDArray[np.float64]

NAME = "utia"
CONVENTIONS = ("phi_specular_180", "phi_specular_0")
_THETA, _PHI = 6, 48
_ROWS = _THETA * _PHI
#: Bytes of a file: it has no header, so its size is what tells it.
SIZE = 3 * _ROWS * _ROWS * 8
#: Rows and columns of a picture that holds the same numbers.
SIDES = (_ROWS, _ROWS)


def sniff(head: bytes, size: int) -> float:
    """Sure of a file of the one size whose first bytes are float64 numbers that a BRDF could have."""
    if size != SIZE:
        return 0.0
    numbers = np.frombuffer(head, "<f8", count=len(head) // 8)
    # Bytes of another kind make numbers of every magnitude, down to 1e-308.
    with np.errstate(invalid="ignore"):
        magnitude = np.abs(numbers)
        likely = (magnitude > 1e-9) & (magnitude < 1e6)
    possible = likely | (numbers == 0) | np.isnan(numbers)
    return 0.95 if possible.mean() > 0.99 and likely.mean() > 0.05 else 0.0


def read(source: Source, options: ReadOptions) -> list[Table]:
    """The table on its grid. Negative values, which some of the database's files have, are masked."""
    quantity, notes = stated_quantity(options, "brdf", "nothing, and the database's are BRDF")
    if len(source.buffer) != SIZE:
        raise source.error(
            f"the file has {len(source.buffer):,} bytes and a UTIA file {SIZE:,}", "table-truncated",
            offset=min(len(source.buffer), SIZE),
            cause="the file was changed while it was read", remedy="fetch the file again",
        )  # fmt: skip
    return [_table(source, options, np.frombuffer(source.buffer, "<f8"), quantity, notes)]


def from_picture(source: Source, options: ReadOptions, planes: FloatArray) -> Table:
    """The table of a picture (3, 288, 288), of which a row is an incidence and a column a view.

    Programs write the rows from the top or from the bottom. At theta_i = 0 the light's azimuth says nothing,
    so the 48 rows of that end are alike.
    """
    quantity, notes = stated_quantity(options, "brdf", "nothing, and the database's are BRDF")
    ends = [float(np.nan_to_num(np.ptp(end, axis=1)).mean()) for end in (planes[:, :_PHI], planes[:, -_PHI:])]
    if ends[1] < ends[0]:
        planes = planes[:, ::-1]
    notes.append(
        f"Rows were read from the {'bottom' if ends[1] < ends[0] else 'top'}: those of theta_i = 0 must be "
        f"alike, and differ by {min(ends):.3g} there, by {max(ends):.3g} at the other end."
    )
    return _table(source, options, planes, quantity, notes)


def _table(
    source: Source, options: ReadOptions, stored: FloatArray, quantity: Quantity, notes: list[str]
) -> Table:
    convention = options.convention or CONVENTIONS[0]
    planes = stored.reshape(3, _ROWS, _THETA, _PHI)
    if convention == "phi_specular_0":
        planes = np.roll(planes, _PHI // 2, axis=-1)
    value = planes.reshape(3, -1).T
    theta = np.deg2rad(15.0 * np.arange(_THETA))
    phi = np.deg2rad(7.5 * np.arange(_PHI))
    grid = Grid(
        "spherical", {"theta_i": theta, "phi_i": phi, "theta_o": theta, "phi_o": phi},
        {"phi_i": 2 * np.pi, "phi_o": 2 * np.pi},
    )  # fmt: skip
    cos_o = np.cos(np.tile(np.repeat(theta, _PHI), _ROWS))
    side = "180" if convention == "phi_specular_180" else "0"
    notes += [
        f"Azimuths were read so that mirror reflection is at phi_o - phi_i = {side} deg.",
        "The file says nothing of its values: they were taken as stored. Programs disagree on their scale "
        "(some divide by 140, or undo an sRGB curve), so compare the albedo with what is known.",
        "Directions end at 75 deg from the normal: what lies beyond is extrapolated.",
    ]
    fills, about_fills = no_data(value, options.fills)
    notes += about_fills
    reading = Reading(NAME, quantity, value, [Channel(c) for c in "RGB"], symmetry="anisotropic")
    return build(
        source, options, reading, convention, notes, value=to_brdf(value, quantity, cos_o), grid=grid,
        fills=fills, symmetric=False,
    )  # fmt: skip


FORMAT = Format(NAME, "UTIA database binary, anisotropic RGB without a header", CONVENTIONS, sniff, read)
