"""NVIDIA MBSDF: isotropic reflectance over cells of theta_in, theta_out and the azimuth between them.

A line ``NVIDIA ARC MBSDF V1``, lines of metadata, then for each part a line ``MBSDF_DATA_REFLECTION=`` (or
``MBSDF_DATA=``) or ``MBSDF_DATA_TRANSMISSION=`` and its block: three little-endian uint32 (0 for one
channel or 1 for RGB, cells of theta, cells of phi) and float32 values in 1/sr, the channel running fastest,
then phi, then theta_out (the MDL SDK's own importer, github.com/NVIDIA/MDL-SDK).
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from fitter.formats.assemble import Reading, build, stated_quantity, to_brdf
from fitter.formats.fills import no_data
from fitter.formats.output import unwritable, write_aside
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format, Loss
from fitter.formats.source import Source
from fitter.grid import Grid
from fitter.metadata import Channel
from fitter.table import Table

NAME = "mbsdf"
MAGIC = b"NVIDIA ARC MBSDF V1\n"
_REFLECTION = (b"MBSDF_DATA_REFLECTION=", b"MBSDF_DATA=")
_TRANSMISSION = b"MBSDF_DATA_TRANSMISSION="
_BLOCK = struct.Struct("<3I")
#: A line of metadata is no longer than this (the importer's own limit).
_LONGEST_LINE = 1024
#: Largest value that a file can hold.
_LARGEST = float(np.finfo(np.float32).max)


def sniff(head: bytes, size: int) -> float:
    """Sure by the first line."""
    return 1.0 if head.startswith(MAGIC) else 0.0


def read(source: Source, options: ReadOptions) -> list[Table]:
    """The table of the reflection part on its grid, a value at the centre of its cell."""
    quantity, notes = stated_quantity(options, "brdf", "f_r in 1/sr")
    data = source.buffer
    lines, at = _lines(source, len(MAGIC))
    if lines and lines[-1] == _TRANSMISSION:
        raise source.no_table(
            "the file holds transmission only", "table-transmission", "transmission",
            column="MBSDF_DATA_TRANSMISSION", offset=at,
            remedy="use the file of the same sample's reflection",
        )  # fmt: skip
    (channels, theta, phi), end = _block(source, at)
    rest = bytes(data[end : end + len(_TRANSMISSION) + 1])
    if rest == _TRANSMISSION + b"\n":
        _, end = _block(source, end + len(rest))
        notes.append("The transmission part was not read.")
        rest = bytes(data[end : end + 1])
    if rest:
        raise source.error(
            "the file goes on after its last value", "table-header", column="MBSDF_DATA",
            offset=end, cause="the counts don't fit the values", remedy="fetch the file again",
        )  # fmt: skip
    if theta < 2 or phi < 2:
        raise source.error(
            f"the grid has {theta} x {theta} x {phi} cells, too few to interpolate", "table-header",
            offset=at, remedy="use a file of 2 or more cells on each axis",
        )  # fmt: skip
    grid = mbsdf_grid(theta, phi)
    stored = np.frombuffer(data, "<f4", grid.size * channels, at + _BLOCK.size).reshape(grid.size, channels)
    with np.errstate(invalid="ignore"):
        value = stored.astype(np.float64)
    notes.append("A value belongs to the centre of its cell; azimuths between pi and 2 pi mirror the rest.")
    fills, about_fills = no_data(value, options.fills)
    notes += about_fills
    if quantity != "brdf":
        cos_o = np.cos(np.broadcast_to(grid.axes["theta_o"][None, :, None], grid.shape)).reshape(-1)
        value = to_brdf(value, quantity, cos_o)
    named = [Channel(c) for c in "RGB"] if channels == 3 else [Channel("value")]
    metadata = [line.decode(errors="replace") for line in lines[:-1]]
    reading = Reading(
        NAME, quantity, value, named,
        provenance={"cells": list(grid.shape), **({"metadata": metadata} if metadata else {})},
    )  # fmt: skip
    return [
        build(
            source, options, reading, "center", notes, value=value, grid=grid, fills=fills, symmetric=True
        )
    ]  # fmt: skip


def write(table: Table, path: Path) -> list[Loss]:
    """Write the cells of a table that lies on such a grid, as float32.

    Masked cells become 0, except negative ones, which the file can hold. Raises TableError for
    any other table.
    """
    grid = table.grid
    if len(table.channels) not in (1, 3):
        raise unwritable(
            table, f"an MBSDF file holds one or three channels and the table has {len(table.channels)}",
            "use delimited text",
        )  # fmt: skip
    if grid is None or not _is_mbsdf(grid):
        raise unwritable(
            table, "an MBSDF file holds a grid of cell centres in theta_i, theta_o and dphi, which the table "
            "does not lie on", "use delimited text, or merl, which interpolates",
        )  # fmt: skip
    finite = np.isfinite(table.value).all(axis=1)
    held = (table.mask | (table.value < 0).any(axis=1)) & finite
    stored = np.where(held[:, None], table.value, 0.0)
    if np.abs(stored).max() > _LARGEST:
        raise unwritable(table, "a value is larger than a float32 can be", "use delimited text")
    losses: list[Loss] = []
    if not held.all():
        gone = int(np.count_nonzero(~held))
        losses.append(Loss("samples", f"{gone} masked cells are 0 in the file, which reads as measured."))
    head = _BLOCK.pack(len(table.channels) == 3, grid.shape[0], grid.shape[2])
    write_aside(path, [MAGIC, _REFLECTION[0] + b"\n", head, np.ascontiguousarray(stored, "<f4").tobytes()])
    return losses


FORMAT = Format(NAME, "NVIDIA MBSDF, cells of theta_in, theta_out and azimuth", (), sniff, read, write=write)


def mbsdf_grid(theta: int, phi: int) -> Grid:
    """The centres of ``theta`` cells on [0, pi/2) for each direction and ``phi`` cells on [0, pi]."""
    polar = (np.arange(theta) + 0.5) / theta * (np.pi / 2)
    azimuth = (np.arange(phi) + 0.5) / phi * np.pi
    return Grid("spherical_isotropic", {"theta_i": polar, "theta_o": polar.copy(), "dphi": azimuth})


def _is_mbsdf(grid: Grid) -> bool:
    if grid.system != "spherical_isotropic" or grid.shape[0] != grid.shape[1] or min(grid.shape) < 2:
        return False
    centres = mbsdf_grid(grid.shape[0], grid.shape[2]).axes
    return all(np.allclose(grid.axes[name], axis, rtol=0, atol=1e-9) for name, axis in centres.items())


def _lines(source: Source, at: int) -> tuple[list[bytes], int]:
    """The lines from ``at`` up to the one before a block, without their ends, and where the block begins."""
    data = source.buffer
    lines: list[bytes] = []
    while not lines or lines[-1] not in (*_REFLECTION, _TRANSMISSION):
        piece = bytes(data[at : at + _LONGEST_LINE])
        end = piece.find(b"\n")
        if end < 0:
            raise source.error(
                "the file has no line MBSDF_DATA_REFLECTION=", "table-header",
                row=len(lines) + 2, offset=at, cause="a damaged header, or a file that is cut off",
                remedy="fetch the file again",
            )  # fmt: skip
        lines.append(piece[:end])
        at += end + 1
    return lines, at


def _block(source: Source, at: int) -> tuple[tuple[int, int, int], int]:
    """(channels, cells of theta, cells of phi) of the block at ``at``, and where it ends."""
    kind = theta = phi = 0
    if at + _BLOCK.size <= source.size:
        kind, theta, phi = _BLOCK.unpack_from(source.buffer, at)
    if kind > 1:
        raise source.error(
            f"the block has the unknown type {kind}", "table-header", column="type", offset=at,
            cause="a damaged header", remedy="fetch the file again",
        )  # fmt: skip
    channels = 3 if kind == 1 else 1
    end = at + _BLOCK.size + 4 * theta * theta * phi * channels
    if end > source.size:
        raise source.error(
            f"the header claims {theta} x {theta} x {phi} cells of {channels} values, {end:,} bytes, and the "
            f"file has {source.size:,}", "table-truncated", column="MBSDF_DATA", offset=at,
            cause="the file is cut off", remedy="fetch the file again",
        )  # fmt: skip
    return (channels, theta, phi), end
