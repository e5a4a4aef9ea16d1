"""Files read and checked, against the libraries that only parse them: time, and memory at the most."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import fitter
from fitter.directions import spherical_from_vector
from fitter.formats.merl import SCALES
from tests.bench import memory, plain, tables
from tests.bench.measuring import Row, Size, alternate

SEED = 2
COLUMNS = ("theta_i_deg", "phi_i_deg", "theta_o_deg", "phi_o_deg", "brdf_R", "brdf_G", "brdf_B")
HEADER = ",".join(COLUMNS)


def run(size: Size) -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as name:
        yield _merl(Path(name) / "table.binary", size)
        yield _delimited(Path(name) / "table.csv", size)
        yield from _large(Path(name), size)


def _merl(path: Path, size: Size) -> Row:
    table = tables.merl("ward", size.pick(tables.MERL, tables.SMALL), SEED)
    tables.write_merl(table, path)
    scale = np.array(SCALES)[:, None]
    times = alternate(
        {
            "ours": lambda: fitter.load(path),
            # The digest of the bytes is taken afterwards, in a thread: here it is waited for.
            "hashed": lambda: fitter.load(path).metadata.sha256,
            "numpy": lambda: np.fromfile(path, "<f8", offset=12).reshape(3, -1) * scale,
        },
        size.pick(11, 2),
    )
    loaded = times["ours"].result
    return Row(
        case="load a MERL file",
        ours=times["ours"].seconds("fitter.load: read, mask, describe"),
        others=(times["numpy"].seconds("numpy.fromfile and scaling"),),
        facts={
            "bytes": path.stat().st_size, "usable": int(loaded.mask.sum()),
            "seconds_with_sha256": times["hashed"].seconds("").median,
            **_memory(path, loaded.value.nbytes + loaded.mask.nbytes),
        },
        seed=SEED,
    )  # fmt: skip


def _delimited(path: Path, size: Size) -> Row:
    rows: int = size.pick(100_000, 2_000)
    np.savetxt(path, _samples(rows), fmt="%.8g", delimiter=",", header=HEADER, comments="")
    times = alternate(
        {
            "ours": lambda: fitter.load(path),
            "numpy": lambda: np.loadtxt(path, delimiter=",", skiprows=1),
        },
        size.pick(5, 2),
    )
    return Row(
        case=f"load delimited text, {rows:,} rows",
        ours=times["ours"].seconds("fitter.load: read, check, to vectors"),
        others=(times["numpy"].seconds("numpy.loadtxt"),),
        facts={"bytes": path.stat().st_size, "usable": int(times["ours"].result.mask.sum())},
        seed=SEED,
    )


def _large(folder: Path, size: Size) -> Iterator[Row]:
    """The same numbers as text and as Parquet, beside what pyarrow and Polars take to parse them alone."""
    import polars
    import pyarrow
    from pyarrow import csv, parquet

    rows: int = size.pick(5_000_000, 30_000)
    content = pyarrow.table(dict(zip(COLUMNS, np.round(_samples(rows), 6).T, strict=True)))
    text, packed = folder / "large.csv", folder / "large.parquet"
    csv.write_csv(content, text, csv.WriteOptions(quoting_style="none"))
    parquet.write_table(content, packed)
    del content
    cases: list[tuple[str, Path, Callable[[Path], Any], Callable[[Path], Any]]] = [
        ("delimited text", text, csv.read_csv, polars.read_csv),
        ("Parquet", packed, parquet.read_table, polars.read_parquet),
    ]
    for what, path, arrow, frames in cases:
        calls = {
            "ours": lambda path=path: len(fitter.load(path)),
            "arrow": lambda path=path, read=arrow: len(read(path)),
            "polars": lambda path=path, read=frames: len(read(path)),
        }
        times = alternate(calls, size.pick(3, 2))
        # wi, wo, value and mask.
        arrays = rows * (6 + 3) * 8 + rows
        yield Row(
            case=f"load {what}, {rows:,} rows",
            ours=times["ours"].seconds("fitter.load: read, check, to vectors"),
            others=(times["arrow"].seconds("pyarrow"), times["polars"].seconds("Polars")),
            facts={"bytes": path.stat().st_size, **_memory(path, arrays)},
            seed=SEED,
        )


def _memory(path: Path, arrays: int) -> dict[str, float]:
    """What loading needs at most, and as a multiple of the ``arrays`` (bytes) that come of it."""
    most = memory.ours(path)
    told = {} if most is None else {"peak_bytes": most, "peak_ratio": most / arrays}
    return {"array_bytes": arrays, **told}


def _samples(rows: int) -> np.ndarray:
    """(rows, 7) angles in degrees and values, as ``COLUMNS``."""
    wi, wo = tables.pairs(rows, SEED)
    angles = [np.rad2deg(angle) for w in (wi, wo) for angle in spherical_from_vector(w)]
    return np.column_stack([*angles, plain.evaluate("ward", wi, wo)])
