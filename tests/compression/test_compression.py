"""The guarantee of compression, its round trip, and what a damaged container says."""

from __future__ import annotations

import struct
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fitter
from fitter.compression import CompressedTable, compress
from fitter.compression.compressed import DAMAGED
from fitter.directions import vector_from_spherical
from fitter.errors import SpecError, TableError
from fitter.formats.merl import merl_grid
from fitter.grid import Grid
from fitter.metadata import Channel, Metadata
from fitter.table import Table

#: Of the values of version3.brdf.
VERSION3 = "c0d983d063ab21e02307eaefffdd073da47fadecdfded47b443cb2abcafad683"
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
    back = CompressedTable.from_bytes(small.to_bytes()).decompress()
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


def test_nbytes_is_the_size_of_the_file(tmp_path: Path) -> None:
    small = compress(scattered(np.linspace(0.1, 1, 50)), 0.01)
    small.save(tmp_path / "x")
    assert small.nbytes == (tmp_path / "x").stat().st_size


def test_every_truncation_and_every_changed_byte_is_a_clear_error() -> None:
    small = compress(scattered(np.random.default_rng(0).lognormal(size=60)), 0.01)
    data = small.to_bytes()
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
    data = small.to_bytes()
    with pytest.raises(TableError, match="'values 0'") as caught:
        CompressedTable.from_bytes(data[:-3], file="cut.brdfz")
    assert caught.value.file == "cut.brdfz"
    assert caught.value.column == "values 0"


@pytest.mark.parametrize("tolerance", [0.0, 0.01])
def test_the_rest_of_a_damaged_container_is_readable(tolerance: float) -> None:
    table = smooth_grid((9, 12, 20), channels=2)
    small = compress(table, tolerance, tile=700)
    assert small.tiles.count > 3
    data = bytearray(small.to_bytes())
    name = "values 2"
    start = bytes(data).index(small.blocks[name].data)
    data[start + 5] ^= 1
    with pytest.raises(TableError, match=name) as caught:
        CompressedTable.from_bytes(bytes(data))
    assert "--salvage" in (caught.value.remedy or "")
    kept = CompressedTable.from_bytes(bytes(data), damage="keep")
    assert list(kept.damaged) == [name]
    back, whole = kept.decompress(), small.decompress()
    lost = np.isnan(back.value).any(axis=1)
    assert 0 < lost.sum() <= 700
    assert np.array_equal(back.value[~lost], whole.value[~lost])
    assert np.array_equal(back.mask, whole.mask & ~lost)
    assert back.metadata.masked[DAMAGED] == (whole.mask & lost).sum()
    assert any(name in note for note in back.metadata.notes)
    assert np.array_equal(kept.values(np.flatnonzero(~lost)), whole.value[~lost])
    with pytest.raises(TableError, match=name):
        kept.values(np.flatnonzero(lost)[:1])
    # A file that ends early: what comes before is there.
    cut = CompressedTable.from_bytes(bytes(small.to_bytes()[: start + 5]), damage="keep")
    assert set(cut.damaged) == {f"values {k}" for k in range(2, small.tiles.count)}
    assert np.isfinite(cut.decompress().value).all(axis=1).any()


def test_without_its_header_or_its_geometry_nothing_is_readable() -> None:
    small = compress(smooth_grid((3, 4, 5)), 0.01)
    data = bytearray(small.to_bytes())
    data[30] ^= 1
    with pytest.raises(TableError, match="header"):
        CompressedTable.from_bytes(bytes(data), damage="keep")
    data = bytearray(small.to_bytes())
    data[bytes(data).index(small.blocks["axis dphi"].data) + 9] ^= 1
    kept = CompressedTable.from_bytes(bytes(data), damage="keep")
    with pytest.raises(TableError, match="axis dphi"):
        kept.decompress()
    assert np.array_equal(kept.values([3, 1]), small.decompress().value[[3, 1]])


def test_another_file_and_another_version() -> None:
    with pytest.raises(TableError, match="not a compressed table"):
        CompressedTable.from_bytes(b"<!doctype html>")
    data = bytearray(compress(scattered(np.ones(3)), 0.01).to_bytes())
    struct.pack_into("<H", data, 8, 99)
    with pytest.raises(TableError, match="version 99"):
        CompressedTable.from_bytes(bytes(data))


def smooth_grid(shape: tuple[int, int, int], channels: int = 1, noise: float = 0.01, seed: int = 0) -> Table:
    """A lobe over a diffuse part on an in/out grid, with relative noise."""
    names = ("theta_i", "theta_o", "dphi")
    ends = (1.3, 1.4, np.pi)
    axes = {name: np.linspace(0.05, end, n) for name, end, n in zip(names, ends, shape, strict=True)}
    grid = Grid("spherical_isotropic", axes)
    theta_i, theta_o, dphi = grid.coordinates()
    away = np.square(theta_i - theta_o) + np.square(dphi - np.pi)
    lobe = 0.1 + 3.0 * np.exp(-away / 0.1)
    rng = np.random.default_rng(seed)
    value = lobe[:, None] * np.linspace(1.0, 0.5, channels)
    return Table(value=value * (1 + noise * rng.standard_normal(value.shape)), grid=grid)


@settings(max_examples=40)
@given(data=st.data())
def test_every_value_of_a_grid_is_within_the_guarantee(data: st.DataObject) -> None:
    """Noise of all sizes, masked and missing regions, mirrored and repeated rows, several tiles."""
    shape = tuple(data.draw(st.lists(st.integers(1, 9), min_size=3, max_size=3)))
    table = smooth_grid(shape, data.draw(st.integers(1, 3)), data.draw(st.sampled_from([0.0, 0.01, 0.3])))  # type: ignore[arg-type]
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    cube = table.value.reshape(*shape, -1) - data.draw(st.sampled_from([0.0, 0.1]))
    for axis in range(3):
        kind = data.draw(st.sampled_from(["", "mirrored", "nearly", "repeated"]))
        if kind in ("mirrored", "nearly"):
            cube = 0.5 * (cube + np.flip(cube, axis))
        if kind == "nearly":
            cube = cube * (1 + 1e-5 * rng.standard_normal(cube.shape))
        if kind == "repeated":
            cube = np.take(cube, np.arange(shape[axis]) // 2, axis=axis)
    value = cube.reshape(len(table), -1)
    if data.draw(st.booleans()):
        value[rng.random(value.shape) < 0.1] = data.draw(st.sampled_from([np.nan, np.inf, 0.0, 1e300, -1.0]))
    value[0] = 0.5
    mask = rng.random(len(value)) < 0.9
    mask[0] = True
    table = Table(value=value, grid=table.grid, mask=mask, negatives="keep")
    tolerance = data.draw(st.sampled_from([0.0, 1e-7, 1e-3, 0.05, 0.6]))
    small = compress(table, tolerance, tile=data.draw(st.sampled_from([1, 50, 1000])))
    assert small.worst_error <= 1
    kept = CompressedTable.from_bytes(small.to_bytes())
    back = kept.decompress()
    assert within(table.value, back.value, small.tolerance, small.floor)
    assert np.array_equal(back.mask, table.mask)
    index = rng.integers(0, len(value), 20)
    assert np.array_equal(kept.values(index), back.value[index], equal_nan=True)


@pytest.mark.parametrize("kind", ["grid", "half_difference", "scattered"])
def test_evaluating_unpacks_what_it_needs(kind: str) -> None:
    table = smooth_grid((3, 5, 6) if kind == "scattered" else (8, 11, 14), channels=2)
    if kind == "half_difference":
        table = Table(value=table.value, grid=merl_grid((8, 11, 14)))
    if kind == "scattered":
        table = Table(wi=table.wi, wo=table.wo, value=table.value)
    small = compress(table, 0.01, tile=400)
    rng = np.random.default_rng(2)
    wi = vector_from_spherical(rng.uniform(0, 1.5, 50), rng.uniform(0, 6, 50))
    wo = vector_from_spherical(rng.uniform(0, 1.5, 50), rng.uniform(0, 6, 50))
    expected = small.decompress().evaluate(wi, wo)
    one = small.evaluate(wi[0], wo[0])
    assert all(np.array_equal(a[0], b[0]) for a, b in zip(one, expected, strict=True))
    if kind == "half_difference":
        assert len(small.tiles._kept) < small.tiles.count
    assert all(np.array_equal(a, b) for a, b in zip(small.evaluate(wi, wo), expected, strict=True))


def test_kept_tiles_stay_within_their_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    small = compress(smooth_grid((8, 11, 14)), 0.01, tile=100)
    most = 3 * 8 * 100
    monkeypatch.setattr("fitter.compression.tiles.KEPT", most)
    small.values(np.arange(8 * 11 * 14))
    assert 0 < sum(tile.nbytes for tile in small.tiles._kept.values()) <= most


def test_the_errors_have_no_sign() -> None:
    """Mean signed error below 0.02 of the bound, whether the noise is smaller or larger than that."""
    for noise in (0.001, 0.01, 0.1):
        table = smooth_grid((20, 24, 30), 2, noise)
        for tolerance in (0.001, 0.01, 0.05):
            small = compress(table, tolerance)
            bound = tolerance * (np.abs(table.value) + small.floor)
            error = (small.decompress().value - table.value) / bound
            assert np.allclose(small.mean_error, error.mean(axis=0), atol=1e-9)
            assert np.allclose(small.rms_error, np.sqrt(np.square(error).mean(axis=0)), atol=1e-9)
            assert np.abs(small.mean_error).max() < 0.02


def test_the_errors_shift_a_fit_no_more_than_independent_ones_would() -> None:
    """The least-squares shift of the lobe's four parameters, in standard errors of independent errors of the
    size made, whether the bound is below the noise or far above it: of 108 one in twenty is beyond 2."""
    found: list[float] = []
    for noise in (0.0, 0.003, 0.01):
        for tolerance in (0.001, 0.01, 0.05):
            for seed in range(3):
                table = smooth_grid((20, 24, 30), 1, noise, seed)
                assert table.grid is not None
                theta_i, theta_o, dphi = table.grid.coordinates()
                away = np.square(theta_i - theta_o) + np.square(dphi - np.pi)
                lobe = np.exp(-away / 0.1)
                exact = 0.1 + 3.0 * lobe
                slopes = [np.ones_like(lobe), lobe, 30.0 * lobe * away, 60.0 * lobe * (dphi - np.pi)]
                design = np.stack(slopes, axis=1) / exact[:, None]
                error = (compress(table, tolerance).decompress().value - table.value)[:, 0] / exact
                inverse = np.linalg.inv(design.T @ design)
                spread = inverse @ (design.T * np.square(error)) @ design @ inverse
                found += (inverse @ design.T @ error / np.sqrt(np.diag(spread))).tolist()
    assert np.sqrt(np.mean(np.square(found))) < 1.4
    assert np.mean(np.abs(found) > 2.0) < 0.15


def test_a_bound_from_the_noise() -> None:
    table = smooth_grid((12, 16, 40), 1, noise=0.03)
    small = compress(table, "noise")
    assert 0.02 < small.tolerance < 0.05
    sigma = 0.04 * np.abs(table.value) + 1e-4
    stated = compress(Table(value=table.value, grid=table.grid, sigma=sigma), "noise")
    assert stated.tolerance == pytest.approx(0.04, rel=0.05)
    bound = stated.tolerance * (np.abs(table.value) + stated.floor)
    assert 0.8 < np.median(bound / sigma) < 2.1
    with pytest.raises(SpecError, match="noise"):
        compress(smooth_grid((2, 2, 2), noise=0.0), "noise")


def test_what_was_written_before_is_read() -> None:
    """Neither our arithmetic nor the coders' changed: what versions 2 and 3 wrote of the same table comes
    back within its bound, version 3 to the last bit (of version 2 other logarithms made the values)."""
    table = smooth_grid((6, 8, 12), 3, noise=0.02)
    for version in (2, 3):
        path = Path(__file__).with_name(f"version{version}.brdf")
        assert struct.unpack_from("<H", path.read_bytes(), 8) == (version,)
        small = CompressedTable.load(path)
        value = small.decompress().value
        assert within(table.value, value, 0.01, small.floor)
    assert sha256(value.tobytes()).hexdigest() == VERSION3


def test_measured_tables_keep_the_guarantee(shared: Path) -> None:
    measured = shared / "measured"
    for path in (*sorted((measured / "rgl").glob("*.bsdf"))[:2], measured / "ua_loft/AnoBlackEC1onAlum.bsdf"):
        table = fitter.load(path)
        for tolerance in (0.001, 0.05):
            small = compress(table, tolerance)
            assert within(table.value, small.decompress().value, tolerance, small.floor), path.name
            if len(table) > 5000:
                assert np.abs(small.mean_error).max() < 0.02, path.name
