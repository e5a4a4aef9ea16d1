"""Writing slices as OpenEXR: see :mod:`fitter.formats.openexr` for what stands where."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.formats.output import refuse_in_plane, unwritable, write_aside
from fitter.formats.registry import Loss
from fitter.formats.tabular_writer import sheet
from fitter.grid import Grid
from fitter.table import Table

FloatArray = NDArray[np.float64]

PREFIX, WORD, VERSION = "brdf.", "slices", "1"
#: Axes of slices for each grid system: those of the light, then rows and columns.
AXES: Mapping[str, tuple[str, ...]] = {
    "spherical_isotropic": ("theta_i", "theta_o", "dphi"),
    "spherical": ("theta_i", "phi_i", "theta_o", "phi_o"),
}
#: How many incidences of its own a table is interpolated at, and steps of the outgoing angles (degrees).
_ISOTROPIC, _ANISOTROPIC = (60, 2.0, 2.0), (10, 3.0, 6.0)
_AZIMUTHS = 24
#: So many of the table's samples are compared with what the file says of them.
_COMPARED = 4000
_PLAIN = re.compile(r"[A-Za-z0-9_-]{1,100}")


def write(table: Table, path: Path) -> list[Loss]:
    """Write the slices of a table on a grid of incidences, as float32; others are interpolated on one.

    Raises TableError for a table of one plane, or of too few directions, and for values beyond float32.
    """
    losses: list[Loss] = []
    if table.grid is None or table.grid.system not in AXES:
        table, loss = _resampled(table)
        losses.append(loss)
    assert table.grid is not None
    content = sheet(table)
    columns = {name: column for name, column in content.columns.items() if name.startswith(("brdf", "sigma"))}
    if content.usable is not None:
        columns["usable"] = content.usable.astype(np.float64)
    largest = float(np.finfo(np.float32).max)
    for name, column in columns.items():
        if (np.abs(column[np.isfinite(column)]) > largest).any():
            raise unwritable(table, f"{name} has a value larger than a float32 can be", "use delimited text")
    pixels = {name: _pixel_name(name, k) for k, name in enumerate(columns)}
    if len(set(pixels.values())) < len(pixels):
        pixels = {name: f"c{k}" for k, name in enumerate(columns)}
    names = AXES[table.grid.system]
    incident, outgoing = names[:-2], names[-2:]
    said = {
        WORD: VERSION, "holds": "f_r in 1/sr, without the cosine", "system": table.grid.system,
        "pixels": json.dumps(pixels), **content.statements, "notes": json.dumps(content.notes),
        **{name: json.dumps(table.grid.axes[name].tolist()) for name in outgoing},
    }  # fmt: skip
    shape = table.grid.shape
    light = np.meshgrid(*(table.grid.axes[name] for name in incident), indexing="ij")
    angles = np.stack([c.reshape(-1) for c in light], axis=1)
    stacks = {name: column.reshape(len(angles), *shape[-2:]) for name, column in columns.items()}
    where = [dict(zip(incident, row, strict=True)) for row in angles.tolist()]
    write_aside(path, [_file(said, where, {pixels[name]: stack for name, stack in stacks.items()})])
    return losses


def _pixel_name(name: str, k: int) -> str:
    """What a column's channel is called: as pictures are for R, G and B, sigmas in a layer of their own."""
    kind, _, channel = name.partition("_per_sr_")
    if not channel:
        return name
    word = channel if _PLAIN.fullmatch(channel) else f"c{k}"
    return word if kind == "brdf" else f"sigma.{word}"


def _file(said: Mapping[str, str], where: list[dict[str, float]], stacks: Mapping[str, FloatArray]) -> bytes:
    """The file's bytes: ``said`` in the header of the first part, the light's angles (radians) in each."""
    import OpenEXR

    parts: list[Any] = []
    for k, light in enumerate(where):
        header: dict[str, Any] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        header |= {PREFIX + name: repr(angle) for name, angle in light.items()}
        if k == 0:
            header |= {PREFIX + key: text for key, text in said.items()}
        with np.errstate(over="ignore", under="ignore"):
            pictures = {name: np.ascontiguousarray(stack[k], np.float32) for name, stack in stacks.items()}
        label = " ".join(f"{name}={np.rad2deg(angle):.4f}" for name, angle in light.items())
        parts.append(OpenEXR.Part(header, pictures, f"{k:04d} {label}"))
    sink = BytesIO()
    OpenEXR.File(parts).write(sink)
    return sink.getvalue()


def _resampled(table: Table) -> tuple[Table, Loss]:
    """The table interpolated on a grid of incidences, and how far that is from its own samples."""
    refuse_in_plane(table, "a file of slices")
    index = np.flatnonzero(table.mask)
    wi, wo = table.directions(index)
    theta, phi = directions.spherical_from_vector(wi)
    isotropic = table.symmetry == "isotropic"
    most, polar, turn = _ISOTROPIC if isotropic else _ANISOTROPIC
    azimuth = np.deg2rad(np.arange(0.0, 360.0, turn))
    axes = {"theta_i": _nodes(theta, most)}
    if not isotropic:
        axes["phi_i"] = _nodes(phi[theta > 1e-3], _AZIMUTHS)
    axes["theta_o"] = np.deg2rad(np.arange(0.0, 90.0, polar))
    axes["dphi" if isotropic else "phi_o"] = azimuth
    system = "spherical_isotropic" if isotropic else "spherical"
    grid = Grid(system, axes, {"dphi" if isotropic else "phi_o": 2 * np.pi})
    value, outside = table.evaluate(*grid.directions())
    value = np.where(outside[:, None] | ~np.isfinite(value), np.nan, value)
    measured = int(np.isfinite(value).all(axis=1).sum())
    if measured == 0:
        raise unwritable(
            table, "the table has too few directions for each incidence to interpolate between them",
            "use delimited text",
        )  # fmt: skip
    slices = Table(
        grid=grid, value=value, channels=table.channels, symmetry=table.symmetry, metadata=table.metadata,
        negatives="keep",
    )  # fmt: skip
    index = index[np.unique(np.linspace(0, len(index) - 1, _COMPARED).astype(np.intp))]
    wi, wo = table.directions(index)
    there, beyond = slices.evaluate(wi, wo)
    here = table.value[index]
    known = ~beyond & (here > 0).all(axis=1) & np.isfinite(there).all(axis=1)
    change = np.abs(there - here)[known] / here[known]
    half, top = np.quantile(change, [0.5, 0.95]) if change.size else (np.nan, np.nan)
    incidences = grid.size // (len(azimuth) * len(axes["theta_o"]))
    return slices, Loss(
        "resampled",
        f"{measured} of {grid.size} samples at {incidences} incidences were interpolated; the others lie "
        "outside what was measured. Read between its samples the file differs from the table's own values by "
        f"{half:.1%} in the median, by {top:.1%} at most for 95 % of them.",
    )


def _nodes(own: FloatArray, most: int) -> FloatArray:
    """The table's own angles, or evenly spaced ones where it has too many."""
    nodes = np.unique(np.round(own, 7))
    return nodes if len(nodes) <= most else np.linspace(float(nodes[0]), float(nodes[-1]), most)
