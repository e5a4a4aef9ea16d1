"""NVIDIA MBSDF: cells where they belong, both parts, writing, and the measured file."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from fitter import directions
from fitter.errors import TableError
from fitter.formats import describe, load, write
from fitter.formats.mbsdf import mbsdf_grid
from fitter.grid import Grid
from fitter.table import Table
from tests.formats.samples import mbsdf_bytes


@pytest.mark.parametrize("channels", [1, 3])
def test_cells(channels: int):
    """Values that tell their cell are at its centre; phi runs from the light to the mirror side."""
    table = load(mbsdf_bytes(channels=channels))
    assert len(table.channels) == channels
    theta_i, _ = directions.spherical_from_vector(table.wi)
    theta_o, phi_o = directions.spherical_from_vector(table.wo)
    cell = (np.floor(theta_i / (np.pi / 8)), np.floor(theta_o / (np.pi / 8)), np.floor(phi_o / (np.pi / 5)))
    np.testing.assert_allclose(table.value[:, 0], cell[0] + cell[1] / 10 + cell[2] / 100, atol=1e-6)
    np.testing.assert_allclose(table.value[:, -1] - table.value[:, 0], 0.001 * (channels - 1), atol=1e-6)
    np.testing.assert_allclose(phi_o.reshape(4, 4, 5)[0, 0], (np.arange(5) + 0.5) * np.pi / 5)
    assert table.symmetry == "isotropic"
    # The last cell stands up to the plane of incidence and the horizon.
    wi = directions.vector_from_spherical([1.5, 1.5], 0.0)
    wo = directions.vector_from_spherical(1.5, [np.pi, 0.0])
    found, outside = table.evaluate(wi, wo)
    assert not outside.any()
    np.testing.assert_allclose(found[:, 0], [3.34, 3.30], atol=1e-6)


def test_both_parts_and_metadata():
    data = mbsdf_bytes()
    head, block = data[:20], data[20:]
    table = load(head + b'sample="a \\"b\\""\n' + block)
    assert table.metadata.provenance["metadata"] == ['sample="a \\"b\\""']
    old = mbsdf_bytes(part="")
    assert load(old).hash == load(data).hash
    transmission = mbsdf_bytes(part="_TRANSMISSION")[20:]
    table = load(data + transmission)
    assert any("ransmission" in note for note in table.metadata.notes)
    with pytest.raises(TableError, match="transmission only"):
        load(head + transmission)
    for tail in (b"x", transmission[:-5], transmission + b"1"):
        with pytest.raises(TableError):
            load(data + tail)


def test_other_quantities():
    plain = load(mbsdf_bytes())
    weighted = load(mbsdf_bytes(), quantity="ccbrdf")
    np.testing.assert_allclose(weighted.value * plain.wo[:, 2:], plain.value, rtol=1e-12)
    np.testing.assert_allclose(load(mbsdf_bytes(), quantity="reflectance_factor").value * np.pi, plain.value)


def test_damage():
    for at, value, what in ((0, 2, "type 2"), (4, 2**31, "claims"), (8, 2**32 - 1, "claims"), (4, 0, "few")):
        data = bytearray(mbsdf_bytes())
        struct.pack_into("<I", data, 43 + at, value)
        if what == "few":
            data = data[: 43 + 12]
        with pytest.raises(TableError, match=what) as caught:
            load(bytes(data), name="f.mbsdf")
        assert (caught.value.file, bool(caught.value.remedy)) == ("f.mbsdf", True)
    with pytest.raises(TableError, match="no line"):
        load(b"NVIDIA ARC MBSDF V1\n" + b"a=1\n" * 10)


class TestWriting:
    @pytest.mark.parametrize("channels", [1, 3])
    def test_bit_for_bit(self, channels: int, tmp_path: Path):
        table = load(mbsdf_bytes(channels=channels))
        losses = write(table, tmp_path / "t.mbsdf", "mbsdf")
        assert [loss.code for loss in losses] == ["name"]
        assert (tmp_path / "t.mbsdf").read_bytes() == mbsdf_bytes(channels=channels)

    def test_what_is_lost(self, tmp_path: Path):
        grid = mbsdf_grid(3, 4)
        value = np.random.default_rng(1).uniform(0.1, 1, 36)
        value[3], value[5] = -0.25, np.nan
        losses = write(Table(grid=grid, value=value), tmp_path / "t.mbsdf", "mbsdf")
        assert {loss.code for loss in losses} == {"samples", "values"}
        assert losses[0].message.startswith("1 masked")
        back = load(tmp_path / "t.mbsdf")
        assert back.value[3, 0] == -0.25
        assert back.value[5, 0] == 0
        assert back.metadata.masked == {"negative": 1}

    def test_refused(self, tmp_path: Path):
        angles, dphi = np.deg2rad([10, 40, 70]), np.deg2rad([0, 90, 180])
        off = Grid("spherical_isotropic", {"theta_i": angles, "theta_o": angles, "dphi": dphi})
        grid = mbsdf_grid(3, 3)
        for table in (
            Table(grid=off, value=np.ones(27)), Table(grid=grid, value=np.ones((27, 2))),
            Table(grid=grid, value=np.full(27, 1e39)), Table(wi=[[0, 0, 1.0]], wo=[[0, 0, 1.0]], value=[1.0]),
        ):  # fmt: skip
            with pytest.raises(TableError) as caught:
                write(table, tmp_path / "t.mbsdf", "mbsdf")
            assert caught.value.code == "table-unwritable"
            assert caught.value.remedy
            assert not list(tmp_path.iterdir())


@pytest.mark.measured
def test_car_paint(shared: Path, tmp_path: Path):
    path = shared / "measured/mdl/carpaint_blue.mbsdf"
    table = load(path)
    assert table.grid is not None
    assert table.grid.shape == (45, 45, 90)
    # A cell is masked where any of its channels is negative: red is in 39 % of them.
    assert table.metadata.masked == {"negative": 74397}
    kept = load(path, negatives="keep")
    blue = kept.value[:, 2].reshape(table.grid.shape)
    for i in range(5, 34):
        assert abs(int(blue[i, :, -1].argmax()) - i) <= 1  # the mirror direction, to a cell of 2 deg
        assert blue[i, :, -1].max() > 5 * blue[i, 10:, 0].max()
    for peak in describe(kept)["peaks"]:
        if 10 < peak["theta_i_deg"] < 68:
            assert abs(peak["specular_side"]["theta_o_deg"] - peak["theta_i_deg"]) < 2.1
    assert [loss.code for loss in write(kept, tmp_path / "t.mbsdf", "mbsdf")] == ["name"]
    assert (tmp_path / "t.mbsdf").read_bytes() == path.read_bytes()
