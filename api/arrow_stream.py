"""Arrow streams: arrays as record batches, one column a field; vectors are lists of fixed size."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from api.problems import Problem

ARROW = "application/vnd.apache.arrow.stream"
#: Rows of a record batch.
ROWS = 1 << 16


def packed(array: NDArray[Any], name: str, about: Mapping[str, str]) -> bytes:
    """A structured array (n,), or a plain one (n,) or (n, C) as the one column ``name``.

    about : becomes the schema's metadata.
    """
    import pyarrow

    columns = {field: array[field] for field in array.dtype.names} if array.dtype.names else {name: array}
    table = pyarrow.table({field: _column(column) for field, column in columns.items()}, metadata=dict(about))
    buffer = BytesIO()
    with pyarrow.ipc.new_stream(buffer, table.schema) as stream:
        stream.write_table(table, max_chunksize=ROWS)
    return buffer.getvalue()


def _column(column: NDArray[Any]) -> Any:
    import pyarrow

    flat = pyarrow.array(np.ascontiguousarray(column).reshape(-1))
    return flat if column.ndim == 1 else pyarrow.FixedSizeListArray.from_arrays(flat, column.shape[1])


def unpacked(body: bytes, names: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """Columns ``names`` of a stream, each (n, 3). Raises Problem."""
    import pyarrow

    try:
        table = pyarrow.ipc.open_stream(body).read_all()
        table.validate(full=True)
    except (pyarrow.ArrowException, OSError, EOFError) as error:
        raise Problem(400, "bad-arrow", f"the body is not an Arrow stream: {error}"[:300]) from error
    if sorted(table.column_names) != sorted(names):
        raise Problem.invalid(
            "bad-request", f"the stream has the columns {', '.join(table.column_names)}"[:300],
            remedy=f"send {' and '.join(names)}, lists of three numbers",
        )  # fmt: skip
    return {name: _vectors(table.column(name), name) for name in names}


def _vectors(column: Any, name: str) -> NDArray[Any]:
    import pyarrow

    kind = column.type
    listed = pyarrow.types.is_list(kind) or pyarrow.types.is_fixed_size_list(kind)
    if not listed or not pyarrow.types.is_floating(kind.value_type) or column.null_count:
        raise _bad(name, str(kind))
    whole = column.combine_chunks()
    flat = whole.flatten()
    even = len(flat) == 3 * len(column) and not flat.null_count
    if pyarrow.types.is_list(kind):
        even = even and bool((np.diff(whole.offsets.to_numpy()) == 3).all())
    if not even:
        raise _bad(name, str(kind))
    return flat.to_numpy(zero_copy_only=False).reshape(-1, 3)


def _bad(name: str, kind: str) -> Problem:
    return Problem.invalid(
        "bad-directions", f"{name} is not a column of vectors, but of {kind}", parameter=name,
        remedy="send lists of three floating-point numbers, none of them null",
    )  # fmt: skip
