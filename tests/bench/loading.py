"""Files read and checked, against NumPy reading the same numbers."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import fitter
from fitter.directions import spherical_from_vector
from fitter.formats.merl import SCALES
from tests.bench import plain, tables
from tests.bench.measuring import Row, Size, alternate

SEED = 2
HEADER = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,brdf_R,brdf_G,brdf_B"


def run(size: Size) -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as name:
        yield _merl(Path(name) / "table.binary", size)
        yield _delimited(Path(name) / "table.csv", size)


def _merl(path: Path, size: Size) -> Row:
    table = tables.merl("ward", size.pick(tables.MERL, tables.SMALL), SEED)
    tables.write_merl(table, path)
    scale = np.array(SCALES)[:, None]
    times = alternate(
        {
            "ours": lambda: fitter.load(path),
            "numpy": lambda: np.fromfile(path, "<f8", offset=12).reshape(3, -1) * scale,
        },
        size.pick(7, 2),
    )
    return Row(
        case="load a MERL file",
        ours=times["ours"].seconds("fitter.load: read, hash, mask, describe"),
        others=(times["numpy"].seconds("numpy.fromfile and scaling"),),
        facts={"bytes": path.stat().st_size, "usable": int(times["ours"].result.mask.sum())},
        seed=SEED,
    )


def _delimited(path: Path, size: Size) -> Row:
    rows: int = size.pick(100_000, 2_000)
    wi, wo = tables.pairs(rows, SEED)
    angles = [np.rad2deg(angle) for w in (wi, wo) for angle in spherical_from_vector(w)]
    columns = np.column_stack([*angles, plain.evaluate("ward", wi, wo)])
    np.savetxt(path, columns, fmt="%.8g", delimiter=",", header=HEADER, comments="")
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
