"""xarray: Datasets and DataArrays, whose variables mean what those of a NetCDF file mean, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.formats.arrays import Variable, tables_of
from fitter.formats.extras import optional_package
from fitter.formats.labelled import labelled
from fitter.formats.read_options import ReadOptions
from fitter.formats.source import Source
from fitter.table import Table


def read_dataset(source: Source, given: Any, options: ReadOptions) -> list[Table]:
    """Tables in an ``xarray.Dataset``, or in a DataArray that has a name: as in :func:`tables_of`.

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
    variables = [_variable(str(name), one) for name, one in dataset.variables.items()]
    said = {str(key): str(value) for key, value in dataset.attrs.items()}
    return tables_of(source, options, variables, said, format="xarray")


def _variable(name: str, one: Any) -> Variable:
    data: NDArray[Any] = np.asarray(one.values)
    text = data.dtype.kind not in "biuf"

    def words() -> NDArray[Any]:
        flat = [
            word.decode("utf-8", "replace") if isinstance(word, bytes) else str(word)
            for word in data.reshape(-1).tolist()
        ]  # fmt: skip
        return np.asarray([word.strip("\0 ") for word in flat], object).reshape(data.shape)

    return Variable(
        name, tuple(str(over) for over in one.dims), data.shape,
        {str(key): value for key, value in one.attrs.items()}, words if text else lambda: data, text,
    )  # fmt: skip


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
