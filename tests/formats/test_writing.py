"""Every writable format: write, read back, and what is said to be lost is what is lost."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fitter import directions
from fitter.cli import main
from fitter.errors import SpecError, TableError
from fitter.formats import formats, load, load_all, merl, specular, write
from fitter.formats.merl import merl_grid
from fitter.grid import Grid
from fitter.metadata import Channel, Metadata
from fitter.table import Table
from tests.formats.samples import SAMPLES, zemax_bytes

WRITABLE = sorted(entry.name for entry in formats() if entry.write is not None)


def scattered(channels: int = 1, names: list[str] | None = None, seed: int = 1) -> Table:
    """A made-up isotropic measurement, out of plane, with a lobe about the mirror direction."""
    rng = np.random.default_rng(seed)
    theta_i = np.repeat(np.deg2rad([10.0, 30.0, 50.0]), 300)
    wo = directions.vector_from_spherical(
        np.arccos(rng.uniform(0.2, 1, 900)), rng.uniform(-np.pi, np.pi, 900)
    )
    wi = directions.vector_from_spherical(theta_i, 0.0)
    lobe = np.exp(-20 * (1 - (directions.mirror(wi) * wo).sum(axis=1)))
    return Table(wi=wi, wo=wo, value=0.1 + np.outer(lobe, np.arange(1, channels + 1)), channels=names)


def smooth() -> Table:
    """1 + z_o + 0.3 x_o on a grid of absolute angles."""
    axes = {"theta_i": [10, 50], "theta_o": np.arange(0, 81, 4), "dphi": np.arange(0, 181, 10)}
    grid = Grid("spherical_isotropic", {name: np.deg2rad(axis) for name, axis in axes.items()})
    _, theta_o, dphi = grid.coordinates()
    return Table(grid=grid, value=1.0 + np.cos(theta_o) + 0.3 * np.cos(dphi) * np.sin(theta_o))


def in_order(table: Table) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    index = np.flatnonzero(table.mask)
    wi, wo = table.directions(index)
    order = np.lexsort(np.round(np.concatenate([wi, wo], axis=1), 7).T)
    return wi[order], wo[order], table.value[index][order]


def test_formats_that_can_be_written():
    assert WRITABLE == [
        "astm", "delimited", "mbsdf", "merl", "netcdf", "openexr", "pab-opto", "parquet", "rgl", "zemax",
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["astm", "delimited", "netcdf", "pab-opto", "parquet"])
def test_scattered_round_trip(name: str, tmp_path: Path):
    table = scattered()
    losses = write(table, tmp_path / "out", name)
    back = load(tmp_path / "out")
    assert back.metadata.source_format == name
    for ours, theirs, allowed in zip(in_order(table), in_order(back), (1e-14, 1e-14, 0), strict=True):
        np.testing.assert_allclose(theirs, ours, rtol=0, atol=allowed)
    assert {loss.code for loss in losses} <= {"channels"}


@pytest.mark.parametrize("name", ["delimited", "netcdf", "parquet"])
@pytest.mark.parametrize("sample", SAMPLES, ids=lambda s: s.name)
def test_every_format_bit_for_bit(sample, name: str, tmp_path: Path):  # type: ignore[no-untyped-def]
    table = load(sample.data)
    assert write(table, tmp_path / "t", name) == []
    back = load(tmp_path / "t")
    assert back.hash == table.hash
    assert back.metadata.provenance == {**table.metadata.provenance, "file": "t"}


@pytest.mark.parametrize("sample", [s for s in SAMPLES if s.name != "merl"], ids=lambda s: s.name)
def test_every_format_to_astm(sample, tmp_path: Path):  # type: ignore[no-untyped-def]
    table = load(sample.data)
    write(table, tmp_path / "t.astm", "astm")
    back = load(tmp_path / "t.astm")
    for ours, theirs in zip(in_order(table), in_order(back), strict=True):
        np.testing.assert_allclose(theirs, ours, rtol=1e-14, atol=1e-14)


def test_what_is_lost_is_said(tmp_path: Path):
    plain = scattered(2)
    mask = np.ones(len(plain), bool)
    mask[:7] = False
    table = Table(
        wi=plain.wi, wo=plain.wo, value=plain.value, sigma=0.1 * plain.value, mask=mask,
        symmetry="anisotropic", channels=[Channel("R", 610.5), Channel("a b")],
        metadata=Metadata(name="n", scale_uncertainty=0.02, aperture=0.01, provenance={"operator": "A"}),
    )  # fmt: skip
    losses = {loss.code: loss.message for loss in write(table, tmp_path / "t.astm", "astm")}
    assert set(losses) == {
        "samples", "sigma", "channels", "symmetry", "scale_uncertainty", "aperture", "provenance"
    }  # fmt: skip
    assert "7" in losses["samples"]
    assert "operator" in losses["provenance"]
    for name in ("delimited", "parquet", "netcdf"):
        assert write(table, tmp_path / "t", name) == []
        back = load(tmp_path / "t")
        assert back.hash == table.hash
        assert (back.metadata.scale_uncertainty, back.metadata.aperture) == (0.02, 0.01)


def test_negatives_are_kept(tmp_path: Path):
    plain = scattered()
    value = plain.value.copy()
    value[5] = -0.25
    for keep in ("keep", "mask"):
        table = Table(wi=plain.wi, wo=plain.wo, value=value, negatives=keep)
        write(table, tmp_path / f"{keep}.astm", "astm")
        back = load(tmp_path / f"{keep}.astm", negatives="keep")
        assert back.value[5] == -0.25
        assert len(back) == len(table)


class TestMerl:
    @pytest.mark.parametrize("channels", [1, 3])
    def test_cells_are_exact(self, channels: int, tmp_path: Path):
        grid = merl_grid((6, 5, 8))
        value = np.random.default_rng(3).uniform(0.01, 5, (grid.size, channels))
        value[11] = -0.75
        table = Table(grid=grid, value=value)
        losses = write(table, tmp_path / "t.binary", "merl")
        back = load(tmp_path / "t.binary")
        np.testing.assert_array_equal(back.mask, table.mask)
        np.testing.assert_allclose(
            back.value[back.mask], np.broadcast_to(value, (len(value), 3))[back.mask], rtol=4e-16
        )
        np.testing.assert_allclose(back.value[11], -0.75, rtol=4e-16)
        assert [loss.code for loss in losses] == ["channels"] * (channels == 1)

    def test_other_tables_are_interpolated(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr(merl, "DIMS", (9, 9, 12))
        table = smooth()
        losses = {loss.code: loss.message for loss in write(table, tmp_path / "t.binary", "merl")}
        assert set(losses) == {"channels", "resampled"}
        back = load(tmp_path / "t.binary")
        index = np.flatnonzero(back.mask)
        assert losses["resampled"].startswith(f"{len(index)} of 972 cells")
        wi, wo = back.directions(index)
        found, outside = table.evaluate(wi, wo)
        assert not outside.any()
        np.testing.assert_allclose(back.value[index], np.broadcast_to(found, (len(index), 3)), rtol=1e-12)
        lost = np.flatnonzero(~back.mask & (back.wo[:, 2] > 0.01) & (back.wi[:, 2] > 0.01))
        assert table.evaluate(back.wi[lost], back.wo[lost])[1].all()

    def test_refused(self, tmp_path: Path):
        for table in (scattered(2), anisotropic()):
            with pytest.raises(TableError) as caught:
                write(table, tmp_path / "t.binary", "merl")
            assert caught.value.code == "table-unwritable"
            assert caught.value.remedy


class TestZemax:
    def test_its_own_grid_is_exact(self, tmp_path: Path):
        table = load(zemax_bytes())
        losses = write(table, tmp_path / "t.bsdf", "zemax")
        back = load(tmp_path / "t.bsdf")
        np.testing.assert_array_equal(back.value, table.value)
        np.testing.assert_array_equal(back.mask, table.mask)
        np.testing.assert_allclose(back.wo, table.wo, atol=1e-15)
        assert back.channels[0].wavelength_nm == 633
        assert {loss.code for loss in losses} <= {"provenance", "name"}

    def test_rotations_and_tristimulus(self, tmp_path: Path):
        i, p, a, r = (
            c.reshape(-1) for c in np.meshgrid(
                *map(np.deg2rad, ([20, 50], [0, 40], [0, 90, 180, 270], [0, 15, 30])), indexing="ij"
            )
        )  # fmt: skip
        value = np.random.default_rng(2).uniform(0.1, 1, (len(i), 3))
        value[r == 0] = 1.0
        table = Table(
            wi=directions.vector_from_spherical(i, p),
            wo=specular.outgoing(i, p, r, a),
            value=value,
            channels="XYZ",
        )
        assert write(table, tmp_path / "t.bsdf", "zemax") == []
        back = load(tmp_path / "t.bsdf")
        for ours, theirs in zip(in_order(table), in_order(back), strict=True):
            np.testing.assert_allclose(theirs, ours, atol=1e-14)
        assert back.symmetry == "anisotropic"

    def test_total_integrated_scatter_of_a_white_surface(self, tmp_path: Path):
        a, r = np.meshgrid(np.deg2rad(np.arange(0, 181, 10)), np.deg2rad(np.arange(0, 91, 2)), indexing="ij")
        wo = specular.outgoing(0.0, 0.0, r, a).reshape(-1, 3)
        table = Table(wi=np.tile([0.0, 0, 1], (len(wo), 1)), wo=wo, value=np.full(len(wo), 1 / np.pi))
        write(table, tmp_path / "t.bsdf", "zemax")
        tis = load(tmp_path / "t.bsdf").metadata.provenance["TIS"]["Monochrome"]
        assert tis == pytest.approx([1.0], rel=2e-3)

    def test_other_tables_are_interpolated(self, tmp_path: Path):
        table = smooth()
        losses = write(table, tmp_path / "t.bsdf", "zemax")
        assert "resampled" in {loss.code for loss in losses}
        back = load(tmp_path / "t.bsdf")
        inside = back.mask
        found, outside = table.evaluate(back.wi[inside], back.wo[inside])
        assert np.count_nonzero(outside) < 0.02 * len(outside)
        np.testing.assert_allclose(back.value[inside][~outside], found[~outside], rtol=1e-6)
        exact = 1.0 + back.wo[inside, 2] + 0.3 * back.wo[inside, 0]
        np.testing.assert_allclose(back.value[inside, 0], exact, rtol=5e-3)

    def test_refused(self, tmp_path: Path):
        for table in (scattered(3), anisotropic()):
            with pytest.raises(TableError) as caught:
                write(table, tmp_path / "t.bsdf", "zemax")
            assert caught.value.code == "table-unwritable"


def test_pab_opto_folder_must_be_empty(tmp_path: Path):
    (tmp_path / "x").write_bytes(b"1")
    with pytest.raises(TableError, match="not empty"):
        write(scattered(), tmp_path, "pab-opto")
    write(scattered(3, ["X", "Y", "Z"]), tmp_path / "new", "pab-opto")
    assert len(list((tmp_path / "new").iterdir())) == 3
    assert [c.name for c in load_all(tmp_path / "new")[0].channels] == ["X", "Y", "Z"]


def test_the_verb(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    source, out = tmp_path / "t.bsdf", tmp_path / "new" / "t.astm"
    source.write_bytes(zemax_bytes())
    assert main(["convert", str(source), "--format", "astm", "--out", str(out), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert {"code", "message"} == set(document["lost"][0])
    assert load(out).metadata.source_format == "astm"
    assert main(["convert", str(source), "--format", "pab-opto", "--out", str(tmp_path / "folder")]) == 0
    assert len(list((tmp_path / "folder").iterdir())) == 2


def test_unknown_format(tmp_path: Path):
    for name in ("alta", "nothing"):
        with pytest.raises(SpecError) as caught:
            write(scattered(), tmp_path / "t", name)
        assert caught.value.remedy is not None
        assert "astm" in caught.value.remedy


def test_a_failed_write_leaves_the_old_file(tmp_path: Path):
    path = tmp_path / "t.bsdf"
    path.write_bytes(b"old")
    with pytest.raises(TableError):
        write(scattered(3), path, "zemax")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def anisotropic() -> Table:
    rng = np.random.default_rng(4)
    w = [directions.vector_from_spherical(rng.uniform(0, 1.2, 60), rng.uniform(-3, 3, 60)) for _ in range(2)]
    return Table(wi=w[0], wo=w[1], value=rng.uniform(0.1, 1, 60), symmetry="anisotropic")
