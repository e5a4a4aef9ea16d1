"""Each planted fault is found, a clean table has none, and every finding is a number and a sentence."""

from __future__ import annotations

import time

import numpy as np
import pytest

import fitter
from fitter.directions import mirror, vector_from_spherical
from fitter.grid import Grid
from fitter.metadata import Metadata
from fitter.quality import Check, check
from fitter.table import Table
from tests.quality.tables import directions, glossy, table, with_metadata
from tests.sampling.tables import anisotropic, ggx, merl, spherical

NAMES = [
    "repeatability", "smoothness", "negatives", "fill_values", "domain", "blind_spots", "holes", "grazing",
    "reflectance", "reciprocity", "quantity", "isotropy", "convention", "lobe_width",
]  # fmt: skip


@pytest.fixture(scope="module")
def clean() -> Check:
    return check(table())


def test_a_clean_table_has_no_warning(clean: Check) -> None:
    assert clean.verdict == "ok", [f.sentence for f in clean.findings if f.verdict != "ok"]
    assert [finding.name for finding in clean.findings] == NAMES
    judged = {finding.name for finding in clean.findings if finding.judged}
    assert {"reciprocity", "quantity", "reflectance", "convention", "holes", "grazing"} <= judged
    assert clean["reciprocity"].numbers["relative_rms"] < 1e-9


def test_reflectance_is_the_integral() -> None:
    """Of a Lambertian surface rho, whatever was left out lies between the bounds."""
    wi, _ = directions()
    found = check(table(np.full(len(wi), 0.8 / np.pi)))["reflectance"]
    for row in found.numbers["incidences"]:
        assert row["lower"]["value"] == pytest.approx(0.8 * row["coverage"], rel=1e-12)
        assert row["upper"]["value"] == pytest.approx(0.8, rel=1e-9)
        # The disk out to 85 degrees, but for the chords of the outermost ring.
        assert np.sin(np.deg2rad(85)) ** 2 * 0.99 < row["coverage"] < np.sin(np.deg2rad(85)) ** 2


@pytest.mark.long
@pytest.mark.parametrize("system", ["half_difference", "spherical_isotropic"])
def test_reflectance_of_a_grid(system: str) -> None:
    """Against the sampler's own estimate, for a lobe much narrower than a regular raster would see."""
    given = merl(0.1, 0.0) if system == "half_difference" else spherical(0.2)
    found = check(given)["reflectance"].numbers["incidences"]
    row = next(row for row in found if row["theta_i_deg"] == pytest.approx(30))
    wi = vector_from_spherical(np.deg2rad(30.0), 0.0)
    draws = fitter.TableSampler(given).sample(wi, 200_000, seed=1)
    mean = draws.weight.mean(axis=0)
    for (name, lower), estimate in zip(row["lower"].items(), mean, strict=True):
        assert lower - 0.01 <= estimate <= row["upper"][name] + 0.01


def test_energy_gained_is_found() -> None:
    wi, _ = directions()
    found = check(table(1.1 / np.pi + 0 * wi[:, 0]))["reflectance"]
    assert found.verdict == "warning"
    assert found.numbers["largest_lower"] > 1.05
    # Within twice the scale uncertainty it is not the surface's fault.
    stated = with_metadata(table(np.full(len(wi), 1.02 / np.pi)), scale_uncertainty=0.02)
    assert check(stated)["reflectance"].verdict == "notice"


def test_a_broken_reciprocity_is_found() -> None:
    wi, wo = directions()
    found = check(table(glossy(wi, wo) * (1 + 0.4 * wi[:, 2])))
    assert found["reciprocity"].verdict == "warning"
    assert found["reciprocity"].numbers["relative_rms_beyond_noise"] > 0.05
    assert found["quantity"].verdict == "ok"


@pytest.mark.parametrize("declared", ["brdf", "ccbrdf"])
def test_a_wrong_cosine_is_found(declared: str) -> None:
    """Reciprocity tells f_r from f_r cos(theta_o): what physics leaves is which of them the file held."""
    wi, wo = directions()
    up = wo[:, 2] > 0.05
    wi, wo = wi[up], wo[up]
    read = glossy(wi, wo) * (wo[:, 2] if declared == "brdf" else 1 / wo[:, 2])
    found = check(table(read, wi=wi, wo=wo, metadata=Metadata(quantity=declared)))["quantity"]
    assert found.verdict == "warning"
    assert found.numbers["suggested"] == {"brdf": "ccbrdf", "ccbrdf": "brdf"}[declared]


def test_noise_is_not_taken_for_a_broken_reciprocity() -> None:
    wi, wo = directions()
    rng = np.random.default_rng(3)
    value = glossy(wi, wo)
    noisy = value * (1 + 0.1 * rng.standard_normal(len(wi)))
    assert check(table(noisy))["reciprocity"].verdict == "ok"
    assert check(table(noisy, sigma=0.1 * value))["reciprocity"].verdict == "ok"


def test_duplicates_give_back_their_sigma() -> None:
    wi, wo = directions()
    rng = np.random.default_rng(5)
    again = rng.choice(len(wi), 400, replace=False)
    index = np.concatenate([np.arange(len(wi)), again, again])
    value = glossy(wi, wo)[index] * (1 + 0.03 * rng.standard_normal(len(index)))
    given = table(value, wi=wi[index], wo=wo[index], sigma=0.03 * value)
    found = check(given)["repeatability"]
    assert found.numbers["groups"] == 400
    assert found.numbers["degrees_of_freedom"] == 800
    assert abs(found.numbers["relative_sd"] - 0.03) < 3 * found.numbers["relative_sd_uncertainty"]
    assert found.numbers["scatter_over_sigma"] == pytest.approx(1, abs=0.1)
    assert found.verdict == "ok"
    optimistic = table(value, wi=wi[index], wo=wo[index], sigma=0.003 * value)
    assert check(optimistic)["repeatability"].verdict == "notice"


@pytest.mark.parametrize("kind", ["scattered", "grid"])
def test_smoothness_bounds_the_noise(kind: str) -> None:
    rng = np.random.default_rng(6)
    if kind == "scattered":
        wi, wo = directions()
        given = table(glossy(wi, wo) * (1 + 0.05 * rng.standard_normal(len(wi))))
    else:
        smooth = merl(0.5)
        noisy = smooth.value * (1 + 0.05 * rng.standard_normal(smooth.value.shape))
        given = Table(value=noisy, grid=smooth.grid)
    found = check(given)["smoothness"]
    assert 0.045 < found.numbers["relative_sd_at_most"] < 0.075


def test_negatives_are_found_though_the_table_masks_them() -> None:
    wi, wo = directions()
    rng = np.random.default_rng(7)
    value = 0.001 * rng.standard_normal(len(wi)) + np.where(wo[:, 2] < 0.5, 0.001, 0.2)
    found = check(table(value))["negatives"]
    assert found.numbers["samples"] == int((value < 0).sum())
    assert found.numbers["median_depth_over_noise"] < 3
    shifted = glossy(wi, wo, 0.0) - 0.01
    found = check(table(shifted))["negatives"]
    assert found.verdict == "warning"
    assert found.numbers["deepest_per_sr"] == pytest.approx(-shifted.min())


def test_a_wrong_convention_is_found() -> None:
    wi, wo = directions()
    turned = table(glossy(wi, mirror(wo)), metadata=Metadata(convention="phi_specular_180"))
    found = check(turned)["convention"]
    assert found.verdict == "warning"
    assert found.numbers["suggested"] == "phi_specular_0"


def test_a_retro_reflector_is_no_error() -> None:
    wi, wo = directions()
    found = check(table(0.05 + np.maximum((wi * wo).sum(axis=1), 0) ** 80 * wi[:, 2]))["convention"]
    assert found.verdict == "notice"
    assert found.numbers["suggested"] is None


def test_angles_from_the_specular_direction_are_found() -> None:
    """Scatter about the mirror direction, its polar angle read as if it counted from the normal."""
    _, wo = directions()
    found = check(table(0.05 + wo[:, 2] ** 100))["convention"]
    assert found.verdict == "warning"
    assert "specular direction" in found.numbers["suggested"]


@pytest.mark.parametrize(("level", "kind"), [(0.0, "zero"), (0.12, "floor")])
def test_a_constant_floor_is_found(level: float, kind: str) -> None:
    wi, wo = directions()
    value = glossy(wi, wo)
    value[value < 0.12] = level
    found = check(table(value))["fill_values"]
    assert found.verdict == "warning"
    assert found.numbers["repeated"][0]["kind"] == kind
    assert found.numbers["repeated"][0]["count"] == int((value == level).sum())


def test_a_floor_under_a_cosine_is_found() -> None:
    """The file held f_r cos(theta_o) with a floor: f_r itself is nowhere constant."""
    wi, wo = directions()
    held = np.maximum(glossy(wi, wo) * wo[:, 2], 0.03)
    given = table(held / wo[:, 2], wi=wi, wo=wo, metadata=Metadata(quantity="ccbrdf"))
    row = check(given)["fill_values"].numbers["repeated"][0]
    assert row["value"] == pytest.approx(0.03)
    assert row["count"] == int((held == 0.03).sum())


def test_rounded_values_are_no_floor() -> None:
    wi, wo = directions()
    assert not check(table(np.round(glossy(wi, wo), 3)))["fill_values"].numbers["repeated"]


def test_saturation_is_found() -> None:
    wi, wo = directions()
    found = check(table(np.minimum(glossy(wi, wo), 0.2)))["fill_values"]
    assert found.numbers["repeated"][0]["kind"] == "ceiling"


def test_a_hole_is_found() -> None:
    wi, wo = directions()
    centre = vector_from_spherical(np.deg2rad(50.0), np.deg2rad(90.0))
    other = centre * np.array([1.0, -1.0, 1.0])
    there = np.maximum(wo @ centre, wo @ other) > np.cos(np.deg2rad(22.0))
    found = check(table(glossy(wi, wo)[~there], wi=wi[~there], wo=wo[~there]))["holes"]
    assert found.verdict == "notice"
    largest = found.numbers["largest"]
    place = vector_from_spherical(np.deg2rad(largest["theta_o_deg"]), np.deg2rad(largest["dphi_deg"]))
    assert max(place @ centre, place @ other) > np.cos(np.deg2rad(5.0))
    assert 18 < largest["radius_deg"] < 27


def test_a_hole_in_a_grid_is_found() -> None:
    given = spherical(0.3)
    wo = given.wo
    centre = vector_from_spherical(np.deg2rad(50.0), np.deg2rad(90.0))
    masked = Table(value=given.value, grid=given.grid, mask=wo @ centre < np.cos(np.deg2rad(20.0)))
    found = check(masked)["holes"]
    assert found.verdict == "notice"
    assert 17 < found.numbers["largest"]["radius_deg"] < 26


def test_the_light_in_the_way_is_found() -> None:
    wi, wo = directions()
    seen = (wi * wo).sum(axis=1) < np.cos(np.deg2rad(4.0))
    found = check(table(glossy(wi, wo)[seen], wi=wi[seen], wo=wo[seen]))["blind_spots"]
    assert found.verdict == "notice"
    assert found.numbers["blind_to_retro"] > 0
    assert found.numbers["blind_to_mirror"] == 0


def test_the_plane_of_incidence_only() -> None:
    wi, wo = directions()
    plane = (np.abs(wo[:, 1]) < 1e-9) & (wo[:, 0] <= 1e-9)
    found = check(table(glossy(wi, wo)[plane], wi=wi[plane], wo=wo[plane]))
    assert found["domain"].numbers["in_plane"] is True
    assert "specular side" in found["domain"].sentence
    assert not found["reflectance"].judged
    assert not found["holes"].judged


def test_a_collapse_at_grazing_is_found() -> None:
    wi, wo = directions()
    value = np.where(wo[:, 2] < np.cos(np.deg2rad(79.0)), 0.01, 1.0) * glossy(wi, wo)
    found = check(table(value))["grazing"]
    assert found.verdict == "warning"
    assert found.numbers["change_with_theta_o"] < 0.05


@pytest.mark.parametrize(("aperture", "verdict"), [(0.5, "ok"), (4.0, "notice"), (8.0, "warning")])
def test_lobe_width_against_the_aperture(aperture: float, verdict: str) -> None:
    theta = np.deg2rad(np.arange(-80.0, 80.5, 0.5))
    wi = np.repeat(vector_from_spherical(np.deg2rad([20.0, 40.0]), np.pi), len(theta), axis=0)
    wo = np.tile(vector_from_spherical(theta, 0.0), (2, 1))
    off = np.rad2deg(np.arccos(np.clip((mirror(wi) * wo).sum(axis=1), -1, 1)))
    value = 0.01 + np.exp(-4 * np.log(2) * (off / 10.0) ** 2)
    given = table(value, wi=wi, wo=wo, metadata=Metadata(aperture=float(np.deg2rad(aperture))))
    found = check(given)["lobe_width"]
    assert found.numbers["fwhm_deg"] == pytest.approx(10.1, abs=0.3)
    assert found.verdict == verdict


def test_anisotropy_is_told_from_isotropy() -> None:
    given = anisotropic()
    assert "it is anisotropic" in check(given)["isotropy"].sentence
    scattered = table(given.value[given.mask], wi=given.wi[given.mask], wo=given.wo[given.mask])
    assert check(scattered)["isotropy"].verdict == "warning"
    wi, wo = given.wi[given.mask], given.wo[given.mask]
    same = Table(wi=wi, wo=wo, value=ggx(wi, wo, 0.4) + 0.1, symmetry="anisotropic")
    found = check(same)["isotropy"]
    assert found.numbers["relative_rms"] < 1e-6
    assert "isotropic" in found.sentence


def test_a_merl_sized_table_takes_seconds() -> None:
    given = merl(0.1, shape=(90, 90, 180))
    given = Table(value=np.repeat(given.value, 3, axis=1), grid=given.grid)
    start = time.process_time()
    found = check(given, seed=4)
    # On an idle core 1.5 s; of processor time, for machines that do other things beside.
    assert time.process_time() - start < 20
    assert found.looked_at == 200_000
    assert found.samples == int(given.mask.sum())
    assert found.seed == 4
    assert found.to_dict() == check(given, seed=4).to_dict()


def test_a_grid_reciprocity_is_judged() -> None:
    theta = np.deg2rad(np.arange(0.0, 81.0, 10.0))
    axes = {"theta_i": theta, "theta_o": theta, "dphi": np.deg2rad(np.arange(0.0, 181.0, 15.0))}
    grid = Grid("spherical_isotropic", axes)
    wi, wo = grid.directions()
    good = Table(value=glossy(wi, wo), grid=grid)
    bad = Table(value=glossy(wi, wo) * (1 + wi[:, 2]), grid=grid)
    assert check(good)["reciprocity"].numbers["relative_rms"] < 1e-9
    assert check(bad)["reciprocity"].verdict == "warning"
    assert not check(merl(0.3))["reciprocity"].judged


def test_what_is_not_above_the_horizon_is_counted() -> None:
    wi, wo = directions()
    sunk = np.concatenate([wo, vector_from_spherical(np.full(7, 1.7), 0.0)])
    above = np.concatenate([wi, wi[:7]])
    value = np.concatenate([glossy(wi, wo), np.zeros(7)])
    found = check(table(value, wi=above, wo=sunk))["fill_values"]
    assert found.numbers["below_the_horizon"] == 7
    assert found.numbers["zeros"] == 0
    assert "7 samples" in found.sentence


def test_a_sample_that_is_its_own_partner_tests_no_reciprocity() -> None:
    wi, wo = directions()
    equal = np.abs(wi[:, 2] - wo[:, 2]) < 1e-9
    found = check(table((glossy(wi, wo) * (1 + wi[:, 2]))[equal], wi=wi[equal], wo=wo[equal]))
    assert not found["reciprocity"].judged
    assert not found["quantity"].judged
