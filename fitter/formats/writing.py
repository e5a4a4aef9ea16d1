"""Writing a table in any writable format, and saying what the file does not hold."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from fitter.errors import SpecError
from fitter.formats.loading import load
from fitter.formats.output import one_line
from fitter.formats.registry import Loss, formats
from fitter.masking import FILL
from fitter.table import Table

#: Relative change of a value, or change of a direction, up to which it counts as the same number.
SAME = 1e-12


def write(table: Table, path: str | os.PathLike[str], format: str = "delimited") -> list[Loss]:
    """Write ``table`` to ``path`` and return what the file does not hold.

    The file is read back to find out, so that nothing is merely claimed: what changed beyond 1e-12 is named.
    Values are f_r in 1/sr. Where a measurement takes several files (pab-opto), ``path`` is a folder that must
    be new or empty.

    Raises
    ------
    SpecError : no such format, or it can't be written.
    TableError : the format can't hold such a table at all; the remedy names one that can.
    """
    writable = {entry.name: entry for entry in formats() if entry.write is not None}
    entry = writable.get(format)
    if entry is None or entry.write is None:
        raise SpecError(
            f"{format!r} is no format that can be written", code="unknown-format", parameter="format",
            remedy=f"use one of {', '.join(writable)}",
        )  # fmt: skip
    losses = entry.write(table, Path(path))
    kept = "keep" if (table.value[table.mask] < 0).any() else "mask"
    again = "keep" if table.repeats[table.mask].any() else "mask"
    back = load(path, negatives=kept, duplicates=again)
    if int(back.mask.sum()) < int(table.mask.sum()) and back.metadata.masked.get(FILL):
        unmasked = load(path, negatives=kept, duplicates=again, fills="keep")
        # What this table keeps as measured, and not what the format itself writes for no data.
        back = unmasked if int(unmasked.mask.sum()) <= int(table.mask.sum()) else back
    said = {loss.code for loss in losses}
    if "resampled" in said:
        said |= {"samples", "grid"}
    return [*losses, *(loss for loss in _compared(table, back) if loss.code not in said)]


def _compared(table: Table, back: Table) -> list[Loss]:
    losses: list[Loss] = []

    def lost(code: str, message: str) -> None:
        losses.append(Loss(code, message))

    here, there = int(table.mask.sum()), int(back.mask.sum())
    if here != there:
        lost("samples", f"{here} samples are usable here and {there} in the file.")
    if table.sigma is not None and back.sigma is None:
        lost("sigma", "The standard uncertainties of the values are not in the file.")
    if table.channels != back.channels:
        names = ", ".join(f"{c.name} ({c.wavelength_nm or 'no'} nm)" for c in back.channels)
        lost("channels", f"The file's channels are {names}.")
    if table.symmetry != back.symmetry:
        lost("symmetry", f"The file reads as {back.symmetry}, the table is {table.symmetry}.")
    if table.grid is not None and (back.grid is None or back.grid.system != table.grid.system):
        lost("grid", f"The {table.grid.system} grid is not in the file, only its samples.")
    if table.metadata.name and one_line(table.metadata.name) != back.metadata.name:
        lost("name", "The table's name is not in the file.")
    for name in ("scale_uncertainty", "angle_uncertainty", "aperture"):
        if getattr(table.metadata, name) is not None and getattr(back.metadata, name) is None:
            lost(name, f"The {name.replace('_', ' ')} is not in the file.")
    gone = sorted(set(table.metadata.provenance) - set(back.metadata.provenance) - {"file", "item", "files"})
    if gone:
        lost("provenance", f"Of what was known about the measurement {', '.join(gone)} is not in the file.")
    if len(table) == len(back):
        _compare_numbers(table, back, lost)
    return losses


def _compare_numbers(table: Table, back: Table, lost: Callable[[str, str], None]) -> None:
    index = np.flatnonzero(table.mask & back.mask)
    ours, theirs = table.directions(index), back.directions(index)
    turned = max(float(np.abs(a - b).max(initial=0.0)) for a, b in zip(ours, theirs, strict=True))
    if turned > 1e-6:
        return  # the file has its samples in another order
    if turned > SAME:
        lost("directions", f"Directions are rounded by up to {turned:.1e} rad.")
    a, b = table.value[index], back.value[index]
    if a.shape == b.shape:
        change = np.abs(a - b) / np.maximum(np.abs(a), np.finfo(np.float64).tiny)
        if change.max(initial=0.0) > SAME:
            lost("values", f"Values are rounded by up to {change.max():.1e} of themselves.")
