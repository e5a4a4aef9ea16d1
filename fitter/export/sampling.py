"""A subject as the table that a format's writer takes: sampled on the grid of the format."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitter.errors import SpecError
from fitter.export.fidelity import fidelity
from fitter.export.registry import Written
from fitter.export.subject import Subject
from fitter.formats.output import refuse_in_plane
from fitter.formats.registry import Format
from fitter.grid import Grid
from fitter.metadata import Metadata
from fitter.table import Table

FloatArray = NDArray[np.float64]

_CHUNK = 1 << 18


def isotropic(subject: Subject, target: str) -> None:
    """Raise SpecError for an anisotropic surface."""
    if subject.symmetry == "anisotropic":
        raise SpecError(
            f"{target} holds isotropic surfaces and this one is anisotropic", code="export-anisotropic",
            parameter="to", remedy="export it as rgl, which holds both",
        )  # fmt: skip


def hemisphere(subject: Subject, target: str) -> None:
    """Raise TableError for a table of the plane of incidence only."""
    if subject.table is not None:
        refuse_in_plane(subject.table, target)


def on_grid(subject: Subject, grid: Grid) -> Table:
    """A table of the subject's values at the grid's cells, NaN where a direction is below the horizon."""
    value = np.full((grid.size, len(subject.channels)), np.nan)
    for start in range(0, grid.size, _CHUNK):
        index = np.arange(start, min(start + _CHUNK, grid.size))
        wi, wo = grid.directions(index)
        above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
        value[index[above]] = subject.evaluate(wi[above], wo[above])[0]
    return Table(
        grid=grid, value=value, channels=subject.channels, symmetry=subject.symmetry,
        metadata=_metadata(subject),
    )  # fmt: skip


def on_pairs(subject: Subject, wi: FloatArray, wo: FloatArray) -> Table:
    """A scattered table of the subject's values at pairs (M, 3)."""
    return Table(
        wi=wi, wo=wo, value=subject.evaluate(wi, wo)[0], channels=subject.channels,
        symmetry=subject.symmetry, metadata=_metadata(subject),
    )  # fmt: skip


def polar_grid(theta_i: FloatArray, theta_o: FloatArray, azimuths: int) -> Grid:
    """An isotropic grid of polar angles (radians) and ``azimuths`` even ones of the whole turn."""
    dphi = np.linspace(0.0, 2 * np.pi, azimuths, endpoint=False)
    axes = {"theta_i": theta_i, "theta_o": theta_o, "dphi": dphi}
    return Grid("spherical_isotropic", axes, {"dphi": 2 * np.pi})


def written_by(format: Format, table: Table, subject: Subject, path: Path) -> Written:
    """Write ``table`` with a format's writer; its losses, and how far the file is from the subject."""
    assert format.write is not None, format.name
    losses = format.write(table, path)
    return Written((*losses, fidelity(subject, path)))


def _metadata(subject: Subject) -> Metadata:
    model = subject.model
    assert model is not None
    provenance: dict[str, object] = {"model": model.spec.name, "source": " ".join(subject.comments())}
    return Metadata(name=subject.name, source_format="model", provenance=provenance)


def degrees(angles: Sequence[float] | FloatArray) -> FloatArray:
    """Radians of degrees."""
    return np.deg2rad(np.asarray(angles, np.float64))
