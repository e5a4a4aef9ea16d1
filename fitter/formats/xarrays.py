"""xarray: Datasets and DataArrays, whose variables mean what those of a NetCDF file mean, and back."""

from __future__ import annotations

from typing import Any

import numpy as np

from fitter.formats.extras import optional_package
from fitter.formats.labelled import Variable, labelled, read_labelled
from fitter.formats.read_options import ReadOptions
from fitter.formats.source import Source
from fitter.table import Table


def read_dataset(source: Source, given: Any, options: ReadOptions) -> list[Table]:
    """Tables in an ``xarray.Dataset``, or in a DataArray that has a name: as in :func:`read_labelled`.

    Attributes are those of the file the dataset came from, or set by hand; xarray has unpacked numbers and
    fill values already. Raises TableError.
    """
    dataset = given
    if not hasattr(given, "data_vars"):
        if given.name is None:
            raise source.error(
                "the DataArray has no name, and so does not say what its values are", "table-columns",
                remedy="set its name, as array.name = 'brdf', or give a Dataset",
            )  # fmt: skip
        # Statements on the array alone are statements about the table.
        dataset = given.to_dataset().assign_attrs(given.attrs)
    variables = [
        Variable(
            str(name), tuple(str(over) for over in one.dims), np.asarray(one.values),
            {str(key): value for key, value in one.attrs.items()},
        )
        for name, one in dataset.variables.items()
    ]  # fmt: skip
    said = {str(key): str(value) for key, value in dataset.attrs.items()}
    return read_labelled(source, options, variables, said, format="xarray")


def dataset(table: Table) -> Any:
    """``table`` as an ``xarray.Dataset``: a grid's axes are coordinates. TableError without xarray.

    :func:`fitter.load` makes the same table of it again, bit for bit.
    """
    xarray = optional_package("xarray", None, "datasets of xarray", table.metadata.name or None)
    content = labelled(table)
    made = {
        name: (over, array, {"units": unit}) for name, (over, array, unit) in content.variables.items()
    }  # fmt: skip
    axes = {name: made.pop(name) for name in content.dimensions if name in made}
    return xarray.Dataset(made, coords=axes, attrs=dict(content.attributes))
