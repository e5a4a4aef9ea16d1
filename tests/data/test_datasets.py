"""Sample tables and constants as the product finds and loads them."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fitter
from fitter import datasets
from fitter.directions import half_difference_from_vectors, spherical_from_vector

NAMES = ("brushed_metal", "diffuse_plaster", "glossy_paint")


def angles(table: fitter.Table) -> tuple[np.ndarray, ...]:
    """theta_i, theta_o and phi_o - phi_i in [0, 360), all in degrees."""
    theta_i, phi_i = spherical_from_vector(table.wi)
    theta_o, phi_o = spherical_from_vector(table.wo)
    return np.rad2deg(theta_i), np.rad2deg(theta_o), np.round(np.rad2deg(phi_o - phi_i), 6) % 360.0


def plane(
    table: fitter.Table, theta_i: float, where: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """One sweep in the plane of incidence: signed theta_o (positive: specular side) and values (n, C)."""
    ti, to, dphi = angles(table)
    keep = (np.abs(ti - theta_i) < 1e-6) & (np.isin(dphi, (0.0, 180.0)) | (to < 1e-6))
    if where is not None:
        keep &= where
    signed = np.where(dphi == 180.0, to, -to)[keep]
    order = np.argsort(signed)
    return signed[order], table.value[keep][order]


def test_every_sample_is_described() -> None:
    described = datasets.samples()
    assert tuple(described) == NAMES
    assert [text.split(":")[0] for text in described.values()] == ["anisotropic", "diffuse", "glossy"]


def test_unknown_names_are_answered_with_the_known_ones() -> None:
    with pytest.raises(fitter.SpecError, match="brushed_metal, diffuse_plaster, glossy_paint") as caught:
        datasets.sample("plaster")
    assert caught.value.code == "unknown-dataset"
    with pytest.raises(fitter.SpecError, match="lafortune_cornell, ward_1992"):
        datasets.constants("../tables/diffuse_plaster")


def test_missing_data_is_a_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(datasets, "_HERE", tmp_path / "fitter")
    with pytest.raises(fitter.SpecError, match="without its data folder"):
        datasets.samples()


def test_an_installed_wheel_is_searched_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "fitter" / "_data" / "tables"
    folder.mkdir(parents=True)
    (folder / "only.csv").write_text("# name: only\ntheta_i_deg\n")
    monkeypatch.setattr(datasets, "_HERE", tmp_path / "fitter")
    assert datasets.samples() == {"only": ""}
    assert datasets.sample("only") == folder / "only.csv"


def test_finding_data_does_not_load_jax() -> None:
    code = "import sys; from fitter import datasets; datasets.samples(); sys.exit('jax' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).resolve().parents[2])


def test_samples_are_small() -> None:
    assert sum(datasets.sample(name).stat().st_size for name in NAMES) < 1_500_000


@pytest.mark.parametrize("name", NAMES)
def test_samples_load_with_what_they_state(name: str) -> None:
    table = fitter.load(datasets.sample(name))
    assert table.symmetry == ("anisotropic" if name == "brushed_metal" else "isotropic")
    assert [channel.name for channel in table.channels] == ["R", "G", "B"]
    assert (table.sigma is None) == (name == "diffuse_plaster")
    assert table.metadata.quantity == "brdf"
    assert table.metadata.scale_uncertainty == pytest.approx(0.008 if name == "brushed_metal" else 0.005)
    assert table.metadata.aperture == pytest.approx(np.deg2rad(4.0 if name == "diffuse_plaster" else 3.0))
    assert table.metadata.angle_uncertainty is not None
    assert table.domain.incidences == (20 if name == "brushed_metal" else 7)
    assert not table.domain.in_plane
    # Nothing but negative readings is masked, and every one of them is kept as measured.
    negative = int((table.value < 0).any(axis=1).sum())
    assert table.metadata.masked == ({"negative": negative} if negative else {})
    assert (negative > 0) == (name == "brushed_metal")


@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_seen_from_behind_the_source(name: str) -> None:
    table = fitter.load(datasets.sample(name))
    apart = np.rad2deg(np.arccos(np.clip((table.wi * table.wo).sum(axis=1), -1.0, 1.0)))
    assert apart.min() >= 4.0
    ti, to, dphi = angles(table)
    assert not np.any((dphi == 0.0) & (to > ti) & (to > 1e-6))


def test_some_scans_were_broken_off() -> None:
    ti, to, _ = angles(fitter.load(datasets.sample("diffuse_plaster")))
    assert {float(np.round(to[np.isclose(ti, t)].max())) for t in (5.0, 35.0, 70.0)} == {85.0, 80.0, 75.0}


@pytest.mark.parametrize("theta_i", [5.0, 15.0, 30.0, 45.0])
def test_paint_is_brightest_in_the_specular_direction(theta_i: float) -> None:
    theta, value = plane(fitter.load(datasets.sample("glossy_paint")), theta_i)
    for channel in range(3):
        assert abs(theta[np.argmax(value[:, channel])] - theta_i) < 5.0


def test_plaster_is_brightest_towards_the_source() -> None:
    theta, value = plane(fitter.load(datasets.sample("diffuse_plaster")), 60.0)
    for channel in range(3):
        assert theta[np.argmax(value[:, channel])] < -45.0
        assert value[theta < -45.0, channel].mean() > 2.0 * value[theta > 45.0, channel].mean()


def test_metal_scatters_across_its_grooves() -> None:
    table = fitter.load(datasets.sample("brushed_metal"))
    phi_i = np.round(np.rad2deg(spherical_from_vector(table.wi)[1])) % 360

    def width(azimuth: float) -> float:
        theta, value = plane(table, 40.0, phi_i == azimuth)
        bright = theta[value[:, 0] > 0.5 * value[:, 0].max()]
        assert abs(bright.mean() - 40.0) < 4.0
        return float(np.ptp(bright))

    assert width(90.0) > 2.0 * width(0.0)


def test_noise_is_what_is_stated() -> None:
    table = fitter.load(datasets.sample("diffuse_plaster"))
    scatter: list[float] = []
    for theta_i in (20.0, 35.0, 50.0):
        theta, value = plane(table, theta_i)
        inner = (theta > -15.0) & (theta < 60.0)
        # Second differences of a smooth curve are noise: their variance is 6 times that of a value.
        scatter += list((np.diff(np.log(value[inner]), n=2, axis=0) ** 2).ravel() / 6.0)
    assert 0.008 < np.sqrt(np.mean(scatter)) < 0.018

    table = fitter.load(datasets.sample("brushed_metal"))
    assert table.sigma is not None
    # Where no facet is steep enough to mirror the source, the metal shows the weak background of its specks,
    # even but for shadows, and the detector's floor dominates. (Nearer, tails of the lobe stand out of it.)
    dark = half_difference_from_vectors(table.wi, table.wo)[0] > np.deg2rad(45.0)
    assert dark.sum() > 500
    signal, sigma = table.value[dark], table.sigma[dark]
    background = np.average(signal, weights=sigma**-2.0, axis=0)
    assert np.mean(((signal - background) / sigma) ** 2) == pytest.approx(1.0, abs=0.15)


def test_constants_are_the_published_ones() -> None:
    def rows(name: str) -> list[dict[str, str]]:
        lines = datasets.constants(name).read_text(encoding="utf-8").splitlines()
        assert any(line.startswith("# source:") for line in lines)
        return list(csv.DictReader(line for line in lines if not line.startswith("#")))

    ward = {row.pop("material"): row for row in rows("ward_1992")}
    assert len(ward) == 9
    assert "varnished_plywood" not in ward
    assert ward["rolled_brass"] == {"rho_d": "0.10", "rho_s": "0.33", "alpha_x": "0.050", "alpha_y": "0.16"}
    lobes = rows("lafortune_cornell")
    assert len({row["material"] for row in lobes}) == 6
    assert len(lobes) == 6 * 3 * 3


@pytest.mark.measured
@pytest.mark.parametrize("name", ["ward_1992", "lafortune_cornell"])
def test_constants_agree_with_the_oracles(name: str, shared: Path) -> None:
    def rows(path: Path) -> set[str]:
        return {line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")}

    left_out = rows(shared / "oracles" / f"{name}.csv") - rows(datasets.constants(name))
    assert [line.split(",")[0] for line in left_out] == (["varnished_plywood"] if name == "ward_1992" else [])
