"""The measured tables: what is known of them is found, and what they can't show is not claimed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fitter.formats import load, load_all
from fitter.quality import check
from tests.evidence.inputs import PTFE_COLUMNS, inputs
from tests.evidence.trial import read

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
    # Two of the pairs lie on the very edge of what counts as one: rounding decides about them.
    assert corrected["reciprocity"].numbers["relative_rms"] < 0.12
    assert corrected["reciprocity"].numbers["relative_rms_beyond_noise"] == 0.0
    assert corrected["convention"].verdict == "notice"
    assert "retro-reflector" in corrected["convention"].sentence


def test_ptfe_is_what_a_diffuser_should_be(shared: Path) -> None:
    tables = load_all(shared / "measured/nist_ptfe/PTFE.data.csv", columns=PTFE_COLUMNS)
    assert len(tables) == 4
    for table in tables:
        # Near 1/pi away from grazing; its own forward scatter lifts it by a hundredth or two.
        inner = (table.wi[:, 2] > 0.85) & (table.wo[:, 2] > 0.7)
        assert np.pi * table.value[inner].mean() == pytest.approx(1.0, abs=0.025)
        assert np.abs(np.pi * table.value[inner] - 1.0).max() < 0.1
        reciprocity = check(table)["reciprocity"]
        assert reciprocity.verdict == "ok"
        assert reciprocity.numbers["pairs"] >= 20
        # Within the noise of two samples; at 1064 nm a tenth more.
        numbers = reciprocity.numbers
        assert numbers["relative_rms"] < 1.15 * numbers["relative_rms_of_noise"]
    found = check(load(shared / "measured/nist_ptfe/PTFE.data.csv", columns=PTFE_COLUMNS, item="633nm"))
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


#: Where the in-plane peaks of each measured file belong: paint, metal, film and coating mirror the light,
#: a tape reflects back, and what is diffuse, or too rough, has no peak.
PEAKS = {
    "cornell/garnet_red_RGB.astm": "specular", "mdl/carpaint_blue.mbsdf": "specular",
    "mwir/aluminium_anodised.csv": "specular", "mwir/brass.csv": "specular",
    "mwir/lacquer_smooth.csv": "specular", "mwir/stainless_steel.csv": "specular",
    "mwir/aluminium_sandblasted.csv": None, "nist_ptfe/PTFE.data.csv": None,
    "retro/retro-3M-jaune.dat": "specular", "retro/retro-gray-tape.dat": "retro",
    "rgl/aurora_white_rgb.bsdf": "specular", "rgl/cc_ibiza_sunset_rgb.bsdf": "specular",
    "rgl/cm_military_green_rgb.bsdf": "specular", "rgl/irid_flake_paint1_rgb.bsdf": "specular",
    "rgl/vch_silk_blue_rgb.bsdf": None, "ua_loft/AnoBlackEC1onAlum.bsdf": "specular",
    "ua_loft/AnoBlackEC1onAlum.txt": "specular", "ua_loft/AnoBlackNiTEonSteel.bsdf": "specular",
    "ua_loft/AnoBlackNiTEonSteel.txt": "specular",
}  # fmt: skip


@pytest.mark.parametrize("name", PEAKS)
def test_peaks_and_energy_of_every_file(shared: Path, name: str) -> None:
    """As read, by the conventions that its format and its source state."""
    one = next(one for one in inputs() if one.name == name)
    for table in read(one, one.sources("", b"")):
        found = check(table)
        kinds = {row["peak"] for row in found["convention"].numbers["incidences"]}
        assert found["convention"].verdict != "warning"
        assert found["convention"].numbers["suggested"] is None
        if PEAKS[name] is None:
            # Silk has its specular peak at grazing incidence only, where red is not negative.
            assert kinds <= {"none", "specular"}
            assert not found["convention"].judged
        else:
            assert PEAKS[name] in kinds
            assert found["convention"].judged
            assert PEAKS[name] == "retro" or kinds <= {"none", "specular"}
        reflectance = found["reflectance"]
        if reflectance.judged:
            for row in reflectance.numbers["incidences"]:
                assert max(row["lower"].values()) < 1.05
        else:
            assert table.domain.in_plane
            assert "can't be judged" in reflectance.sentence


def test_every_measured_file_is_among_them(shared: Path) -> None:
    assert {one.name for one in inputs() if one.measured} == {*PEAKS, "curet/abrdf.dat"}
