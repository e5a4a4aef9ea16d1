"""What the writers share: files put in place whole, and a table's samples as angles."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.errors import TableError
from fitter.formats.registry import Loss
from fitter.table import Table

FloatArray = NDArray[np.float64]


def write_aside(path: str | os.PathLike[str], parts: Iterable[bytes]) -> None:
    """Write ``parts`` to a file beside ``path``, then rename it: ``path`` is never half a file."""
    target = Path(path)
    aside = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with aside.open("wb") as file:
            file.writelines(parts)
            file.flush()
            os.fsync(file.fileno())
        aside.replace(target)
    finally:
        aside.unlink(missing_ok=True)


def one_line(text: str) -> str:
    """``text`` without line breaks and runs of white space."""
    return " ".join(text.split())


@dataclass(frozen=True)
class Samples:
    """Samples as angles (n,) in radians and values (n, C) in 1/sr, for formats that have no mask."""

    theta_i: FloatArray
    phi_i: FloatArray
    theta_o: FloatArray
    phi_o: FloatArray
    value: FloatArray
    wo: FloatArray


def measured(table: Table) -> tuple[Samples, list[Loss]]:
    """The samples that a format without a mask can hold: all but missing ones and those marked unusable.

    Negative values and repeated geometries stay: a reader finds them by itself.
    """
    keep = table.mask | ((table.value < 0).any(axis=1) & np.isfinite(table.value).all(axis=1))
    keep |= table.repeats & np.isfinite(table.value).all(axis=1)
    if table.fills is not None:
        keep &= ~table.fills
    index = np.flatnonzero(keep)
    wi, wo = table.directions(index)
    above = (wi[:, 2] > 0) & (wo[:, 2] >= 0)
    index, wi, wo = index[above], wi[above], wo[above]
    theta_i, phi_i = directions.spherical_from_vector(wi)
    theta_o, phi_o = directions.spherical_from_vector(wo)
    left_out = len(table) - len(index)
    losses = [Loss("samples", f"{left_out} masked samples were left out: the format can't mark them.")] * (
        left_out > 0
    )
    return Samples(theta_i, phi_i, theta_o, phi_o, table.value[index], wo), losses


def one_or_tristimulus(table: Table, format: str) -> bool:
    """Whether the channels are X, Y, Z. Raises TableError unless they are, or there is one channel."""
    names = [channel.name for channel in table.channels]
    if names == ["X", "Y", "Z"]:
        return True
    if len(names) == 1:
        return False
    raise TableError(
        f"a {format} file holds one channel or X, Y, Z, and the table has {', '.join(names)[:80]}",
        code="table-unwritable", parameter="format", file=table.metadata.name or None,
        remedy="write each channel as a table of its own, or use delimited text",
    )  # fmt: skip


def refuse_in_plane(table: Table, file: str) -> None:
    """Raise TableError for a table of the plane of incidence only, which would be made up beside it."""
    if table.domain.in_plane:
        raise unwritable(
            table, f"{file} holds the whole hemisphere and the table only the plane of incidence",
            "use delimited text, or fit a model",
        )  # fmt: skip


def unwritable(table: Table, message: str, remedy: str) -> TableError:
    """A TableError for a table that a format can't hold."""
    return TableError(
        message, code="table-unwritable", parameter="format", file=table.metadata.name or None, remedy=remedy
    )
