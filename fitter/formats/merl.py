"""MERL binary: three float64 planes over a half-difference grid, as measured by Matusik et al. (2003)."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitter.formats.assemble import Reading, build
from fitter.formats.output import refuse_in_plane, unwritable, write_aside
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format, Loss
from fitter.formats.source import Source
from fitter.grid import Grid
from fitter.metadata import Channel
from fitter.table import Table

NAME = "merl"
CONVENTIONS = ("center", "corner")
#: Stored values times these are f_r in 1/sr (the scales of the database's own reader).
SCALES = (1.0 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0)
#: Cells of the database's files along theta_h, theta_d and phi_d.
DIMS = (90, 90, 180)
_HEADER = struct.Struct("<3i")
#: A dimension beyond this is no grid but other bytes read as one.
_LARGEST = 100_000


def sniff(head: bytes, size: int) -> float:
    """Sure when the size is what the three dimensions ask for; a plausible header is enough to be asked."""
    if len(head) < _HEADER.size:
        return 0.0
    dims = _HEADER.unpack_from(head)
    if not all(0 < n <= _LARGEST for n in dims):
        return 0.0
    return 1.0 if size == _bytes(dims) else 0.7


def read(source: Source, options: ReadOptions) -> list[Table]:
    """The table of a MERL file on its grid; no directions are computed. Negative cells are unmeasured."""
    convention = options.convention or "center"
    if options.quantity not in (None, "brdf"):
        raise source.error(
            f"a MERL file holds f_r itself, not {options.quantity}", "table-quantity", parameter="quantity",
            remedy="leave quantity out",
        )  # fmt: skip
    dims = _HEADER.unpack_from(source.head)
    if source.size != _bytes(dims):
        raise source.error(
            f"the header claims {' x '.join(map(str, dims))} cells, {_bytes(dims):,} bytes, "
            f"and the file has {source.size:,}", "table-truncated", column="dimensions", offset=0,
            cause="the file is cut off" if source.size < _bytes(dims) else "the file is not a MERL binary",
            remedy="fetch the file again",
        )  # fmt: skip
    if min(dims) < 2:
        raise source.error(
            f"the grid has {' x '.join(map(str, dims))} cells, too few to interpolate", "table-header",
            column="dimensions", offset=0, remedy="use a MERL file of 2 or more cells on each axis",
        )  # fmt: skip
    planes = np.frombuffer(source.buffer, "<f8", offset=_HEADER.size).reshape(3, -1)
    with np.errstate(over="ignore", invalid="ignore"):
        # Transposed, not copied: each channel stays contiguous, which halves the cost of loading.
        value = (planes * np.array(SCALES)[:, None]).T
    notes = [
        "A value belongs to the centre of its cell in index space." if convention == "center"
        else "A value belongs to the lower corner of its cell."
    ]  # fmt: skip
    if dims != DIMS:
        notes.append(f"The grid is {' x '.join(map(str, dims))}, not the database's 90 x 90 x 180.")
    reading = Reading(NAME, "brdf", value, [Channel(c) for c in "RGB"], provenance={"dims": list(dims)})
    return [
        build(
            source,
            options,
            reading,
            convention,
            notes,
            value=value,
            grid=merl_grid(dims, convention),
            symmetric=True,
        )
    ]


def write(table: Table, path: Path) -> list[Loss]:
    """Write a MERL file: the cells of a table on MERL's grid, else values interpolated at its centres.

    Masked cells that are not negative, and cells outside the measured domain, become -1 (unmeasured). One
    channel is written thrice.
    """
    if len(table.channels) not in (1, 3):
        raise unwritable(
            table, f"a MERL file holds three channels and the table has {len(table.channels)}",
            "use delimited text",
        )  # fmt: skip
    losses = [Loss("channels", "The one channel is there three times, as R, G and B.")] * (
        len(table.channels) == 1
    )
    dims, cells, usable = DIMS, table.value, table.mask
    if _is_merl(table.grid):
        assert table.grid is not None
        dims = table.grid.shape
    else:
        if table.symmetry == "anisotropic":
            raise unwritable(
                table,
                "a MERL file holds isotropic surfaces and the table is anisotropic",
                "use delimited text",
            )
        refuse_in_plane(table, "a MERL file")
        cells, usable = _resampled(table, merl_grid(DIMS))
        losses.append(
            Loss(
                "resampled",
                f"{int(usable.sum())} of {len(cells)} cells were interpolated; the rest are unmeasured.",
            )
        )
    # A negative cell is a measurement too: the file can hold it.
    held = usable | ((cells < 0).any(axis=1) & np.isfinite(cells).all(axis=1))
    value = np.where(held[:, None], np.broadcast_to(cells, (len(cells), 3)), np.nan)
    stored = np.where(np.isnan(value), -1.0, value / np.array(SCALES))
    write_aside(path, [_HEADER.pack(*dims), np.ascontiguousarray(stored.T, "<f8").tobytes()])
    return losses


FORMAT = Format(NAME, "MERL binary, RGB on a half-difference grid", CONVENTIONS, sniff, read, write=write)


def _is_merl(grid: Grid | None) -> bool:
    if grid is None or grid.system != "half_difference":
        return False
    centres = merl_grid((grid.shape[0], grid.shape[1], grid.shape[2])).axes
    return all(np.allclose(grid.axes[name], axis, rtol=0, atol=1e-12) for name, axis in centres.items())


def _resampled(table: Table, grid: Grid) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Interpolated values of all cells (n, C), and which lie inside the measured domain, in chunks."""
    values, usable = np.zeros((grid.size, len(table.channels))), np.zeros(grid.size, bool)
    for start in range(0, grid.size, 100_000):
        index = np.arange(start, min(start + 100_000, grid.size))
        wi, wo = grid.directions(index)
        above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
        values[index[above]], outside = table.evaluate(wi[above], wo[above])
        usable[index[above]] = ~outside
    return values, usable


def merl_grid(dims: tuple[int, int, int] = DIMS, convention: str = "center") -> Grid:
    """The grid of ``dims`` (theta_h, theta_d, phi_d) cells.

    The database bins theta_h as floor(n sqrt(theta_h / (pi/2))), theta_d and phi_d linearly over pi/2 and
    pi. A stored value is what the measurements in a bin gave, so "center" puts it at index + 1/2; "corner"
    puts it at the index itself, as some readers do.
    """
    shift = 0.5 if convention == "center" else 0.0
    h, d, p = ((np.arange(n) + shift) / n for n in dims)
    axes: dict[str, NDArray[np.float64]] = {
        "theta_h": h * h * (np.pi / 2), "theta_d": d * (np.pi / 2), "phi_d": p * np.pi
    }  # fmt: skip
    return Grid("half_difference", axes, {"phi_d": np.pi})


def _bytes(dims: tuple[int, ...]) -> int:
    return _HEADER.size + 24 * dims[0] * dims[1] * dims[2]
