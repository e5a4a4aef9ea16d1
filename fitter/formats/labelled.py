"""A table as arrays over named dimensions, as NetCDF files and xarray hold them: the inverse of
:mod:`fitter.formats.arrays`.

Variables are the columns of delimited text, global attributes its header lines. A coordinate variable stands
for its whole dimension, so a product grid is stored as axes and arrays.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.formats.tabular_writer import sheet
from fitter.grid import GRID_AXES
from fitter.table import Table

FloatArray = NDArray[np.float64]

#: The conventions that the attributes follow.
CONVENTIONS_ATTRIBUTE = "CF-1.11"


@dataclass(frozen=True)
class Labelled:
    """A table as labelled arrays. dimensions : name -> size; coordinates : those that are variables, too.

    variables : name -> (dimensions, array, units). attributes : global ones, text.
    """

    dimensions: Mapping[str, int]
    variables: Mapping[str, tuple[tuple[str, ...], NDArray[Any], str]]
    attributes: Mapping[str, str]


def labelled(table: Table) -> Labelled:
    """``table`` as float64 variables and attributes: :mod:`fitter.formats.arrays` makes it again."""
    content = sheet(table)
    axes: dict[str, FloatArray] = {}
    if table.grid is not None:
        axes = {f"{name}_rad": table.grid.axes[name] for name in GRID_AXES[table.grid.system]}
    dimensions = {name: len(axis) for name, axis in axes.items()} or {"sample": len(table)}
    columns: dict[str, NDArray[Any]] = dict(content.columns)
    if content.usable is not None:
        columns["usable"] = content.usable.astype(np.int8)
    variables: dict[str, tuple[tuple[str, ...], NDArray[Any], str]] = {}
    for name, column in columns.items():
        unit = "radian" if name in axes else "sr-1" if name.startswith(("brdf", "sigma")) else "1"
        if name in axes:
            variables[name] = ((name,), axes[name], unit)
        else:
            variables[name] = (tuple(dimensions), column.reshape(tuple(dimensions.values())), unit)
    attributes = {
        "Conventions": CONVENTIONS_ATTRIBUTE, **content.statements, "notes": json.dumps(content.notes)
    }  # fmt: skip
    return Labelled(dimensions, variables, attributes)
