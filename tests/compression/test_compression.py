"""The guarantee of compression, its round trip, and what a damaged container says."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fitter.compression import CompressedTable, compress
from fitter.compression.container import encode_header
from fitter.directions import vector_from_spherical
from fitter.errors import SpecError, TableError
from fitter.table import Channel, Grid, Metadata, Table

NUMBERS = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True),
    st.floats(1e-6, 1e3),
    st.just(0.0),
    st.sampled_from([5e-324, -5e-324, 1.7976931348623157e308, -1.7976931348623157e308]),
)


def scattered(value: np.ndarray, **keywords: object) -> Table:
    n = len(value)
    rng = np.random.default_rng(n)
    wo = vector_from_spherical(rng.uniform(0, 1.5, n), rng.uniform(0, 6, n))
    wi = np.broadcast_to(vector_from_spherical(0.3, 0.0), (n, 3))
    return Table(wi=wi, wo=wo, value=value, negatives="keep", **keywords)  # type: ignore[arg-type]


def within(original: np.ndarray, decoded: np.ndarray, tolerance: float, floor: np.ndarray) -> bool:
    """The guarantee, in exact-enough arithmetic (long double), for every finite value."""
    finite = np.isfinite(original)
    kinds = ((original == decoded) | (np.isnan(original) & np.isnan(decoded)))[~finite].all()
    f, g = original[finite].astype(np.longdouble), decoded[finite].astype(np.longdouble)
    floors = np.broadcast_to(floor, original.shape)[finite].astype(np.longdouble)
    bound = np.longdouble(tolerance) * (np.abs(f) + floors)
    return bool(kinds and (np.abs(f - g) <= bound * (1 + np.longdouble(1e-12))).all())


@settings(max_examples=200)
@given(
    values=st.lists(NUMBERS, min_size=1, max_size=40),
    tolerance=st.one_of(st.floats(1e-12, 0.9), st.sampled_from([0.0, 0.001, 0.01, 0.05])),
    floor=st.one_of(st.none(), st.floats(1e-300, 1e300)),
)
def test_every_value_is_within_the_guarantee(
    values: list[float], tolerance: float, floor: float | None
) -> None:
    value = np.array([*values, 1.0])
    table = scattered(value)
    small = compress(table, tolerance, floor=floor)
    back = CompressedTable.from_bytes(_bytes(small)).decompress()
    assert small.worst_error <= 1
    assert within(table.value, back.value, small.tolerance, small.floor)
    assert np.array_equal(back.mask, table.mask)
    if tolerance == 0:
        assert back.value.tobytes() == table.value.tobytes()


def test_everything_else_is_kept_exactly(tmp_path: Path) -> None:
    grid = Grid(
        "spherical_isotropic",
        {
            "theta_i": np.linspace(0, 1.4, 5),
            "theta_o": np.linspace(0, 1.4, 9),
            "dphi": np.linspace(0, np.pi, 7),
        },
    )
    rng = np.random.default_rng(1)
    value = rng.lognormal(size=(grid.size, 2))
    value[3] = np.nan
    value[5, 1] = -0.2
    table = Table(
        value=value,
        grid=grid,
        sigma=0.1 * np.abs(value) + 1e-3,
        channels=[Channel("a", 532.0), Channel("b")],
        metadata=Metadata(name="t", provenance={"lab": "x", "n": [1, 2]}, notes=("one", "two"), aperture=0.1),
    )
    path = tmp_path / "small.brdfz"
    compress(table, 0.01).save(path)
    assert [p.name for p in tmp_path.iterdir()] == ["small.brdfz"]
    back = CompressedTable.load(path).decompress()
    assert back.grid is not None
    assert back.grid.system == grid.system
    assert all(np.array_equal(back.grid.axes[k], grid.axes[k]) for k in grid.axes)
    assert back.sigma is not None
    assert np.array_equal(back.sigma, table.sigma, equal_nan=True)  # type: ignore[arg-type]
    assert back.metadata == table.metadata
    assert back.channels == table.channels
    assert back.symmetry == table.symmetry
    assert np.array_equal(back.mask, table.mask)
    assert compress(table, 0).decompress().hash == table.hash


def test_directions_of_scattered_tables_are_kept_exactly() -> None:
    table = scattered(np.linspace(0.1, 1, 50))
    back = compress(table, 0.05).decompress()
    assert np.array_equal(back.wi, table.wi)
    assert np.array_equal(back.wo, table.wo)


def test_fill_values_all_zero_and_one_sample() -> None:
    for value in (np.array([0.0, 0.0, 0.0]), np.array([0.5]), np.array([1.0, -1.0, -1.0])):
        table = scattered(value)
        small = compress(table, 0.01)
        assert within(table.value, small.decompress().value, 0.01, small.floor)


@pytest.mark.parametrize("tolerance", [-0.1, 1.0, float("nan"), float("inf")])
def test_a_tolerance_that_makes_no_sense(tolerance: float) -> None:
    with pytest.raises(SpecError, match="tolerance"):
        compress(scattered(np.ones(4)), tolerance)


@pytest.mark.parametrize("floor", [0.0, -1.0, float("nan"), [1.0, 2.0]])
def test_a_floor_that_makes_no_sense(floor: float) -> None:
    with pytest.raises(SpecError, match="floor"):
        compress(scattered(np.ones(4)), 0.01, floor=floor)


def _bytes(small: CompressedTable) -> bytes:
    return encode_header(small.header, small.blocks) + b"".join(b.data for b in small.blocks.values())


def test_nbytes_is_the_size_of_the_file(tmp_path: Path) -> None:
    small = compress(scattered(np.linspace(0.1, 1, 50)), 0.01)
    small.save(tmp_path / "x")
    assert small.nbytes == (tmp_path / "x").stat().st_size


def test_every_truncation_and_every_changed_byte_is_a_clear_error() -> None:
    small = compress(scattered(np.random.default_rng(0).lognormal(size=60)), 0.01)
    data = _bytes(small)
    for length in range(0, len(data), 7):
        with pytest.raises(TableError):
            CompressedTable.from_bytes(data[:length], file="x")
    for place in range(0, len(data), 5):
        broken = bytearray(data)
        broken[place] ^= 0x41
        with pytest.raises(TableError):
            CompressedTable.from_bytes(bytes(broken), file="x").decompress()
    with pytest.raises(TableError, match="follow the last block"):
        CompressedTable.from_bytes(data + b"?")


def test_the_damaged_block_is_named() -> None:
    small = compress(scattered(np.random.default_rng(0).lognormal(size=60)), 0.01)
    data = _bytes(small)
    with pytest.raises(TableError, match="'mask'") as caught:
        CompressedTable.from_bytes(data[:-3], file="cut.brdfz")
    assert caught.value.file == "cut.brdfz"
    assert caught.value.column == "mask"


def test_another_file_and_another_version() -> None:
    with pytest.raises(TableError, match="not a compressed table"):
        CompressedTable.from_bytes(b"<!doctype html>")
    data = bytearray(_bytes(compress(scattered(np.ones(3)), 0.01)))
    struct.pack_into("<H", data, 8, 99)
    with pytest.raises(TableError, match="version 99"):
        CompressedTable.from_bytes(bytes(data))


def test_ratio_on_a_noisy_merl_grid(capsys: pytest.CaptureFixture[str]) -> None:
    """A glossy lobe with 1 % noise on the MERL grid, one of three channels to keep the test short."""
    k = np.arange(90)
    grid = Grid(
        "half_difference",
        {
            "theta_h": np.deg2rad((k + 0.5) ** 2 / 90),
            "theta_d": np.deg2rad(k + 0.5),
            "phi_d": np.deg2rad(np.arange(180) + 0.5),
        },
        {"phi_d": np.pi},
    )
    theta_h, theta_d, _ = grid.coordinates()
    rng = np.random.default_rng(0)
    lobe = 0.2 / np.pi + 5 * np.exp(-(np.tan(theta_h) ** 2) / 0.1**2) * (1 + 9 * (1 - np.cos(theta_d)) ** 5)
    table = Table(value=lobe * (1 + 0.01 * rng.standard_normal(grid.size)), grid=grid)
    for tolerance in (0.01, 0.05):
        start = time.perf_counter()
        small = compress(table, tolerance)
        packed = time.perf_counter()
        back = small.decompress()
        seconds = packed - start, time.perf_counter() - packed
        assert within(table.value, back.value, tolerance, small.floor)
        with capsys.disabled():
            print(
                f"\nMERL grid, 1 % noise, tolerance {tolerance:.0%}: ratio {small.ratio:.1f}, worst error "
                f"{small.worst_error:.4f} of the bound, pack {seconds[0]:.2f} s, unpack {seconds[1]:.2f} s"
            )
        assert small.ratio > 25
