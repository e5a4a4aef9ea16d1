"""LightTools, Integra and SSDD: frames, quantities, blocks that are skipped, damage."""

from __future__ import annotations

import json

import numpy as np
import pytest

from fitter import directions
from fitter.errors import NoTable, TableError
from fitter.formats import load, load_all
from fitter.metadata import Channel
from tests.formats.samples import integra_bytes, lighttools_bytes, ssdd_bytes


class TestLightTools:
    def test_mirror_and_skipped_blocks(self):
        table = load(lighttools_bytes())
        best = table.value[:, 0] == 4.0
        assert best.sum() == 2
        np.testing.assert_allclose(table.wo[best], directions.mirror(table.wi[best]), atol=1e-12)
        assert table.channels == (Channel("value", 550.0),)
        assert any("2 transmission blocks" in note for note in table.metadata.notes)
        assert table.symmetry == "isotropic"

    def test_sides_and_tristimulus(self):
        old = b"Side Front\nWavelength 550\nScatterType BTDF"
        new = b"Side Back\nWavelength 550\nScatterType BRDF"
        front, back = load_all(lighttools_bytes().replace(old, new))
        assert [t.metadata.provenance["item"] for t in (front, back)] == ["front", "back"]
        text = lighttools_bytes().decode().replace("Monochrome", "XYZ").partition("DataBegin\n")
        block = "AOI 20\nPOI 0\nSide Front\nScatterType BRDF\nTristimulusValue Tris{}\nTIS 0\n" + "{} " * 12
        blocks = "\n".join(block.format(c, *[k] * 12) for k, c in enumerate("XYZ", start=1))
        table = load((text[0] + text[1] + blocks + "\nDataEnd\n").encode())
        assert [c.name for c in table.channels] == ["X", "Y", "Z"]
        assert table.value[0].tolist() == [1, 2, 3]

    @pytest.mark.parametrize(
        ("old", "new", "row", "code"),
        [
            (b"BRDF", b"BTDF", None, "table-transmission"),
            (b"POI 0", b"POI 30", None, "table-anisotropic"),
            (b"AOI 40", b"AOI 20", None, "table-header"),
            (b"AOI 20", b"AOI 120", 14, "table-header"),
            (b"Side Front", b"Side Left", 11, "table-header"),
            (b"ScatterRadial 3\n20", b"ScatterRadial 2\n20", 7, "table-header"),
            (b"DataEnd\n", b"", 48, "table-truncated"),
            (b"Asymmetric", b"Round", 2, "table-header"),
        ],
    )
    def test_damage(self, old: bytes, new: bytes, row: int | None, code: str):
        data = lighttools_bytes()
        assert old in data
        everywhere = old in (b"BRDF", b"AOI 40")
        with pytest.raises(TableError) as caught:
            load(data.replace(old, new, -1 if everywhere else 1))
        assert caught.value.code == code
        assert caught.value.remedy
        if row is not None:
            assert caught.value.row == row


SDR = b"""; made up
Source Measured
TypeColorModel spectral 2
sigma 3
0 45 80
wl 450 def 0.04 0.05 0.4 enddef
wl 550 def 0.03 nan 0.5
"""


class TestIntegra:
    def test_luminance_and_intensity(self):
        table = load(integra_bytes())
        assert table.metadata.quantity == "reflectance_factor"
        np.testing.assert_allclose(table.value[0] * np.pi, [3, 6, 9])
        np.testing.assert_allclose(table.value[9] * np.pi, [1.5, 3, 4.5])  # kbdf 0.5 at 60 deg
        np.testing.assert_allclose(table.wo[[0, 9]], directions.mirror(table.wi[[0, 9]]), atol=1e-12)
        theta_o = np.rad2deg(np.arccos(table.wo[:, 2]))
        np.testing.assert_allclose(theta_o[[1, 7, 16]], [0, 40, 80], atol=1e-5)
        weighted = load(integra_bytes().replace(b"Luminance", b"Intensity"))
        np.testing.assert_allclose(
            weighted.value[table.mask] * weighted.wo[table.mask, 2:], table.value[table.mask] * np.pi
        )

    def test_spectral_without_factors_and_rotations(self):
        text = "TypeSym ASymmetrical 4D\nTypeColorModel spectral 2\nTypeData Luminance Absolute\npsi 2 0 90\n"
        text += "sigma 1 30\nsigmaT 40\nphi 1 0\ntheta 2 0 10\nwl 450 def 1 2 3 4\nwl 550 def 5 6 7 8\n"
        table = load(text.encode())
        assert table.channels == (Channel("450nm", 450.0), Channel("550nm", 550.0))
        assert table.symmetry == "anisotropic"
        np.testing.assert_allclose(table.value * np.pi, [[1, 5], [2, 6], [3, 7], [4, 8]])
        # sigmaT moves the pole of the outgoing angles.
        np.testing.assert_allclose(np.rad2deg(np.arccos(table.wo[:, 2])), [40, 30, 40, 30], atol=1e-5)
        np.testing.assert_allclose(
            table.wi[2], directions.vector_from_spherical(np.pi / 6, np.pi / 2), atol=1e-12
        )

    @pytest.mark.parametrize(
        ("old", "new", "row", "code"),
        [
            (b"Absolute", b"Relative", 11, "table-quantity"),
            (b"TypeData Luminance Absolute\n", b"", None, "table-quantity"),
            (b"phi 3\n0 90 180\ntheta 3\n0 20 40\n", b"", 9, "table-header"),
            (b"sigma 2", b"sigma 3", 8, "table-not-a-number"),
            (b"\ngre", b"\nred", 22, "table-header"),
            (b"\nblu", b"\nbw", None, "table-header"),
            (b"TypeColorModel rgb", b"TypeColorModel spectral 3", 12, "table-header"),
            (b"def", b"dfe", 15, "table-header"),
            (b"20 60", b"60 20", 7, "table-angle-range"),
        ],
    )
    def test_damage(self, old: bytes, new: bytes, row: int | None, code: str):
        assert old in integra_bytes()
        with pytest.raises(TableError) as caught:
            load(integra_bytes().replace(old, new, 1), name="a.ddr")
        assert caught.value.code == code
        if row is not None:
            assert caught.value.row == row

    def test_blocks_may_be_ended(self):
        ended = integra_bytes().replace(b"\ngre", b"\n enddef\ngre").replace(b"\nblu", b"\nenddef\nblu")
        assert load(ended + b" enddef\n").hash == load(integra_bytes()).hash

    def test_transmission_by_its_name(self):
        with pytest.raises(NoTable) as caught:
            load(integra_bytes(), name="film.DDT")
        assert caught.value.code == "table-transmission"
        assert caught.value.contents == {"holds": "transmission"}

    def test_specular_reflectance_is_told(self):
        with pytest.raises(NoTable) as caught:
            load(SDR, name="mirror.sdr")
        error = caught.value
        assert (error.code, error.column) == ("table-specular-only", "sigma")
        assert error.contents == {
            "holds": "specular reflectance", "theta_i_deg": pytest.approx([0, 45, 80]), "Source": "Measured",
            "TypeColorModel": "spectral", "comments": ["made up"],
            "channels": [
                {"name": "450nm", "wavelength_nm": 450.0, "specular_reflectance": [0.04, 0.05, 0.4]},
                {"name": "550nm", "wavelength_nm": 550.0, "specular_reflectance": [0.03, None, 0.5]},
            ],
        }  # fmt: skip
        assert json.loads(json.dumps(error.to_dict()))["contents"]["holds"] == "specular reflectance"
        with pytest.raises(NoTable, match="transmittance"):
            load(SDR, name="film.sdt")

    @pytest.mark.parametrize(
        ("old", "new", "row"),
        [(b"0.4 ", b"0.x ", 6), (b"550", b"-5", 7), (b" 0.5", b"", 7), (b"l 2", b"l 3", 7)],
    )
    def test_damaged_specular_reflectance(self, old: bytes, new: bytes, row: int):
        with pytest.raises(TableError) as caught:
            load(SDR.replace(old, new, 1), name="mirror.sdr")
        assert not isinstance(caught.value, NoTable)
        assert caught.value.row == row


class TestSsdd:
    @pytest.mark.parametrize("dtype", ["f", "d"])
    def test_binary_equals_text(self, dtype: str):
        assert load(ssdd_bytes("binary", dtype)).hash == load(ssdd_bytes()).hash

    def test_mirror_name_and_skipped_block(self):
        table = load(ssdd_bytes())
        best = table.value[:, 0] == 8.0
        assert best.sum() == 2
        np.testing.assert_allclose(table.wo[best], directions.mirror(table.wi[best]), atol=1e-12)
        assert table.metadata.name == "made up"
        assert any("specular_reflectance" in note for note in table.metadata.notes)
        assert table.grid is not None
        assert table.grid.system == "spherical_isotropic"

    def test_other_systems(self):
        head = "VERSION 0.2\nDATA_TYPE brdf\nCOLOR_MODEL spectrum\nWAVELENGTH_LIST 450 550\nPARAM_TYPE {}\n"
        head += "PARAM0_LIST 20 40\n{}PARAM2_LIST 0 30\nPARAM3_LIST 0 90\n{}DATA ascii\n"
        rows = "".join(f"{k} {2 * k}\n" for k in range(1, 9))
        half = load((head.format("half_difference_coordinate_system", "", "") + rows).encode())
        h, _, d, p = directions.half_difference_from_vectors(half.wi, half.wo)
        assert half.grid is not None
        np.testing.assert_allclose(np.rad2deg(h), np.repeat([20, 40], 4), atol=1e-9)
        assert half.value[:, 0].tolist() == [1, 5, 3, 7, 2, 6, 4, 8]
        assert half.channels == (Channel("450nm", 450.0), Channel("550nm", 550.0))
        assert d.max() > 0.5
        offset = "PARAM4_LIST 5 10\n"
        about = load((head.format("specular_coordinate_system", "", offset) + rows).encode())
        np.testing.assert_allclose(np.rad2deg(np.arccos(about.wo[:2, 2])), [25, 50], atol=1e-5)
        np.testing.assert_allclose(np.rad2deg(np.arccos(about.wi[:2, 2])), [20, 40], atol=1e-5)
        turned = "PARAM1_LIST 0 90\n"
        both = load((head.format("spherical_coordinate_system", turned, "") + rows + rows).encode())
        assert (len(both), both.symmetry) == (16, "anisotropic")
        assert p.shape == (8,)

    @pytest.mark.parametrize(
        ("old", "new", "row", "code"),
        [
            (b"DATA_TYPE brdf", b"DATA_TYPE btdf", None, "table-transmission"),
            (b"COLOR_MODEL rgb", b"COLOR_MODEL cmyk", 10, "table-header"),
            (b"spherical_c", b"polar_c", 11, "table-header"),
            (b"PARAM2_LIST 20 40 60", b"PARAM2_LIST 20 60 40", 13, "table-header"),
            (b"PARAM2_LIST 20 40 60", b"PARAM2_LIST", 13, "table-header"),
            (b"PARAM2_LIST 20 40 60", b"PARAM2_LIST 20 40", 29, "table-header"),
            (b"0.5 0.25 0.125\n", b"0.5 0.25\n", 17, "table-row-width"),
            (b"0.5 0.25 0.125\n", b"0.5 x 0.125\n", 17, "table-not-a-number"),
            (b"0.5 0.25 0.125\n", b"", 33, "table-truncated"),
            (b"DATA ascii\n0.5", b"DATA morse\n0.5", 16, "table-header"),
        ],
    )
    def test_damage(self, old: bytes, new: bytes, row: int | None, code: str):
        assert old in ssdd_bytes()
        with pytest.raises(TableError) as caught:
            load(ssdd_bytes().replace(old, new, 1))
        assert caught.value.code == code
        assert caught.value.remedy
        if row is not None:
            assert caught.value.row == row

    def test_binary_damage(self):
        whole = ssdd_bytes("binary")
        for data in (whole[:-5], whole + b"\xff\xfe\xfd"):
            with pytest.raises(TableError) as caught:
                load(data)
            assert caught.value.code == "table-truncated"
