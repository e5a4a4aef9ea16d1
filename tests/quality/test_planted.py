"""Faults planted in files and grids: what the check says leads to the file read rightly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fitter.directions import mirror, vector_from_spherical
from fitter.formats import load
from fitter.grid import Grid
from fitter.metadata import Metadata
from fitter.quality import check
from fitter.table import Table
from tests.quality.tables import directions, glossy, table


def text(convention: str | None, columns: dict[str, np.ndarray], value: np.ndarray) -> bytes:
    head = ["# quantity: brdf", *([f"# convention: {convention}"] if convention else [])]
    rows = [",".join([*columns, "brdf"])]
    for row in zip(*(column.tolist() for column in columns.values()), value.tolist(), strict=True):
        rows.append(",".join(map(repr, row)))
    return "\n".join([*head, *rows, ""]).encode()


def angles(degrees: bool = True) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """A made-up measurement as columns, mirror reflection at dphi = 180."""
    wi, wo = directions()
    theta_i, theta_o = np.arccos(np.clip(wi[:, 2], -1, 1)), np.arccos(np.clip(wo[:, 2], -1, 1))
    dphi = np.arctan2(wo[:, 1], wo[:, 0])
    unit = "deg" if degrees else "rad"
    columns = {f"theta_i_{unit}": theta_i, f"theta_o_{unit}": theta_o, f"dphi_{unit}": dphi}
    return {k: np.rad2deg(v) if degrees else v for k, v in columns.items()}, glossy(wi, wo)


@pytest.mark.parametrize("truth", ["phi_specular_180", "phi_specular_0"])
def test_the_suggested_azimuths_are_the_right_ones(truth: str):
    """Declared as the other one; read with what is suggested, the peaks sit where they should."""
    columns, value = angles()
    if truth == "phi_specular_0":
        columns["dphi_deg"] = columns["dphi_deg"] + 180.0
    other = {"phi_specular_180": "phi_specular_0", "phi_specular_0": "phi_specular_180"}[truth]
    data = text(other, columns, value)
    found = check(load(data))["convention"]
    assert found.verdict == "warning"
    assert found.numbers["suggested"] == truth
    assert truth in found.sentence
    mended = check(load(data, convention=found.numbers["suggested"]))["convention"]
    assert (mended.verdict, mended.judged, mended.numbers["suggested"]) == ("ok", True, None)


@pytest.mark.parametrize("truth", ["forward", "back"])
def test_the_suggested_side_of_an_in_plane_table_is_the_right_one(truth: str):
    theta_i, theta_o = (
        c.reshape(-1)
        for c in np.meshgrid([15.0, 30.0, 45.0, 60.0, 75.0], np.arange(-80.0, 81, 5), indexing="ij")
    )  # fmt: skip
    wi = vector_from_spherical(np.deg2rad(theta_i), 0.0)
    wo = vector_from_spherical(np.deg2rad(theta_o), np.pi)
    sign = 1.0 if truth == "forward" else -1.0
    data = text(None, {"theta_i_deg": theta_i, "theta_o_deg": sign * theta_o}, glossy(wi, wo))
    other = {"forward": "back", "back": "forward"}[truth]
    found = check(load(data, convention=other))["convention"]
    assert (found.verdict, found.numbers["suggested"]) == ("warning", truth)
    assert check(load(data, convention=truth))["convention"].verdict == "ok"


def test_the_suggested_quantity_is_the_right_one():
    columns, value = angles()
    data = text(None, columns, value * np.cos(np.deg2rad(columns["theta_o_deg"])))
    found = check(load(data))["quantity"]
    assert (found.verdict, found.numbers["suggested"]) == ("warning", "ccbrdf")
    assert check(load(data, quantity=found.numbers["suggested"]))["quantity"].verdict == "ok"


def lobe_grid(system: str, width: float, spacing: float = 1.0) -> Grid:
    nodes = np.deg2rad(np.arange(0.0, 81, spacing))
    if system == "half_difference":
        # As wide in half vectors as half of what it is in directions.
        axes = {"theta_h": np.deg2rad(np.linspace(0, 80, 321)), "theta_d": nodes[:: int(8 / spacing)],
                "phi_d": np.deg2rad(np.arange(5.0, 180, 10))}  # fmt: skip
        return Grid(system, axes, {"phi_d": np.pi})
    incidences, dphi = np.deg2rad([20.0, 40.0, 60.0]), np.deg2rad(np.arange(0.0, 181, 5))
    return Grid(system, {"theta_i": incidences, "theta_o": nodes, "dphi": dphi})


def lobe(wi: np.ndarray, wo: np.ndarray, width: float) -> np.ndarray:
    """Gaussian about the mirror direction, full width at half maximum in degrees."""
    off = np.rad2deg(np.arccos(np.clip((mirror(wi) * wo).sum(axis=1), -1, 1)))
    return 0.01 + np.exp(-4 * np.log(2) * (off / width) ** 2)


@pytest.mark.parametrize("system", ["spherical_isotropic", "half_difference"])
@pytest.mark.parametrize(
    ("aperture", "verdict"), [(1.0, "ok"), (4.0, "notice"), (7.0, "warning"), (20.0, "warning")]
)
def test_a_lobe_of_a_grid_against_the_aperture(system: str, aperture: float, verdict: str):
    grid = lobe_grid(system, 10.0)
    meta = Metadata(name="g", aperture=float(np.deg2rad(aperture)))
    given = Table(grid=grid, value=lobe(*grid.directions(), 10.0), metadata=meta)
    found = check(given)["lobe_width"]
    assert found.numbers["fwhm_deg"] == pytest.approx(10.0, abs=1.2)
    assert found.numbers["fwhm_over_aperture"] == pytest.approx(10.0 / aperture, rel=0.12)
    assert found.verdict == verdict
    assert ("no instrument shows that" in found.sentence) is (aperture > 10)
    counted = found.numbers["samples_in_fwhm"]
    assert counted is None if system == "half_difference" else 8 <= counted <= 12


def test_a_raster_too_coarse_for_the_lobe():
    """Nodes every 5 degrees, a lobe of 6: one or two samples across."""
    grid = lobe_grid("spherical_isotropic", 6.0, spacing=5.0)
    found = check(Table(grid=grid, value=lobe(*grid.directions(), 6.0)))["lobe_width"]
    assert found.verdict == "notice"
    assert found.numbers["samples_in_fwhm"] < 3
    assert "fewer than three samples across" in found.sentence


def test_noise_does_not_cut_a_lobe_short():
    """Every fourth sample of a broad lobe reads next to nothing, as of a flake that looks elsewhere."""
    theta = np.deg2rad(np.arange(-80.0, 80.5, 0.5))
    wi = np.repeat(vector_from_spherical(np.deg2rad([20.0, 40.0]), np.pi), len(theta), axis=0)
    wo = np.tile(vector_from_spherical(theta, 0.0), (2, 1))
    value = lobe(wi, wo, 12.0)
    value[::4] *= 0.05
    assert check(table(value, wi=wi, wo=wo))["lobe_width"].numbers["fwhm_deg"] > 10


@pytest.mark.parametrize("which", ["scatter", "incidence"])
def test_a_collapse_at_grazing_is_told_by_side(which: str):
    theta = np.deg2rad([10.0, 30, 50, 65, 72, 78, 82, 85])
    theta_i, theta_o, phi = (
        a.reshape(-1) for a in np.meshgrid(theta, theta, np.deg2rad(np.arange(0.0, 360, 20)), indexing="ij")
    )  # fmt: skip
    wi, wo = vector_from_spherical(theta_i, 0.0), vector_from_spherical(theta_o, phi)
    steep = theta_o if which == "scatter" else theta_i
    value = glossy(wi, wo) * np.where(steep > np.deg2rad(80), 0.3, 1.0)
    found = check(table(value, wi=wi, wo=wo))["grazing"]
    assert found.verdict == "notice"
    assert f"towards grazing {which}" in found.sentence
    other = {"scatter": "change_with_theta_i", "incidence": "change_with_theta_o"}[which]
    assert found.numbers[other] > 0.8
    assert check(table(glossy(wi, wo), wi=wi, wo=wo))["grazing"].verdict == "ok"


@pytest.mark.parametrize("stated", [True, False])
def test_noise_that_rises_at_grazing_is_told(stated: bool):
    theta = np.deg2rad(np.arange(2.0, 89, 3))
    theta_i, theta_o, phi = (
        a.reshape(-1) for a in np.meshgrid(
            np.deg2rad([10.0, 30, 50]), theta, np.deg2rad(np.arange(0.0, 360, 12)), indexing="ij"
        )
    )  # fmt: skip
    wi, wo = vector_from_spherical(theta_i, 0.0), vector_from_spherical(theta_o, phi)
    noise = np.where(theta_o > np.deg2rad(80), 0.25, 0.01)
    value = 0.1 * (1 + noise * np.random.default_rng(4).standard_normal(len(wi)))
    given = table(np.abs(value), wi=wi, wo=wo, sigma=0.1 * noise if stated else None)
    found = check(given)["grazing"]
    assert found.verdict == "notice"
    assert found.numbers["relative_noise_beyond_80_deg"] == pytest.approx(0.25, rel=0.25)
    assert "rises from" in found.sentence
    assert ("stated sigma" in found.sentence) is stated


@pytest.mark.long
@pytest.mark.parametrize(("strength", "verdict"), [(0.0, "ok"), (0.05, "notice"), (0.4, "warning")])
def test_a_surface_taken_for_isotropic_that_is_not(strength: float, verdict: str):
    """f_r that swings with the azimuth of the half vector, measured at four incident azimuths."""
    wi, wo = directions()
    turns = np.deg2rad([0.0, 45.0, 90.0, 200.0])
    many: list[Any] = [[], [], []]
    for turn in turns:
        c, s = np.cos(turn), np.sin(turn)
        spin = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        a, b = wi @ spin, wo @ spin
        h = a + b
        swing = 1 + strength * np.cos(2 * np.arctan2(h[:, 1], h[:, 0])) * (np.hypot(h[:, 0], h[:, 1]) > 1e-9)
        for part, more in zip(many, (a, b, glossy(wi, wo) * swing), strict=True):
            part.append(more)
    a, b, value = (np.concatenate(part) for part in many)
    found = check(table(value, wi=a, wo=b))["isotropy"]
    assert found.judged
    assert found.numbers["azimuths"] == 4
    assert found.verdict == verdict
    assert found.numbers["relative_rms"] == pytest.approx(strength, abs=0.5 * strength + 1e-6)
