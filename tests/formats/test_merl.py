"""MERL binary against an independent generator: both cell conventions, scales, masks, and its cost."""

from __future__ import annotations

import math
import struct
import time
from pathlib import Path

import numpy as np
import pytest

from fitter import directions
from fitter.errors import TableError
from fitter.formats import describe, load
from tests.formats.samples import merl_bytes

DIMS = (6, 5, 8)


def angle_coded(shift: float) -> bytes:
    """Values that state the cell's own angles (degrees), packed by hand: R theta_h, G theta_d, B phi_d."""
    planes: list[list[float]] = [[], [], []]
    for h in range(DIMS[0]):
        for d in range(DIMS[1]):
            for p in range(DIMS[2]):
                planes[0].append(90.0 * ((h + shift) / DIMS[0]) ** 2)
                planes[1].append(90.0 * (d + shift) / DIMS[1])
                planes[2].append(180.0 * (p + shift) / DIMS[2])
    data = struct.pack("<3i", *DIMS)
    for plane, scale in zip(planes, (1500.0, 1500.0 / 1.15, 1500.0 / 1.66), strict=True):
        data += struct.pack(f"<{len(plane)}d", *(value * scale for value in plane))
    return data


@pytest.mark.parametrize(("convention", "shift"), [("center", 0.5), ("corner", 0.0), (None, 0.5)])
def test_conventions(convention: str | None, shift: float):
    table = load(angle_coded(shift), convention=convention)
    index = np.flatnonzero(table.mask)
    wi, wo = table.directions(index)
    theta_h, _, theta_d, phi_d = directions.half_difference_from_vectors(wi, wo)
    stated = table.value[index]
    np.testing.assert_allclose(np.rad2deg(theta_h), stated[:, 0], atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(theta_d), stated[:, 1], atol=1e-9)
    known = (stated[:, 0] > 1e-9) & (stated[:, 1] > 1e-9)  # phi_d is undefined at the poles
    turn = np.abs(np.exp(2j * phi_d[known]) - np.exp(2j * np.deg2rad(stated[known, 2])))
    assert turn.max() < 1e-6
    assert table.symmetry == "isotropic"
    assert table.grid is not None
    assert table.grid.periodic == {"phi_d": math.pi}


def test_negative_cells_are_masked_and_kept():
    data = bytearray(merl_bytes())
    struct.pack_into("<d", data, 12, -1.0)
    table = load(bytes(data))
    assert not table.mask[0]
    assert table.metadata.masked["negative"] == 1
    assert table.value[0, 0] == -1 / 1500
    assert load(bytes(data), negatives="keep").mask[0]


def test_another_quantity_is_refused():
    with pytest.raises(TableError, match="f_r itself"):
        load(merl_bytes(), quantity="ccbrdf")


def test_full_size(tmp_path: Path):
    """34 MB: close to what reading and scaling cost, without directions, and described in little more."""
    dims = (90, 90, 180)
    path = tmp_path / "full.binary"
    n = math.prod(dims)
    with path.open("wb") as file:
        file.write(struct.pack("<3i", *dims))
        np.full(3 * n, 300.0).tofile(file)

    def cost(work) -> float:  # type: ignore[no-untyped-def]
        times = []
        for _ in range(3):
            start = time.perf_counter()
            work()
            times.append(time.perf_counter() - start)
        return min(times)

    def floor() -> None:
        np.ascontiguousarray((np.fromfile(path, "<f8", offset=12).reshape(3, n) * np.ones((3, 1))).T)

    table = load(path)
    assert len(table) == n
    loading, plain = cost(lambda: load(path)), cost(floor)
    print(f"load {loading:.3f} s, fromfile and scale {plain:.3f} s")
    # Also hashes the bytes and looks at every cell for the mask; generous, the machine is shared.
    assert loading < 8 * plain + 0.2
    peaks = describe(table)["peaks"]
    assert peaks
