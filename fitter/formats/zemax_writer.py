"""Writing Zemax BSDF interchange text: exact where the samples lie on such a grid, else interpolated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.formats import specular
from fitter.formats.output import measured, one_line, one_or_tristimulus, unwritable, write_aside
from fitter.formats.registry import Loss
from fitter.table import Table

FloatArray = NDArray[np.float64]

#: Axes of an interpolated file, degrees: close about the specular ray, where the lobe is.
_AZIMUTH = np.arange(0.0, 181.0, 10.0)
_RADIAL = np.concatenate([[0, 0.5, 1, 1.5, 2, 3, 4, 5, 7, 10, 12.5, 15, 17.5], np.arange(20.0, 181.0, 5.0)])
_INCIDENCES = 40


@dataclass(frozen=True)
class _Grid:
    """Axes in degrees and values (rotations, incidences, azimuths, radials, channels), 0 where unmeasured."""

    rotation: FloatArray
    incidence: FloatArray
    azimuth: FloatArray
    radial: FloatArray
    values: FloatArray


def write_zemax(table: Table, path: Path) -> list[Loss]:
    """Write ``table``, values with full digits; zeros stand for what was not measured.

    A table whose samples don't lie on a polar grid about the specular ray is interpolated on one, at its own
    incidences (isotropic tables only). Negative values become 0.
    """
    xyz = one_or_tristimulus(table, "Zemax")
    grid, losses = _placed(table), []
    if grid is None:
        grid, losses = _interpolated(table)
    if table.domain.in_plane:
        losses.append(
            Loss("in_plane", "Only the plane of incidence is in the file: programs make up the rest of the "
                 "hemisphere from it.")
        )  # fmt: skip
    negative = int(np.count_nonzero(grid.values < 0))
    if negative:
        losses.append(
            Loss("negative", f"{negative} negative values are 0 in the file, which reads as unmeasured.")
        )
    write_aside(path, (f"{line}\n".encode() for line in _lines(table, grid, xyz)))
    return losses


def _placed(table: Table) -> _Grid | None:
    """The samples on their own polar grid, or None where they fill too little of one."""
    samples, _ = measured(table)
    radial, azimuth = specular.coordinates(samples.theta_i, samples.phi_i, samples.wo)
    columns = [_turn(-samples.phi_i), _degrees(samples.theta_i), _turn(azimuth), _degrees(radial)]
    at_pole = columns[3] < 1e-6
    columns[3][at_pole] = 0.0
    axes = [np.unique(c) for c in columns]
    axes[2] = np.unique(columns[2][~at_pole]) if not at_pole.all() else np.zeros(1)
    shape = tuple(len(axis) for axis in axes)
    expected = float(np.prod([float(n) for n in shape]))
    # Half of a polar grid may lie below the horizon.
    if len(samples.value) < 0.35 * expected:
        return None
    values = np.zeros((*shape, len(table.channels)))
    where = [np.searchsorted(axis, c) for axis, c in zip(axes, columns, strict=True)]
    pole = np.flatnonzero(at_pole)
    off = np.flatnonzero(~at_pole)
    # The first of a repeated geometry is the one that counts: written last.
    values[where[0][pole[::-1]], where[1][pole[::-1]], :, 0] = samples.value[pole[::-1], None, :]
    values[tuple(w[off[::-1]] for w in where)] = samples.value[off[::-1]]
    return _Grid(axes[0], axes[1], axes[2], axes[3], values)


def _degrees(angle: FloatArray) -> FloatArray:
    """Degrees to 1e-7, by which nodes are told apart: text tables hold no more."""
    return np.asarray(np.round(np.rad2deg(angle), 7), np.float64)


def _turn(angle: FloatArray) -> FloatArray:
    """Degrees in [0, 360)."""
    return np.asarray(np.mod(_degrees(angle), 360.0), np.float64).round(7) % 360.0


def _interpolated(table: Table) -> tuple[_Grid, list[Loss]]:
    if table.symmetry == "anisotropic":
        raise unwritable(
            table, "the table is anisotropic and does not lie on a polar grid about the specular ray",
            "use delimited text",
        )  # fmt: skip
    index = np.flatnonzero(table.mask)
    theta_i = np.unique(_degrees(directions.spherical_from_vector(table.directions(index)[0])[0]))
    if len(theta_i) > _INCIDENCES:
        theta_i = np.linspace(float(theta_i[0]), float(theta_i[-1]), _INCIDENCES)
    i, a, r = np.meshgrid(np.deg2rad(theta_i), np.deg2rad(_AZIMUTH), np.deg2rad(_RADIAL), indexing="ij")
    wo = specular.outgoing(i, 0.0, r, a).reshape(-1, 3)
    wi = directions.vector_from_spherical(i, 0.0).reshape(-1, 3)
    values = np.zeros((len(wo), len(table.channels)))
    above = np.flatnonzero(wo[:, 2] > 0)
    found, outside = table.evaluate(wi[above], wo[above])
    values[above] = np.where(outside[:, None], 0.0, found)
    known = int(np.count_nonzero(~outside))
    grid = _Grid(
        np.zeros(1), np.asarray(theta_i, np.float64), _AZIMUTH, _RADIAL, values.reshape(1, *i.shape, -1)
    )
    return grid, [Loss("resampled", f"{known} values were interpolated about the specular ray.")]


def _lines(table: Table, grid: _Grid, xyz: bool) -> Iterator[str]:
    half = grid.azimuth.max() <= 180.0
    several = len(grid.rotation) > 1
    (channel,) = table.channels if not xyz else (table.channels[0],)
    yield f"# {one_line(table.metadata.name)}"
    yield "# f_r in 1/sr, without the cosine"
    if channel.wavelength_nm is not None:
        yield f"# wavelength: {channel.wavelength_nm!r} nm"
    yield "Source\tMeasured"
    yield f"Symmetry\t{'ASymmetrical4D' if several else 'PlaneSymmetrical' if half else 'ASymmetrical'}"
    yield f"SpectralContent\t{'XYZ' if xyz else 'Monochrome'}"
    yield "ScatterType\tBRDF"
    for key, axis in (
        ("SampleRotation", grid.rotation), ("AngleOfIncidence", grid.incidence),
        ("ScatterAzimuth", grid.azimuth), ("ScatterRadial", grid.radial),
    ):  # fmt: skip
        yield f"{key}\t{len(axis)}"
        yield "\t".join(map(repr, axis.tolist()))
    yield ""
    for k, content in enumerate([f"Tristimulus{c}" for c in "XYZ"] if xyz else ["Monochrome"]):
        yield content
        yield "DataBegin"
        for r in range(len(grid.rotation)):
            for i in range(len(grid.incidence)):
                block = np.maximum(grid.values[r, i, :, :, k], 0.0)
                yield f"TIS\t{_scattered(grid, i, block, half):.6g}"
                for row in block.tolist():
                    yield "\t".join(map(repr, row))
        yield "DataEnd"


def _scattered(grid: _Grid, i: int, block: FloatArray, half: bool) -> float:
    """Total integrated scatter: f cos(theta_o) over the measured solid angle, by the trapezoidal rule."""
    if len(grid.azimuth) < 2 or len(grid.radial) < 2:
        return 0.0
    azimuth, radial = np.deg2rad(grid.azimuth), np.deg2rad(grid.radial)
    wo = specular.outgoing(np.deg2rad(grid.incidence[i]), 0.0, radial[None, :], azimuth[:, None])
    integrand = block * np.maximum(wo[..., 2], 0.0) * np.sin(radial)
    turn = np.trapezoid(np.trapezoid(integrand, radial, axis=1), azimuth)
    if half:
        return 2.0 * float(turn)
    closing = 2 * np.pi - (azimuth[-1] - azimuth[0])
    ends = np.trapezoid(integrand[[-1, 0]], radial, axis=1).mean()
    return float(turn + closing * ends)
