"""Fill values: what no reflectance can be is masked and counted, what was measured is left alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fitter import directions
from fitter.errors import SpecError
from fitter.formats import load, read_options, write
from fitter.formats.fills import find_fills, no_data, repeated, trailing_zeros
from fitter.masking import FILL
from fitter.quality import check
from fitter.table import Table
from tests.evidence.inputs import inputs
from tests.formats.samples import mbsdf_bytes
from tests.quality.tables import directions as raster
from tests.quality.tables import glossy


def text(wi: np.ndarray, wo: np.ndarray, value: np.ndarray, quantity: str = "brdf") -> bytes:
    theta_i, _ = directions.spherical_from_vector(wi)
    theta_o, phi_o = directions.spherical_from_vector(wo)
    rows = [f"# quantity: {quantity}", f"theta_i_rad,theta_o_rad,dphi_rad,{quantity}"]
    for row in zip(theta_i.tolist(), theta_o.tolist(), phi_o.tolist(), value.tolist(), strict=True):
        rows.append(",".join(map(repr, row)))
    return "\n".join([*rows, ""]).encode()


@pytest.fixture(scope="module")
def measured() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Directions and noisy values of a made-up measurement."""
    wi, wo = raster()
    noise = np.random.default_rng(2).normal(1, 0.02, len(wi))
    return wi, wo, glossy(wi, wo) * noise


@pytest.mark.parametrize("number", [-1.0, -999.0, -9999.0, 9999.0, 999999.0, 9.96921e36, -1e30])
def test_numbers_for_no_data(measured: tuple[np.ndarray, ...], number: float):
    wi, wo, value = measured
    held = value.copy()
    held[100:400:7] = number
    count = len(range(100, 400, 7))
    for negatives in ("mask", "keep"):
        table = load(text(wi, wo, held), negatives=negatives)
        assert table.metadata.masked == {FILL: count}
        np.testing.assert_array_equal(np.flatnonzero(~table.mask), np.arange(100, 400, 7))
        np.testing.assert_array_equal(table.value[:, 0], held)
    assert any(f"{count} samples hold the number {number:g}" in note for note in table.metadata.notes)
    kept = load(text(wi, wo, held), negatives="keep", fills="keep")
    assert kept.mask.all()
    assert kept.metadata.masked == {}


def test_two_numbers_for_no_data(measured: tuple[np.ndarray, ...]):
    wi, wo, value = measured
    held = value.copy()
    held[:20], held[20:50] = -9999.0, -999.0
    table = load(text(wi, wo, held))
    assert table.metadata.masked == {FILL: 50}
    assert len([note for note in table.metadata.notes if "no data" in note]) == 2


def test_a_peak_is_no_number_for_no_data(measured: tuple[np.ndarray, ...]):
    wi, wo, value = measured
    bright = value.copy()
    bright[7] = 999.0  # once: a peak may be as high by chance
    bright[8:40] = np.linspace(120, 900, 32)
    assert load(text(wi, wo, bright)).fills is None
    bright[7:12] = 999.0  # a saturated detector, beside values of its own size
    assert load(text(wi, wo, bright)).fills is None
    few = value.copy()
    few[3:6] = -1.0
    few[6] = -0.4  # noise as deep as that: they are negative values like the rest
    table = load(text(wi, wo, few))
    assert table.metadata.masked == {"negative": 4}


@pytest.mark.parametrize("quantity", ["brdf", "ccbrdf", "reflectance_factor"])
def test_zeros_beyond_a_cut(measured: tuple[np.ndarray, ...], quantity: str):
    """The receiver stops at 70 degrees, and the file goes on with zeros."""
    wi, wo, value = measured
    held = np.where(wo[:, 2] < np.cos(np.deg2rad(71)), 0.0, value)
    table = load(text(wi, wo, held, quantity))
    assert table.metadata.masked == {FILL: int((held == 0).sum())}
    assert np.rad2deg(table.domain.theta_o[1]) == pytest.approx(70)
    assert "; 648 fill values were left out on reading" in check(table)["fill_values"].sentence
    assert load(text(wi, wo, held, quantity), fills="keep").metadata.masked == {}


def test_an_incidence_of_zeros(measured: tuple[np.ndarray, ...]):
    wi, wo, value = measured
    held = np.where(np.abs(wi[:, 2] - np.cos(np.deg2rad(75))) < 1e-9, 0.0, value)
    table = load(text(wi, wo, held))
    assert table.metadata.masked == {FILL: int((held == 0).sum())}
    assert np.rad2deg(table.domain.theta_i[1]) == pytest.approx(60)


def test_what_fades_to_zero_was_measured(measured: tuple[np.ndarray, ...]):
    """Zeros that noise was clipped to, that decimals were rounded to, or that a curve ends in."""
    wi, wo, value = measured
    rng = np.random.default_rng(3)
    clipped = np.maximum(np.where(wo[:, 2] < 0.3, 0.0, value) + rng.normal(0, 0.01, len(value)), 0.0)
    rounded = np.round(0.02 * value * wo[:, 2] ** 3, 4)
    fading = value * np.maximum(wo[:, 2] - 0.3, 0.0)
    for held in (clipped, rounded, fading):
        assert (held == 0).sum() > 100
        table = load(text(wi, wo, held))
        assert table.fills is None
        assert table.mask.all()
        assert any("exactly 0" in note for note in table.metadata.notes)


def test_a_floor_is_masked_where_it_can_not_be_a_diffuse_surface(measured: tuple[np.ndarray, ...]):
    wi, wo, value = measured
    floor = 0.05
    for quantity, default in (("ccbrdf", True), ("brdf", False)):
        signal = value * wo[:, 2] if quantity == "ccbrdf" else value
        held = np.where(signal < floor, floor, signal) if quantity == "ccbrdf" else np.maximum(signal, 0.1)
        count = int((held == held.min()).sum())
        assert count > 100
        table = load(text(wi, wo, held, quantity))
        assert table.metadata.masked == ({FILL: count} if default else {})
        finding = check(table)["fill_values"]
        assert (finding.verdict == "warning") is not default
        assert ("fills='floors'" in finding.sentence) is not default
        asked = load(text(wi, wo, held, quantity), fills="floors")
        assert asked.metadata.masked == {FILL: count}
        assert check(asked)["fill_values"].verdict == "ok"


def test_a_diffuse_surface_is_no_floor():
    """f_r the same at every direction, and with a lobe that leaves most of them alone."""
    wi, wo = raster()
    lobe = np.maximum((directions.mirror(wi) * wo).sum(axis=1), 0) ** 4000
    for f in (np.full(len(wi), 0.3), 0.3 + np.where(lobe > 1e-16, lobe, 0.0)):
        assert load(text(wi, wo, f)).mask.all()
        assert load(text(wi, wo, f * wo[:, 2], "ccbrdf")).mask.all()


def test_trailing_zeros_of_a_line():
    values = np.array([[1.0, 0, 2, 0, 0], [0, 0, 0, 0, 0], [1, 1, 1, 1, 1], [0, 0, 0, 0, 3]])[..., None]
    expected = [[0, 0, 0, 1, 1], [1] * 5, [0] * 5, [0] * 5]
    np.testing.assert_array_equal(trailing_zeros(values, -2), np.array(expected, bool))
    both = np.concatenate([values, values[::-1]], axis=-1)
    assert not trailing_zeros(both, -2)[[1, 2]].any()


def test_a_grid_without_directions():
    data = bytearray(mbsdf_bytes(6, 6, 3))
    block = np.frombuffer(data, "<f4", offset=len(data) - 4 * 6 * 6 * 6 * 3)
    block[30:60] = -9999.0
    table = load(bytes(data))
    assert table.metadata.masked == {FILL: 10}
    assert load(bytes(data), fills="keep", negatives="keep").mask.all()


@pytest.mark.parametrize("format", ["delimited", "netcdf", "parquet"])
def test_kept_fill_values_come_back(measured: tuple[np.ndarray, ...], format: str, tmp_path: Path):
    wi, wo, value = measured
    held = value.copy()
    held[:50] = 9999.0
    for fills in ("mask", "keep"):
        table = load(text(wi, wo, held), fills=fills)
        assert write(table, tmp_path / "t", format) == []
        back = load(tmp_path / "t", fills="keep")
        np.testing.assert_array_equal(back.mask, table.mask)
        np.testing.assert_array_equal(back.value, table.value)


def test_fill_values_are_not_written_where_nothing_marks_them(
    measured: tuple[np.ndarray, ...], tmp_path: Path
):
    wi, wo, value = measured
    held = value.copy()
    held[:50] = -999.0
    table = load(text(wi, wo, held))
    losses = write(table, tmp_path / "t.astm", "astm")
    assert "samples" in {loss.code for loss in losses}
    back = load(tmp_path / "t.astm")
    assert len(back) == len(table) - 50
    assert back.value.min() > 0


def test_the_option(measured: tuple[np.ndarray, ...]):
    assert read_options({"fills": "floors"}).to_dict() == {"fills": "floors"}
    with pytest.raises(SpecError):
        read_options({"fills": "drop"})


@given(st.integers(0, 2**32), st.sampled_from([None, 2, 3, 4, 6]), st.floats(0.0, 0.3), st.booleans())
def test_no_measurement_is_taken_for_a_fill_value(
    seed: int, decimals: int | None, noise: float, clipped: bool
):
    """Of smooth reflectances with noise, as read from any instrument, none is masked by default."""
    rng = np.random.default_rng(seed)
    wi, wo = raster()
    level = 10 ** rng.uniform(-4, 0)
    value = level * (glossy(wi, wo, rng.uniform(0, 0.3)) + noise * rng.normal(size=len(wi)))
    if clipped:
        value = np.maximum(value, 0.0)
    if decimals is not None:
        value = np.round(value, decimals)
    for quantity in ("brdf", "ccbrdf"):
        held = value * wo[:, 2] if quantity == "ccbrdf" and decimals is None else value
        found = find_fills(held[:, None], quantity, wi, wo)
        # An incidence that is rounded away to nothing beside others looks like one that was not measured.
        assert not found.rows.any() or (np.abs(value) > 0).mean() < 0.05, found.notes


@pytest.mark.measured
def test_real_measurements_are_not_masked(shared: Path):
    """Of every measured file nothing but what the Zemax form itself marks."""
    seen = 0
    for one in inputs():
        if not one.measured:
            continue
        for table in all_of(one):
            seen += 1
            marked = {"AnoBlackEC1onAlum.bsdf": 67, "AnoBlackNiTEonSteel.bsdf": 67}
            expected = marked.get(Path(one.name).name, 0)
            assert table.metadata.masked.get(FILL, 0) == expected, one.name
    assert seen > 60


def all_of(one: Any) -> list[Table]:
    from tests.evidence.trial import read

    return read(one, one.sources("", b""))


def test_a_nan_that_signals():
    """What damaged bytes can be: no warning (an error in tests), and no fill value."""
    data = bytearray(mbsdf_bytes(6, 6, 3))
    data[-4:] = (0x7F800001).to_bytes(4, "little")
    assert load(bytes(data)).fills is None
    column = np.frombuffer((0x7FF0000000000001).to_bytes(8, "little") + np.full(9, 0.5).tobytes(), "<f8")
    assert no_data(column[:, None], "mask") == (None, ())


def test_repeated_values():
    cos_o = np.linspace(0, 1, 200)
    value = np.random.default_rng(1).uniform(1, 2, 200)
    assert repeated(value, cos_o) is None
    value[::4] = 0.5
    found = repeated(value, cos_o)
    assert found is not None
    assert (found.kind, found.value, found.count) == ("floor", 0.5, 50)
