"""Writing RGL tensor files: what is read back is the table's interpolant, and between them it comes close."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from fitter import directions
from fitter.errors import TableError
from fitter.export import subject, target
from fitter.formats import load, rgl_writer, write
from fitter.formats.rgl import adaptive_of
from fitter.formats.rgl_writer import lobe_width
from fitter.formats.source import Source
from fitter.formats.tensor_file import fields
from fitter.grid import Grid
from fitter.metadata import Channel
from fitter.sampling.parameterisation import Adaptive
from fitter.table import Table

FloatArray = np.ndarray


def opened(path: Path) -> Adaptive:
    source = Source(path)
    return adaptive_of(source, fields(source))[0]


def ggx(wi: FloatArray, wo: FloatArray, alpha: float) -> FloatArray:
    h = wi + wo
    c = h[:, 2] / np.linalg.norm(h, axis=1)
    return (
        alpha**2 / (np.pi * (c * c * (alpha**2 - 1) + 1) ** 2) / (4 * np.maximum(wi[:, 2] * wo[:, 2], 1e-9))
    )


def smooth(channels: int = 1, names: list[Channel] | None = None) -> Table:
    """1 + z_o + 0.3 x_o on a grid of absolute angles, times 1, 2, ..."""
    axes = {"theta_i": [0, 25, 50], "theta_o": np.arange(0, 81, 4), "dphi": np.arange(0, 181, 10)}
    grid = Grid("spherical_isotropic", {name: np.deg2rad(axis) for name, axis in axes.items()})
    _, theta_o, dphi = grid.coordinates()
    value = 1.0 + np.cos(theta_o) + 0.3 * np.cos(dphi) * np.sin(theta_o)
    return Table(grid=grid, value=np.outer(value, np.arange(1, channels + 1)), channels=names)


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rgl_writer, "_STEPS", ((10**6, (24,)),))


@pytest.mark.usefixtures("few")
class TestRoundTrip:
    def test_samples_are_the_interpolant(self, tmp_path: Path):
        table = smooth(3)
        losses = write(table, tmp_path / "t.bsdf", "rgl")
        assert [loss.code for loss in losses] == ["resampled"]
        back = load(tmp_path / "t.bsdf", duplicates="keep")
        assert back.metadata.source_format == "rgl"
        assert not any("negative" in note for note in back.metadata.notes)
        assert losses[0].message.startswith(f"{int(back.mask.sum())} samples were interpolated")
        found, outside = table.evaluate(back.wi[back.mask], back.wo[back.mask])
        assert not outside.any()
        np.testing.assert_allclose(back.value[back.mask], found, rtol=2e-7)
        marked = np.flatnonzero(~back.mask & (back.wo[:, 2] > 1e-6))
        assert len(marked) > 0
        # At the very edge the rounding of float32 decides.
        assert table.evaluate(back.wi[marked], back.wo[marked])[1].mean() > 0.99

    def test_between_the_samples(self, tmp_path: Path):
        write(smooth(), tmp_path / "t.bsdf", "rgl")
        rng = np.random.default_rng(1)
        wi = directions.vector_from_spherical(rng.uniform(0, np.deg2rad(50), 500), rng.uniform(-3, 3, 500))
        wo = directions.vector_from_spherical(rng.uniform(0, 1.2, 500), rng.uniform(-3, 3, 500))
        along = (wi[:, :2] * wo[:, :2]).sum(axis=1) / np.hypot(wi[:, 0], wi[:, 1])
        found = opened(tmp_path / "t.bsdf").evaluate(wi, wo)[:, 0] / wo[:, 2]
        np.testing.assert_allclose(found, 1 + wo[:, 2] + 0.3 * along, rtol=0.05)
        assert np.median(np.abs(found / (1 + wo[:, 2] + 0.3 * along) - 1)) < 5e-3

    def test_one_channel(self, tmp_path: Path):
        losses = write(smooth(), tmp_path / "t.bsdf", "rgl")
        assert [loss.code for loss in losses] == ["channels", "resampled"]
        assert [c.name for c in load(tmp_path / "t.bsdf").channels] == ["R", "G", "B"]

    def test_spectrum(self, tmp_path: Path):
        names = [Channel("a", 700.0), Channel("b", 450.1)]
        write(smooth(2, names), tmp_path / "t.bsdf", "rgl")
        back = load(tmp_path / "t.bsdf")
        assert [c.wavelength_nm for c in back.channels] == [450.1, 700.0]
        np.testing.assert_allclose(back.value[back.mask, 0], 2 * back.value[back.mask, 1], rtol=1e-6)

    def test_no_spectrum_where_two_have_one_wavelength(self, tmp_path: Path):
        names = [Channel("a", 600.0), Channel("b", 500.0), Channel("c", 500.0)]
        table = smooth(3, names)
        written = target("rgl").write(subject(table), tmp_path / "t.bsdf")
        back = load(tmp_path / "t.bsdf")
        assert [(c.name, c.wavelength_nm) for c in back.channels] == [("R", None), ("G", None), ("B", None)]
        np.testing.assert_allclose(back.value[back.mask, 2], 3 * back.value[back.mask, 0], rtol=1e-6)
        (fidelity,) = [note for note in written.notes if note.code == "fidelity"]
        median = re.search(r"by ([\d.]+)% in the median", fidelity.message)
        assert median is not None
        assert float(median[1]) < 1.0

    def test_negative_values_stay(self, tmp_path: Path):
        plain = smooth(3)
        table = Table(grid=plain.grid, value=plain.value - 1.5, negatives="keep")
        write(table, tmp_path / "t.bsdf", "rgl")
        back = load(tmp_path / "t.bsdf", negatives="keep")
        assert (back.value[back.mask] < 0).any()
        found, _ = table.evaluate(back.wi[back.mask], back.wo[back.mask])
        np.testing.assert_allclose(back.value[back.mask], found, rtol=1e-6, atol=1e-6)

    def test_what_renderers_ask_for(self, tmp_path: Path):
        """Names, types and shapes that Mitsuba's reader checks."""
        write(smooth(3), tmp_path / "t.bsdf", "rgl")
        found = fields(Source(tmp_path / "t.bsdf"))
        shapes = {name: (str(field.dtype), field.shape) for name, field in found.items()}
        assert shapes.pop("description")[0] == shapes.pop("valid")[0] == "uint8"
        assert shapes == {
            "version": ("uint32", (2,)), "phi_i": ("float32", (1,)), "theta_i": ("float32", (9,)),
            "sigma": ("float32", (2, 128)), "ndf": ("float32", (2, 128)),
            "vndf": ("float32", (1, 9, 128, 128)), "luminance": ("float32", (1, 9, 24, 24)),
            "rgb": ("float32", (1, 9, 3, 24, 24)), "jacobian": ("uint8", (1,)),
            "measured": ("uint8", (1, 9, 24, 24)),
        }  # fmt: skip
        assert (found["luminance"] > 0).all()
        for name in ("sigma", "ndf", "vndf", "rgb"):
            assert np.isfinite(found[name]).all()


def test_anisotropic(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A surface that is brighter along x: at the samples, and between them."""
    monkeypatch.setattr(rgl_writer, "_STEPS", ((10**6, (16,)),))

    def bright(wi: FloatArray, wo: FloatArray) -> FloatArray:
        return 1.0 + 0.4 * (wi[:, 0] + wo[:, 0]) ** 2 + 0.1 * wi[:, 1] * wo[:, 0]

    axes = {
        "theta_i": [0, 15, 30, 45], "phi_i": np.arange(-180, 180, 15), "theta_o": np.arange(0, 81, 8),
        "phi_o": np.arange(-180, 180, 15),
    }  # fmt: skip
    grid = Grid(
        "spherical", {name: np.deg2rad(axis) for name, axis in axes.items()},
        {"phi_i": 2 * np.pi, "phi_o": 2 * np.pi},
    )  # fmt: skip
    wi, wo = grid.directions()
    table = Table(grid=grid, value=bright(wi, wo))
    assert {loss.code for loss in write(table, tmp_path / "t.bsdf", "rgl")} == {"channels", "resampled"}
    back = load(tmp_path / "t.bsdf")
    assert back.symmetry == "anisotropic"
    own = np.flatnonzero(back.mask)[::7]
    found, outside = table.evaluate(back.wi[own], back.wo[own])
    np.testing.assert_allclose(back.value[own][~outside], np.tile(found, 3)[~outside], rtol=1e-6)
    assert outside.mean() < 0.01
    rng = np.random.default_rng(1)
    wi = directions.vector_from_spherical(rng.uniform(0, 0.75, 500), rng.uniform(-3.1, 3.1, 500))
    wo = directions.vector_from_spherical(rng.uniform(0, 1.0, 500), rng.uniform(-3.1, 3.1, 500))
    between = opened(tmp_path / "t.bsdf").evaluate(wi, wo)[:, 0] / wo[:, 2]
    assert np.median(np.abs(between / bright(wi, wo) - 1)) < 0.01
    np.testing.assert_allclose(between, bright(wi, wo), rtol=0.1)


@pytest.mark.usefixtures("few")
def test_one_incidence(tmp_path: Path):
    plain = smooth(3)
    wi, wo = plain.grid.directions() if plain.grid is not None else (plain.wi, plain.wo)
    one = wi[:, 2] < 0.7
    table = Table(wi=wi[one], wo=wo[one], value=plain.value[one])
    write(table, tmp_path / "t.bsdf", "rgl")
    assert load(tmp_path / "t.bsdf").domain.incidences == 1


@pytest.mark.parametrize("alpha", [0.02, 0.05, 0.15])
def test_the_width_of_the_lobe(alpha: float):
    rng = np.random.default_rng(2)
    wi = np.tile(directions.vector_from_spherical(np.deg2rad([5.0, 30.0, 60.0]), 0.0), (4000, 1))
    m = directions.vector_from_spherical(rng.uniform(0, 1, 12000) ** 2 * 1.2, rng.uniform(-3, 3, 12000))
    wo = 2 * (m * wi).sum(axis=1, keepdims=True) * m - wi
    above = wo[:, 2] > 0.05
    wi, wo = wi[above], wo[above]
    assert lobe_width(wi, wo, ggx(wi, wo, alpha)) == pytest.approx(alpha, rel=0.3)
    assert lobe_width(wi, wo, np.full(len(wi), 0.3)) == 0.2


@pytest.mark.usefixtures("few")
def test_a_narrow_lobe_is_found_again(tmp_path: Path):
    """A mirror-like lobe over a diffuse base, of which the table has directions about the specular one."""
    alpha = 0.05
    theta_i = np.deg2rad([10.0, 30.0, 50.0])
    u = np.concatenate([np.linspace(0, 0.35, 30) ** 2, np.linspace(0.15, 1.2, 22)])
    i, t, p = (g.reshape(-1) for g in np.meshgrid(theta_i, u, np.linspace(0, np.pi, 19), indexing="ij"))
    wi, m = directions.vector_from_spherical(i, 0.0), directions.vector_from_spherical(t, p)
    wo = 2 * (m * wi).sum(axis=1, keepdims=True) * m - wi
    above = wo[:, 2] > 0.1
    wi, wo = wi[above], wo[above]
    table = Table(wi=wi, wo=wo, value=0.2 + 0.1 * ggx(wi, wo, alpha))
    write(table, tmp_path / "t.bsdf", "rgl")
    near = directions.half_difference_from_vectors(wi, wo)[0] < 0.1
    found = opened(tmp_path / "t.bsdf").evaluate(wi[near], wo[near])[:, 0] / wo[near, 2]
    np.testing.assert_allclose(found, table.value[near, 0], rtol=0.05)


@pytest.mark.usefixtures("few")
def test_refused(tmp_path: Path):
    theta = np.deg2rad(np.arange(0, 80, 5.0))
    wi, wo = (
        np.tile(directions.vector_from_spherical(0.5, 0.0), (16, 1)),
        directions.vector_from_spherical(theta, np.pi),
    )
    rng = np.random.default_rng(4)
    w = [directions.vector_from_spherical(rng.uniform(0, 1.2, 60), rng.uniform(-3, 3, 60)) for _ in "io"]
    few = Table(wi=w[0], wo=w[1], value=rng.uniform(0.1, 1, 60), symmetry="anisotropic")
    for table in (Table(wi=wi, wo=wo, value=np.ones(16)), smooth(2), few):
        with pytest.raises(TableError) as caught:
            write(table, tmp_path / "t.bsdf", "rgl")
        assert caught.value.code == "table-unwritable"
        assert caught.value.remedy
        assert not list(tmp_path.iterdir())


@pytest.mark.measured
@pytest.mark.usefixtures("few")
def test_a_measured_one_again(shared: Path, tmp_path: Path):
    table = load(shared / "measured/rgl/cm_military_green_rgb.bsdf")
    losses = {loss.code: loss.message for loss in write(table, tmp_path / "t.bsdf", "rgl")}
    print(losses["resampled"])
    assert set(losses) == {"resampled"}
    near = np.flatnonzero(table.mask & (table.wo[:, 2] > 0.3))
    wi, wo = table.directions(near)
    found = opened(tmp_path / "t.bsdf").evaluate(wi, wo) / wo[:, 2:]
    change = np.abs(found - table.value[near]) / table.value[near].mean(axis=1, keepdims=True)
    assert np.median(change) < 0.025
    assert np.quantile(change, 0.95) < 0.2
