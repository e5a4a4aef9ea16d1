"""The picture of a table: what is drawn is what was measured, and it draws for every table."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure

import fitter
from fitter import datasets, directions
from fitter.formats import load, load_all
from fitter.grid import Grid
from fitter.report.portrait import portrait
from fitter.report.portrait_figure import draw, png
from fitter.table import Table
from tests.formats.samples import SAMPLES, Sample
from tests.quality.tables import glossy, table

PNG = b"\x89PNG\r\n\x1a\n"


def texts(figure: Figure) -> str:
    found = [text.get_text() for text in figure.texts]
    for axes in figure.axes:
        found += [axes.get_title(), axes.get_title("left"), *(text.get_text() for text in axes.texts)]
    return "\n".join(found)


@pytest.mark.parametrize("name", list(datasets.samples()))
def test_slices_have_the_measured_values(name: str):
    measured = fitter.load(datasets.sample(name))
    found = portrait(measured)
    assert found.plane_deg == 0.25
    level = measured.value.mean(axis=1)
    phi = np.deg2rad(found.azimuth_deg or 0.0)
    for cut in found.cuts:
        assert (np.diff(cut.theta_o_deg) > 0).all()
        wi = directions.vector_from_spherical(np.deg2rad(cut.theta_i_deg), phi)
        for theta, value in list(zip(cut.theta_o_deg, cut.value, strict=True))[::5]:
            wo = directions.vector_from_spherical(np.deg2rad(theta), phi + np.pi)  # positive: specular side
            near = np.linalg.norm(measured.wi - wi, axis=1) + np.linalg.norm(measured.wo - wo, axis=1)
            assert near.min() < 1e-3
            assert level[np.argmin(near)] == pytest.approx(value)
    # Every usable sample is counted once, and every disk's samples are the incidence's.
    assert found.counts.sum() == measured.mask.sum()
    assert found.counts.sum() + found.masked.sum() == len(measured)
    theta_i = np.rad2deg(directions.spherical_from_vector(measured.wi)[0])
    for disk in found.disks:
        same = np.abs(theta_i - disk.theta_i_deg) < 0.1
        if disk.phi_i_deg is not None:
            turn = np.rad2deg(directions.spherical_from_vector(measured.wi)[1]) - disk.phi_i_deg
            same &= np.abs((turn + 180) % 360 - 180) < 0.1
        assert (~disk.mirrored).sum() == (same & measured.mask).sum()
        assert len(disk.masked) == (same & ~measured.mask).sum()


def test_a_grid_is_drawn_as_its_function():
    axes = {
        "theta_i": np.deg2rad([20.0, 40.0, 60.0]), "theta_o": np.deg2rad(np.arange(0.0, 81.0, 5.0)),
        "dphi": np.deg2rad(np.arange(0.0, 181.0, 10.0)),
    }  # fmt: skip
    grid = Grid("spherical_isotropic", axes)
    wi, wo = grid.directions()
    value = glossy(wi, wo)
    lost = (wo[:, 2] > 0.9) & (wo[:, 1] > 0.2)
    value[lost] = np.nan
    found = portrait(Table(grid=grid, value=value))
    assert [disk.theta_i_deg for disk in found.disks] == pytest.approx([20, 40, 60])
    disk = found.disks[1]
    assert disk.raster
    here = directions.vector_from_spherical(np.deg2rad(disk.theta_o_deg), disk.turn)
    seen = np.isfinite(disk.value)
    assert not seen[disk.theta_o_deg > 82].any()
    light = directions.vector_from_spherical(np.deg2rad(40.0), 0.0)
    peak = here[seen][np.argmax(disk.value[seen])]
    assert peak @ directions.mirror(light) > np.cos(np.deg2rad(8.0))
    exact = glossy(np.broadcast_to(light, here.shape), here)
    np.testing.assert_allclose(disk.value[seen], exact[seen], rtol=0.35)
    assert found.counts.sum() == len(value) - lost.sum()
    assert draw(found).get_figheight() > 8


def test_samples_off_the_normal_decide_what_is_near_the_plane():
    """Cell centres at 1 degree from the plane: near the normal they are all in it, at 60 degrees none is."""
    axes = {
        "theta_i": np.deg2rad(np.arange(5.0, 85.0, 10.0)), "theta_o": np.deg2rad(np.arange(1.0, 90.0, 2.0)),
        "dphi": np.deg2rad(np.arange(1.0, 180.0, 2.0)),
    }  # fmt: skip
    grid = Grid("spherical_isotropic", axes)
    found = portrait(Table(grid=grid, value=glossy(*grid.directions())))
    assert found.plane_deg == 1.0
    for cut in found.cuts:
        assert cut.theta_o_deg.min() == pytest.approx(-89)
        assert cut.theta_o_deg.max() == pytest.approx(89)


def test_what_the_picture_says():
    clean = table()
    figure = clean.plot()
    assert isinstance(figure, Figure)
    said = texts(figure)
    for words in ("synthetic", "isotropic", "values stored as f_r", "dashed: specular", "rings: θ_o"):
        assert words in said
    assert "blind, no usable sample" not in said
    wi, wo = clean.wi, clean.wo
    cone = (wi * wo).sum(axis=1) < np.cos(np.deg2rad(25.0))
    figure = table(clean.value[cone], wi=wi[cone], wo=wo[cone]).plot()
    assert "blind, no usable sample" in texts(figure)
    assert "% blind" in texts(figure)
    marks = [line for axes in figure.axes for line in axes.lines if line.get_linestyle() == "--"]
    assert len(marks) >= len(portrait(clean).cuts)


def test_names_of_strangers_are_only_text():
    odd = fitter.Metadata(name="$\\frac{a}$ \x00 " + "x" * 300)
    w = directions.vector_from_spherical(np.deg2rad([10.0, 20.0]), 0.0)
    made = Table(wi=w, wo=directions.mirror(w), value=[1.0, 2.0], channels=["$x_{1"], metadata=odd)
    assert png(made.plot()).startswith(PNG)


def test_in_plane_tables_have_the_upper_row_only():
    theta = np.deg2rad(np.arange(0.0, 80.0, 4.0))
    wi = np.broadcast_to(directions.vector_from_spherical(np.deg2rad(40.0), 0.0), (len(theta), 3))
    figure = table(wi=wi, wo=directions.vector_from_spherical(theta, np.pi)).plot()
    assert figure.get_figheight() < 6


@pytest.mark.long
@pytest.mark.parametrize("sample", SAMPLES, ids=lambda one: one.name)
def test_every_format_can_be_drawn(sample: Sample):
    for one in load_all(sample.data):
        assert png(one.plot()).startswith(PNG)


@settings(max_examples=8)
@given(
    st.integers(0, 2**32 - 1), st.integers(1, 40), st.booleans(),
    st.sampled_from([0.0, 1e-60, 1.0, 1e60]), st.sampled_from(["isotropic", "anisotropic"]),
)  # fmt: skip
def test_any_table_can_be_drawn(seed: int, count: int, plane: bool, scale: float, symmetry: Any):
    rng = np.random.default_rng(seed)
    turns = np.full(count, np.pi) if plane else rng.uniform(-3, 3, count)
    wi = directions.vector_from_spherical(rng.choice([0.0, 0.3, 1.5], count), 0.0)
    wo = directions.vector_from_spherical(rng.uniform(0, 1.57, count), turns)
    value = scale * rng.lognormal(size=count)
    value[rng.random(count) < 0.2] *= -1
    value[0] = scale
    made = Table(wi=wi, wo=wo, value=value, symmetry=symmetry, negatives=rng.choice(["mask", "keep"]))
    assert png(made.plot()).startswith(PNG)


def test_a_logarithmic_scale_may_hold_no_power_of_ten():
    theta = np.deg2rad(np.linspace(0, 80, 17))
    wi = np.broadcast_to(directions.vector_from_spherical(np.deg2rad(40.0), 0.0), (17, 3))
    value = np.where(np.arange(17) == 8, 0.9, 0.13)
    figure = Table(wi=wi, wo=directions.vector_from_spherical(theta, np.pi), value=value).plot()
    assert "logarithmic" in texts(figure)
    assert png(figure).startswith(PNG)


@pytest.mark.measured
@pytest.mark.parametrize(
    ("path", "options"),
    [
        ("retro/retro-3M-jaune.dat", {}), ("rgl/vch_silk_blue_rgb.bsdf", {}),
        ("mwir/brass.csv", {"convention": "forward"}), ("ua_loft/AnoBlackNiTEonSteel.bsdf", {}),
        ("cornell/garnet_red_RGB.astm", {}),
    ],
)  # fmt: skip
def test_measured_tables_can_be_drawn(path: str, options: dict[str, Any], shared: Path):
    found = portrait(load(shared / "measured" / path, **options))
    assert found.cuts
    assert png(draw(found)).startswith(PNG)


@pytest.mark.measured
def test_the_lamp_hides_what_is_behind_it(shared: Path):
    """Cornell's gonioreflectometer: the source's arm stands in front of the detector around the light."""
    found = portrait(load(shared / "measured/cornell/garnet_red_RGB.astm"))
    assert found.blind_share is not None
    assert 0.05 < found.blind_share < 0.4
    for disk in found.disks:
        blind = directions.vector_from_spherical(np.deg2rad(disk.blind[:, 0]), disk.blind[:, 1])
        light = directions.vector_from_spherical(np.deg2rad(disk.theta_i_deg), 0.0)
        assert (blind @ light).max() > np.cos(np.deg2rad(3.0))


def test_a_picture_needs_no_jax_and_no_global_state(tmp_path: Path):
    code = """if True:
        import sys
        import fitter
        figure = fitter.load(fitter.datasets.sample("diffuse_plaster")).plot()
        figure.savefig(sys.argv[1])
        print({"jax", "matplotlib.pyplot"} & set(sys.modules))
    """
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "t.png")], capture_output=True, text=True, check=True
    )
    assert done.stdout == "set()\n"
    assert (tmp_path / "t.png").read_bytes().startswith(PNG)
