"""A table as statements and named columns, from which the readers of declared columns make it again."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter.errors import TableError
from fitter.formats.output import one_line
from fitter.grid import GRID_AXES
from fitter.table import Table

FloatArray = NDArray[np.float64]

_PLAIN = re.compile(r"[A-Za-z0-9.]+")


@dataclass(frozen=True)
class Sheet:
    """What a file of columns has to hold.

    statements : key -> text, all that the columns can't say. notes : sentences, each a line.
    columns : name -> (N,) numbers: geometry (axes in radians or vector components), values, sigma in 1/sr.
    usable : (N,) False for samples masked by their source alone, or None where there are none.
    """

    statements: dict[str, str]
    notes: tuple[str, ...]
    columns: dict[str, FloatArray]
    usable: NDArray[np.bool_] | None


def sheet(table: Table) -> Sheet:
    """``table`` as a :class:`Sheet`. Nothing is left out but that negatives or duplicates were kept."""
    meta = table.metadata
    said: dict[str, str] = {"name": one_line(meta.name)} if meta.name else {}
    said |= {"quantity": "brdf", "convention": "phi_specular_180", "symmetry": table.symmetry}
    for key, number in (
        ("scale_uncertainty", meta.scale_uncertainty), ("angle_uncertainty_rad", meta.angle_uncertainty),
        ("aperture_rad", meta.aperture),
    ):  # fmt: skip
        if number is not None:
            said[key] = repr(float(number))
    said["channels"] = json.dumps(
        [{"name": c.name, "wavelength_nm": c.wavelength_nm} for c in table.channels]
    )
    said["provenance"] = json.dumps(dict(meta.provenance))
    columns: dict[str, FloatArray] = {}
    if table.grid is not None:
        said |= {"grid": table.grid.system, "periodic": json.dumps(dict(table.grid.periodic))}
        names = [f"{axis}_rad" for axis in GRID_AXES[table.grid.system]]
        columns |= dict(zip(names, table.grid.coordinates(), strict=True))
    else:
        for name, w in (("wi", table.wi), ("wo", table.wo)):
            columns |= {f"{name}_{x}": w[:, k] for k, x in enumerate("xyz")}
    # Names that could be mistaken for something else go by number; the channels' line has them all.
    labels = [c.name if _PLAIN.fullmatch(c.name) else str(k) for k, c in enumerate(table.channels)]
    if len(set(labels)) < len(labels):
        labels = [str(k) for k in range(len(labels))]
    columns |= {f"brdf_per_sr_{label}": table.value[:, k] for k, label in enumerate(labels)}
    if table.sigma is not None:
        columns |= {f"sigma_per_sr_{label}": table.sigma[:, k] for k, label in enumerate(labels)}
    lost = _unexplained(table)
    notes = tuple(one_line(note) for note in meta.notes)
    return Sheet(said, notes, columns, ~lost if lost.any() else None)


def _unexplained(table: Table) -> NDArray[np.bool_]:
    """(N,) samples masked by their source alone, or as fill values: a mask has to say so."""
    arrays = {"grid": table.grid} if table.grid is not None else {"wi": table.wi, "wo": table.wo}
    try:
        plain = Table(value=table.value, sigma=table.sigma, **arrays)  # type: ignore[arg-type]
    except TableError:  # nothing would be usable: kept negatives only
        return ~table.mask
    unexplained = plain.mask & ~table.mask
    # A fill value may be negative: a reader that keeps negative values must not take it for one.
    return unexplained if table.fills is None else unexplained | table.fills
