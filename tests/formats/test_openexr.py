"""OpenEXR: slices hold what they say to float32, other tables are interpolated, UTIA's come either way up."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from fitter import directions
from fitter.errors import TableError
from fitter.formats import load, openexr_writer, write
from fitter.grid import Grid
from fitter.metadata import Channel, Metadata
from fitter.table import Table
from tests.formats.samples import openexr_bytes
from tests.formats.test_utia import DATA
from tests.formats.test_writing import anisotropic, scattered, smooth

ROUNDING = float(np.finfo(np.float32).eps) / 2


def picture(parts: list[tuple[dict[str, Any], dict[str, np.ndarray]]]) -> bytes:
    made = []
    for k, (header, channels) in enumerate(parts):
        base = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        made.append(OpenEXR.Part({**base, **header}, channels, f"p{k}"))
    sink = BytesIO()
    OpenEXR.File(made).write(sink)
    return sink.getvalue()


def on_grid(system: str, channels: list[Channel | str]) -> Table:
    rng = np.random.default_rng(5)
    axes = {"theta_i": [0.1, 0.5, 1.0], "theta_o": [0.0, 0.3, 0.9], "dphi": [0.0, 1.0, 2.0, 3.0]}
    if system == "spherical":
        turn = np.deg2rad(np.arange(0, 360, 90))
        axes = {"theta_i": [0.1, 0.5], "phi_i": turn, "theta_o": [0.0, 0.3, 0.9], "phi_o": turn}
    grid = Grid(system, {name: np.asarray(axis) for name, axis in axes.items()})
    value = rng.uniform(0.1, 3, (grid.size, len(channels)))
    value[3, 0], value[5, 0] = -0.25, np.nan
    mask = np.ones(grid.size, bool)
    mask[7] = False
    sigma = 0.01 * np.abs(np.nan_to_num(value)) + 1e-3
    return Table(
        grid=grid, value=value, sigma=sigma, mask=mask, channels=channels,
        metadata=Metadata(name="made up", scale_uncertainty=0.02, aperture=0.01, provenance={"lab": ["A"]}),
    )  # fmt: skip


def test_rows_are_polar_angles_and_columns_azimuths():
    table = load(openexr_bytes())
    assert table.grid is not None
    assert table.grid.shape == (2, 4, 3)
    bright = np.flatnonzero(table.value[:, 0] == 3)
    np.testing.assert_allclose(table.wo[bright], directions.mirror(table.wi[bright]), atol=1e-12)
    assert table.channels == (Channel("R"), Channel("550nm", 550.0))
    assert (table.metadata.name, table.metadata.provenance) == ("small", {"lab": "A. B."})


@pytest.mark.parametrize("system", ["spherical_isotropic", "spherical"])
@pytest.mark.parametrize(
    "channels",
    [["value"], ["R", "G", "B"], ["a b", "a b.c", "x.y"], [Channel("450nm", 450.0), Channel("u", 1.5)]],
)
def test_grids_come_back_to_float32(system: str, channels: list[Channel | str], tmp_path: Path):
    table = on_grid(system, channels)
    losses = write(table, tmp_path / "t.exr", "openexr")
    back = load(tmp_path / "t.exr")
    assert [loss.code for loss in losses] == ["values"]
    assert "e-08" in losses[0].message
    assert back.channels == table.channels
    np.testing.assert_array_equal(back.mask, table.mask)
    np.testing.assert_allclose(back.value, table.value, rtol=ROUNDING)
    np.testing.assert_allclose(back.sigma, table.sigma, rtol=ROUNDING)
    assert back.grid is not None
    assert table.grid is not None
    for name, axis in table.grid.axes.items():
        np.testing.assert_array_equal(back.grid.axes[name], axis)
    assert back.metadata.provenance == {"lab": ["A"], "file": "t.exr"}
    assert (back.metadata.scale_uncertainty, back.metadata.aperture) == (0.02, 0.01)
    assert len(OpenEXR.File(str(tmp_path / "t.exr")).parts) == np.prod(table.grid.shape[:-2])


def test_what_float32_holds_comes_back_exactly(tmp_path: Path):
    table = load(openexr_bytes())
    assert write(table, tmp_path / "t.exr", "openexr") == []
    assert load(tmp_path / "t.exr").hash == table.hash


def test_other_tables_are_interpolated(tmp_path: Path):
    table = scattered(3)
    losses = {loss.code: loss.message for loss in write(table, tmp_path / "t.exr", "openexr")}
    assert set(losses) == {"resampled"}
    assert "3 incidences" in losses["resampled"]
    back = load(tmp_path / "t.exr")
    index = np.flatnonzero(back.mask)
    assert 0.3 < len(index) / len(back) < 1
    found, outside = table.evaluate(back.wi[index], back.wo[index])
    assert not outside.any()
    np.testing.assert_allclose(back.value[index], found, rtol=1e-6)
    exact = smooth()
    half = Table(wi=exact.wi, wo=exact.wo, value=exact.value)
    assert write(half, tmp_path / "s.exr", "openexr")[0].code == "resampled"
    back = load(tmp_path / "s.exr")
    at = np.flatnonzero(back.mask)
    wanted = 1.0 + back.wo[at, 2] + 0.3 * back.wo[at, 0]
    np.testing.assert_allclose(back.value[at, 0], wanted, rtol=3e-2)


def test_tables_that_have_no_slices_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(openexr_writer, "_ANISOTROPIC", (3, 15.0, 30.0))
    wi = directions.vector_from_spherical(np.full(9, 0.5), 0.0)
    wo = directions.vector_from_spherical(np.linspace(-1.2, 1.2, 9), 0.0)
    large = on_grid("spherical_isotropic", ["value"])
    beyond = Table(grid=large.grid, value=np.full(len(large), 1e39))
    for table in (Table(wi=wi, wo=wo, value=np.ones(9)), beyond, anisotropic()):
        with pytest.raises(TableError) as caught:
            write(table, tmp_path / "t.exr", "openexr")
        assert caught.value.code == "table-unwritable"
        assert caught.value.remedy
    assert not list(tmp_path.iterdir())


def test_anisotropic_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(openexr_writer, "_ANISOTROPIC", (3, 15.0, 30.0))
    monkeypatch.setattr(openexr_writer, "_AZIMUTHS", 4)
    rng = np.random.default_rng(6)
    theta, phi = np.meshgrid([0.2, 0.7, 1.1], np.deg2rad([-120, -30, 60, 150]), indexing="ij")
    wi = np.repeat(directions.vector_from_spherical(theta.reshape(-1), phi.reshape(-1)), 60, axis=0)
    wo = directions.vector_from_spherical(np.arccos(rng.uniform(0.1, 1, 720)), rng.uniform(-3, 3, 720))
    table = Table(wi=wi, wo=wo, value=1 + wi[:, 0] + wo[:, 1], symmetry="anisotropic")
    assert write(table, tmp_path / "t.exr", "openexr")[0].code == "resampled"
    back = load(tmp_path / "t.exr")
    assert back.symmetry == "anisotropic"
    assert back.grid is not None
    assert back.grid.shape == (3, 4, 6, 12)
    index = np.flatnonzero(back.mask)
    found, outside = table.evaluate(back.wi[index], back.wo[index])
    assert not outside.any()
    np.testing.assert_allclose(back.value[index], found, rtol=1e-6)


class TestUtia:
    planes = np.frombuffer(DATA, "<f8").reshape(3, 288, 288).astype(np.float32)

    @pytest.mark.parametrize("upside_down", [False, True])
    def test_either_way_up(self, upside_down: bool):
        rows = self.planes[:, ::-1] if upside_down else self.planes
        data = picture([({}, {c: np.ascontiguousarray(plane) for c, plane in zip("RGB", rows, strict=True)})])
        table, binary = load(data, name="fabric"), load(DATA)
        assert table.metadata.source_format == "utia"
        assert any("bottom" in note for note in table.metadata.notes) == upside_down
        np.testing.assert_allclose(table.value, binary.value, rtol=ROUNDING)
        np.testing.assert_array_equal(table.wo, binary.wo)
        turned = load(data, convention="phi_specular_0")
        np.testing.assert_allclose(turned.value, load(DATA, convention="phi_specular_0").value, rtol=ROUNDING)


GREY = np.ones((4, 3), np.float32)


@pytest.mark.parametrize(
    "data",
    [
        picture([({}, {"R": GREY, "G": GREY, "B": GREY})]),
        picture([({"brdf.slices": "2"}, {"R": GREY})]),
        picture([({"brdf.slices": "1"}, {"R": GREY})]),
        picture([({"brdf.slices": "1", "brdf.system": "spherical_isotropic"}, {"R": GREY})]),
        openexr_bytes()[:-40],
    ],
    ids=["a picture", "version", "no system", "no angles", "cut"],
)
def test_refused(data: bytes):
    with pytest.raises(TableError) as caught:
        load(data, name="x.exr")
    assert caught.value.file == "x.exr"
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("theta_o", "[0.1, 0.2]"), ("theta_o", "{}"), ("theta_o", "[[1, 2, 3, 4]]"), ("dphi", '"word"'),
        ("pixels", "[]"), ("pixels", '{"brdf": "Q"}'), ("pixels", '{"value": "R"}'), ("quantity", "btdf"),
        ("theta_i", "much"), ("notes", "none"),
    ],
)  # fmt: skip
def test_damaged_headers(key: str, text: str):
    said = {
        "slices": "1", "system": "spherical_isotropic", "pixels": '{"brdf": "R"}', "theta_i": "0.5",
        "theta_o": json.dumps([0.1, 0.2, 0.3, 0.4]), "dphi": json.dumps([0.0, 1.0, 2.0]),
    }  # fmt: skip
    channels = {"R": GREY}
    assert len(load(picture([({f"brdf.{k}": word for k, word in said.items()}, channels)]))) == 12
    with pytest.raises(TableError) as caught:
        load(picture([({f"brdf.{k}": word for k, word in {**said, key: text}.items()}, channels)]))
    assert caught.value.remedy


def test_a_header_that_claims_a_huge_picture():
    data = bytearray(openexr_bytes())
    at = data.index(b"dataWindow\0box2i\0") + 16 + 4 + 8
    data[at : at + 8] = (2_000_000).to_bytes(4, "little") * 2
    with pytest.raises(TableError):
        load(bytes(data))
