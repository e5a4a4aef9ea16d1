"""Zemax, FRED and the coordinates about the specular ray they need."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from fitter import directions
from fitter.errors import TableError
from fitter.formats import describe, load, specular
from fitter.table import Table
from tests.formats.samples import fred_bytes, zemax_bytes

angle = st.floats(0.01, 1.5)


class TestSpecularCoordinates:
    @given(theta=angle, phi=st.floats(-3, 3), radial=st.floats(0.01, 3.1), azimuth=st.floats(-3.1, 3.1))
    def test_there_and_back(self, theta: float, phi: float, radial: float, azimuth: float):
        wo = specular.outgoing(theta, phi, radial, azimuth)
        mirror = directions.mirror(directions.vector_from_spherical(theta, phi))
        assert wo @ mirror == pytest.approx(np.cos(radial), abs=1e-12)
        again = specular.coordinates(theta, phi, wo)
        np.testing.assert_allclose(again, (radial, azimuth), atol=1e-9)

    def test_azimuth_zero_leads_to_the_normal(self):
        for phi in (0.0, 1.0):
            np.testing.assert_allclose(specular.outgoing(0.5, phi, 0.5, 0.0), [0, 0, 1], atol=1e-15)
            lower = specular.outgoing(0.5, phi, 0.3, np.pi)
            np.testing.assert_allclose(lower, directions.vector_from_spherical(0.8, phi + np.pi), atol=1e-15)

    def test_azimuth_is_counter_clockwise_from_outside(self):
        pole, zero, quarter = (
            specular.outgoing(0.5, 0.0, *a) for a in ((0, 0), (1e-6, 0), (1e-6, np.pi / 2))
        )
        assert np.cross(zero - pole, quarter - pole) @ pole > 0


class TestZemax:
    def test_directions_values_and_fill(self):
        table = load(zemax_bytes())
        theta_o = np.rad2deg(np.arccos(table.wo[:, 2]))
        np.testing.assert_allclose(theta_o[[0, 1, 2, 7, 8]], [20, 0, 20, 40, 60], atol=1e-5)
        # The way over the normal leads to the side of the light, the other away from it.
        assert (table.wo[[2, 8], 0] * [1, -1] > 0).all()
        assert table.channels[0].wavelength_nm == 633
        assert table.symmetry == "isotropic"
        assert table.metadata.masked == {"fill value": 1, "below the horizon": 1, "repeated geometry": 4}
        assert not table.mask[[16, 17]].any()
        assert table.metadata.provenance["TIS"] == {"Monochrome": [0.1, 0.2]}

    def test_a_zero_inside_a_line_is_a_measurement(self):
        table = load(zemax_bytes().replace(b"1.0\t0.4\t0.1", b"1.0\t0.0\t0.1"))
        assert table.mask[4]

    def test_tristimulus_and_rotations(self):
        text = zemax_bytes().decode().replace("SampleRotation\t1\n0", "SampleRotation\t2\n0\t30")
        head, _, block = text.partition("Monochrome\nDataBegin\n")
        block = block.removesuffix("DataEnd\n")
        head = head.replace("SpectralContent\tMonochrome", "SpectralContent\tXYZ")
        head = head.replace("PlaneSymmetrical", "ASymmetrical4D")
        text = head + "".join(f"Tristimulus{c}\nDataBegin\n{block * 2}DataEnd\n" for c in "XYZ")
        table = load(text.encode())
        assert [c.name for c in table.channels] == ["X", "Y", "Z"]
        assert (len(table), table.symmetry) == (36, "anisotropic")
        turned = directions.spherical_from_vector(table.wi[18:])[1]
        np.testing.assert_allclose(turned, np.deg2rad(-30))
        np.testing.assert_allclose((table.wi * table.wo).sum(1)[:18], (table.wi * table.wo).sum(1)[18:])

    @pytest.mark.parametrize(
        ("old", "new", "row", "code"),
        [
            (b"BRDF", b"BTDF", 5, "table-transmission"),
            (b"ScatterRadial\t3", b"ScatterRadial\t4", 15, "table-not-a-number"),
            (b"ScatterRadial\t3", b"ScatterRadial\tx", 12, "table-header"),
            (b"PlaneSymmetrical", b"Round", 3, "table-header"),
            (b"20\t60", b"60\t20", 9, "table-angle-range"),
            (b"0\t90\t180", b"0\t1.5708\t3.14159", 11, "table-angle-unit"),
            (b"1.0\t0.4\t0.1", b"1.0\tx\t0.1", 19, "table-not-a-number"),
            (b"1.0\t0.4\t0.1\n", b"1.0\t0.4\n", 21, "table-not-a-number"),
            (b"TIS\t0.2", b"TOS\t0.2", 21, "table-header"),
            (b"DataEnd\n", b"", 24, "table-truncated"),
            (b"Source\tMeasured", b"Origin\tMeasured", 2, "table-header"),
            (b"ScatterAzimuth\t3", b"ScatterAzimuth\t999999999999999999999", 12, "table-not-a-number"),
        ],
    )
    def test_damage(self, old: bytes, new: bytes, row: int, code: str):
        assert old in zemax_bytes()
        with pytest.raises(TableError) as caught:
            load(zemax_bytes().replace(old, new, 1), name="bad.bsdf")
        assert (caught.value.code, caught.value.row, caught.value.file) == (code, row, "bad.bsdf")
        assert caught.value.remedy


class TestFred:
    def test_specular_side(self):
        table = load(fred_bytes())
        best = table.value[:, 0] == 3.0
        np.testing.assert_allclose(table.wo[best], directions.mirror(table.wi[best]), atol=1e-12)
        assert table.metadata.convention == "phi_specular_0"
        back = load(fred_bytes(), convention="phi_specular_180")
        np.testing.assert_allclose(back.wo[best], back.wi[best], atol=1e-12)

    def test_radians_scale_and_transmission(self):
        text = "type bsdf_data\nformat angles=rad bsdf=value scale=2\n0.5 0\n0.5 0 1\n2.5 0 7\n"
        table = load(text.encode())
        assert table.value[:, 0].tolist() == [2, 14]
        assert table.mask.tolist() == [True, False]
        assert any("transmission" in note for note in table.metadata.notes)

    @pytest.mark.parametrize(
        ("old", "new", "row"),
        [
            (b"bsdf=value", b"bsdf=log", 2),
            (b"angles=deg", b"angles=grad", 2),
            (b"scale=1", b"scale=one", 2),
            (b"10\t0\n", b"", 3),
            (b"10\t0\n", b"200\t0\n", 3),
            (b"10\t90\t", b"10\t90\t1\t", 5),
            (b"10\t90\t", b"x\t90\t", 5),
        ],
    )
    def test_damage(self, old: bytes, new: bytes, row: int):
        assert old in fred_bytes()
        with pytest.raises(TableError) as caught:
            load(fred_bytes().replace(old, new, 1))
        assert caught.value.row == row


@pytest.mark.measured
@pytest.mark.parametrize("name", ["AnoBlackEC1onAlum", "AnoBlackNiTEonSteel"])
def test_one_measurement_in_both_forms(shared: Path, name: str):
    """Zemax and FRED files of one measurement agree; the Zemax one was interpolated by its maker."""
    folder = shared / "measured/ua_loft"
    zemax, fred = load(folder / f"{name}.bsdf"), load(folder / f"{name}.txt")
    assert (zemax.metadata.source_format, fred.metadata.source_format) == ("zemax", "fred")
    assert zemax.channels[0].wavelength_nm == 650
    assert zemax.domain.theta_i == pytest.approx(fred.domain.theta_i)
    assert np.rad2deg(zemax.domain.theta_o[1]) == pytest.approx(80, abs=0.1)
    specular_at = [at_specular(table) for table in (zemax, fred)]
    np.testing.assert_allclose(specular_at[0][:2], specular_at[1][:2], rtol=6e-3)
    # Both forms were interpolated by their maker from one raster, each about its own pole: a measured
    # direction of both is the specular ray at 10 and 30 deg, and there they agree to Zemax's four digits.
    for k in (0, 1) if name == "AnoBlackEC1onAlum" else (1,):
        assert specular_at[0][k] == float(f"{specular_at[1][k]:.3e}")
    # At 50 and 70 deg its maker moved the peak to the specular ray.
    np.testing.assert_allclose(specular_at[0], specular_at[1], rtol=0.15)
    theta_i, phi_i = directions.spherical_from_vector(zemax.wi)
    radial, azimuth = specular.coordinates(theta_i, phi_i, zemax.wo)
    in_plane = np.abs(np.sin(azimuth)) < 1e-6
    off = {"in plane": ratios(fred, zemax, zemax.wo, in_plane), "all": ratios(fred, zemax, zemax.wo)}
    # Its maker turned the Zemax form (not FRED's) by about 3.5 deg out of the plane: an alignment.
    aside, along = radial * np.sin(azimuth) + np.deg2rad(3.5), radial * np.cos(azimuth)
    shifted = specular.outgoing(theta_i, phi_i, np.hypot(aside, along), np.arctan2(aside, along))
    off["turned"] = ratios(fred, zemax, shifted, ~in_plane)
    off["backwards"] = ratios(fred, zemax, specular.outgoing(theta_i, phi_i, radial, azimuth + np.pi))
    median = {key: float(np.median(ratio)) for key, ratio in off.items()}
    print(name, "|log ratio|, median:", {key: round(value, 3) for key, value in median.items()})
    assert len(off["all"]) > 600
    assert median["in plane"] < 0.04
    assert median["turned"] < 0.05
    assert median["all"] < 0.12
    assert median["backwards"] > 3 * median["turned"]
    for table in (zemax, fred):
        steep = next(p for p in describe(table)["peaks"] if abs(p["theta_i_deg"] - 30) < 1)
        assert abs(steep["specular_side"]["theta_o_deg"] - 30) <= 10


def ratios(fred: Table, zemax: Table, wo: np.ndarray, where: np.ndarray | bool = True) -> np.ndarray:
    """|log| of FRED's value, bilinear at ``wo``, over Zemax's, where both are measured."""
    theta, phi = (np.round(np.rad2deg(a)) for a in directions.spherical_from_vector(fred.wo))
    theta_o, phi_o = (np.rad2deg(a) for a in directions.spherical_from_vector(wo))
    nodes = (np.arange(0.0, 81, 5), np.arange(0.0, 181, 10))
    found = []
    for cosine in np.unique(np.round(zemax.wi[:, 2], 9)):
        ours = zemax.mask & (np.abs(zemax.wi[:, 2] - cosine) < 1e-6) & (wo[:, 2] > 0) & where
        theirs = fred.mask & (np.abs(fred.wi[:, 2] - cosine) < 1e-6)
        level = np.full((17, 19), np.nan)
        # Isotropic: both sides of the plane of incidence are alike.
        level[(theta[theirs] / 5).astype(int), (np.abs(phi[theirs]) / 10).astype(int)] = np.log(
            fred.value[theirs, 0]
        )
        level[0] = np.nanmax(level[0])
        at = np.stack([theta_o[ours], np.abs(phi_o[ours])], axis=1)
        there = RegularGridInterpolator(nodes, level, bounds_error=False)(at)
        found.append(np.abs(there - np.log(zemax.value[ours, 0])))
    ratio = np.concatenate(found)
    return ratio[np.isfinite(ratio)]


def at_specular(table: Table) -> np.ndarray:
    here = table.mask & (np.abs(table.wo - directions.mirror(table.wi)) < 1e-6).all(axis=1)
    order = np.argsort(-table.wi[here, 2])
    return table.value[here, 0][order]
