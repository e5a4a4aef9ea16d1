"""The measured tables: what is known of them is found, and what they can't show is not claimed."""

from __future__ import annotations

from pathlib import Path

import pytest

from fitter.formats import load, load_all
from fitter.quality import check

pytestmark = pytest.mark.measured


def test_reciprocity_tells_which_quantity_a_tape_holds(shared: Path) -> None:
    """The tapes' headers disagree about the cosine; reciprocal pairs do not: both hold f_r cos(theta_o)."""
    yellow = check(load(shared / "measured/retro/retro-3M-jaune.dat"))
    assert yellow["quantity"].numbers["declared"] == "ccbrdf"
    assert yellow["quantity"].numbers["suggested"] is None
    assert yellow["reciprocity"].verdict == "ok"
    path = shared / "measured/retro/retro-gray-tape.dat"
    as_brdf = check(load(path, quantity="brdf"))
    assert as_brdf["quantity"].numbers["suggested"] == "ccbrdf"
    assert as_brdf["reciprocity"].numbers["relative_rms"] > 0.4
    corrected = check(load(path, quantity="ccbrdf"))
    assert corrected["quantity"].verdict == "ok"
    assert corrected["reciprocity"].numbers["relative_rms"] < 0.1
    assert corrected["convention"].verdict == "notice"
    assert "retro-reflector" in corrected["convention"].sentence


def test_ptfe_is_what_a_diffuser_should_be(shared: Path) -> None:
    declared = {
        "lambda": "wavelength_um", "thetai": "theta_i_deg", "phi": "phi_i_deg", "thetar": "theta_o_deg",
        "phir": "phi_o_deg", "f_r11": "brdf",
    }  # fmt: skip
    table = load(shared / "measured/nist_ptfe/PTFE.data.csv", columns=declared, item="633nm")
    found = check(table)
    assert found["reciprocity"].numbers["relative_rms"] < 0.01
    near_normal = found["reflectance"].numbers["incidences"][0]
    # Sintered PTFE reflects about 0.99 of the light at 633 nm.
    assert near_normal["lower"]["633nm"] < 0.99 < near_normal["upper"]["633nm"] + 0.02
    assert found["smoothness"].numbers["relative_sd_at_most"] < 0.02


def test_garnet_red(shared: Path) -> None:
    found = check(load(shared / "measured/cornell/garnet_red_RGB.astm"))
    assert found["negatives"].numbers["samples"] == 153
    assert found["convention"].verdict == "ok"
    assert "direction towards the light" in found["blind_spots"].sentence


@pytest.mark.parametrize("name", ["aluminium_anodised", "aluminium_sandblasted", "stainless_steel"])
def test_infrared_metals_are_reciprocal_only_with_a_cosine(shared: Path, name: str) -> None:
    table = load(shared / "measured/mwir" / f"{name}.csv", convention="forward")
    found = check(table)
    assert found["domain"].numbers["in_plane"]
    assert not found["reflectance"].judged
    numbers = found["quantity"].numbers
    assert numbers["suggested"] == "ccbrdf"
    assert numbers["relative_typical"]["ccbrdf"] < 0.15 < 0.8 < numbers["relative_typical"]["brdf"]


@pytest.mark.parametrize("name", ["AnoBlackEC1onAlum", "AnoBlackNiTEonSteel"])
def test_black_coatings_reflect_alike_in_both_formats(shared: Path, name: str) -> None:
    rows = [
        check(load(shared / "measured/ua_loft" / f"{name}.{suffix}"))["reflectance"].numbers["incidences"]
        for suffix in ("bsdf", "txt")
    ]
    for one, other in zip(*rows, strict=True):
        assert one["theta_i_deg"] == pytest.approx(other["theta_i_deg"], abs=0.1)
        assert one["lower"]["value"] == pytest.approx(other["lower"]["value"], rel=0.15)


def test_every_material_of_curet(shared: Path) -> None:
    """3 decimals, 205 geometries: nothing is claimed of energy, reciprocity or isotropy."""
    for table in load_all(shared / "measured/curet"):
        found = check(table)
        assert not any(found[name].judged for name in ("reflectance", "reciprocity", "isotropy", "holes"))
        assert found["convention"].verdict != "warning", table.metadata.name
