"""Writing a table as self-describing delimited text that reads back bit for bit."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fitter.errors import TableError
from fitter.formats.output import one_line, write_aside
from fitter.grid import GRID_AXES
from fitter.table import Table

_PLAIN = re.compile(r"[A-Za-z0-9.]+")


def write_delimited(table: Table, path: str | os.PathLike[str]) -> None:
    """Write ``table`` to ``path`` as comma-separated text, aside first and then renamed.

    Directions of scattered tables are vector components, those of grids their axes in radians; numbers
    have as many digits as a float64 needs, so geometry, values, sigma, channels, mask and hash come back
    exactly. Values are f_r in 1/sr. A table that keeps negatives or duplicates must be read so again.
    """
    write_aside(path, (f"{line}\n".encode() for line in _lines(table)))


def _lines(table: Table) -> Iterator[str]:
    meta = table.metadata
    if meta.name:
        yield f"# name: {one_line(meta.name)}"
    yield "# quantity: brdf"
    yield "# convention: phi_specular_180"
    yield f"# symmetry: {table.symmetry}"
    for key, number in (
        ("scale_uncertainty", meta.scale_uncertainty), ("angle_uncertainty_rad", meta.angle_uncertainty),
        ("aperture_rad", meta.aperture),
    ):  # fmt: skip
        if number is not None:
            yield f"# {key}: {float(number)!r}"
    listed = [{"name": c.name, "wavelength_nm": c.wavelength_nm} for c in table.channels]
    yield f"# channels: {json.dumps(listed)}"
    yield f"# provenance: {json.dumps(dict(meta.provenance))}"
    for note in meta.notes:
        yield f"# note: {one_line(note)}"
    names: list[str] = []
    blocks: list[NDArray[np.float64]] = []
    if table.grid is not None:
        yield f"# grid: {table.grid.system}"
        yield f"# periodic: {json.dumps(dict(table.grid.periodic))}"
        names += [f"{axis}_rad" for axis in GRID_AXES[table.grid.system]]
        blocks += list(table.grid.coordinates())
    else:
        for name, w in (("wi", table.wi), ("wo", table.wo)):
            names += [f"{name}_{x}" for x in "xyz"]
            blocks += list(w.T)
    # Names that could be mistaken for something else go by number; the line above has them all.
    labels = [c.name if _PLAIN.fullmatch(c.name) else str(k) for k, c in enumerate(table.channels)]
    if len(set(labels)) < len(labels):
        labels = [str(k) for k in range(len(labels))]
    names += [f"brdf_per_sr_{label}" for label in labels]
    blocks += list(table.value.T)
    if table.sigma is not None:
        names += [f"sigma_per_sr_{label}" for label in labels]
        blocks += list(table.sigma.T)
    lost = _unexplained(table)
    if lost.any():
        names.append("usable")
    yield f"# rows: {len(table)}"
    yield ",".join(names)
    for k, numbers in enumerate(zip(*(block.tolist() for block in blocks), strict=True)):
        cells = [repr(number) for number in numbers]
        if lost.any():
            cells.append("0" if lost[k] else "1")
        yield ",".join(cells)


def _unexplained(table: Table) -> NDArray[np.bool_]:
    """(N,) samples masked by their source alone: those the same arrays without a mask would keep."""
    arrays = {"grid": table.grid} if table.grid is not None else {"wi": table.wi, "wo": table.wo}
    try:
        plain = Table(value=table.value, sigma=table.sigma, **arrays)  # type: ignore[arg-type]
    except TableError:  # nothing would be usable: kept negatives only
        return ~table.mask
    return plain.mask & ~table.mask
