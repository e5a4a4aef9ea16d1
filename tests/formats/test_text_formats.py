"""ASTM and ALTA text: frames, quantities and damaged headers."""

from __future__ import annotations

import numpy as np
import pytest

from fitter import directions
from fitter.errors import TableError
from fitter.formats import load
from fitter.metadata import Channel
from tests.formats.samples import alta_binary_bytes, alta_bytes, astm_bytes


class TestAstm:
    def test_mirror_and_channels(self):
        table = load(astm_bytes())
        best = table.value[:, 0] == 2.0
        np.testing.assert_allclose(table.wo[best], directions.mirror(table.wi[best]), atol=1e-6)
        assert [c.name for c in table.channels] == ["R", "G", "B"]
        assert table.metadata.name == "Small"
        assert table.metadata.provenance["LAB_NAME"] == "A laboratory"

    def test_wavelengths_and_three_angles(self):
        head = b"MEAS_NAME BRDF\nNUM_POINTS 2\nVARS theta_i,phi_i,theta_s,465nm,525nm\n\n"
        table = load(head + b"0.5,3.141593,0.5,1,2\n0.5,0.0,0.4,1,2\n")
        assert table.channels == (Channel("465nm", 465.0), Channel("525nm", 525.0))
        np.testing.assert_allclose(table.wo[0], directions.mirror(table.wi[0]), atol=1e-6)
        flat = head + b"0.5,0,0.5,1,2\n0.5,0,0.4,1,2\n"
        with pytest.raises(TableError) as caught:
            load(flat)
        assert caught.value.parameter == "convention"
        assert load(flat, convention="forward").metadata.convention == "forward"

    @pytest.mark.parametrize(
        ("old", "new", "row"),
        [
            (b"NUM_POINTS 27", b"NUM_POINTS 28", 33),
            (b"NUM_POINTS 27", b"NUM_POINTS many", 4),
            (b"theta_s", b"sigma_s", 5),
            (b"R,G,B", b"R,G,G", 5),
            (b"MEAS_NAME BRDF", b"MEAS_NAME BTDF", 3),
            (b"0.600000,0.000000,0.200000,0.000000", b"0.600000,0.000000,20.00000,0.000000", 17),
        ],
    )
    def test_damage(self, old: bytes, new: bytes, row: int):
        assert old in astm_bytes()
        with pytest.raises(TableError) as caught:
            load(astm_bytes().replace(old, new, 1), name="bad.astm")
        assert caught.value.row == row

    def test_cut_in_the_last_row_names_it(self):
        with pytest.raises(TableError) as caught:
            load(astm_bytes()[:-14])
        assert (caught.value.code, caught.value.row) == ("table-row-width", 33)

    def test_degrees_are_noticed(self):
        with pytest.raises(TableError) as caught:
            load(astm_bytes().replace(b"1.000000,0.000000", b"57.29578,0.000000"))
        assert caught.value.cause == "the angles are in degrees"


class TestAlta:
    def test_retro_side(self):
        table = load(alta_bytes())
        best = table.value[:, 0] == 5.0
        np.testing.assert_allclose(table.wo[best], table.wi[best], atol=1e-12)

    def test_cosine_factor(self):
        plain = load(alta_bytes())
        weighted = load(alta_bytes().replace(b"INV_STERADIAN", b"INV_STERADIAN_COSINE_FACTOR"))
        np.testing.assert_allclose(weighted.value[:, 0] * weighted.wo[:, 2], plain.value[:, 0])
        stored = load(alta_bytes().replace(b"INV_STERADIAN", b"INV_STERADIAN_COSINE_FACTOR"), quantity="brdf")
        np.testing.assert_array_equal(stored.value, plain.value)
        assert any("read as brdf" in note for note in stored.metadata.notes)

    def test_a_file_that_cannot_say(self):
        for data in (
            alta_bytes().replace(b"#PARAM_OUT INV_STERADIAN\n", b""),
            alta_bytes().replace(b"INV_STERADIAN", b"RGB_COLOR"),
        ):
            with pytest.raises(TableError) as caught:
                load(data)
            assert caught.value.parameter == "quantity"
            load(data, quantity="brdf")

    def test_other_parametrisations(self):
        wi, wo = directions.vector_from_spherical(0.3, 0.0), directions.vector_from_spherical(0.7, 2.0)
        h, _, d, p = directions.half_difference_from_vectors(wi, wo)
        cases = {
            "ISOTROPIC_TL_TV_DPHI": [0.3, 0.7, 2.0],
            "ISOTROPIC_TV_TL_DPHI": [0.7, 0.3, 2.0],
            "CARTESIAN": [*wo, *wi],
            "RUSIN_TH_TD_PD": [h, d, p],
        }
        for name, row in cases.items():
            head = f"#DIM {len(row)} 1\n#PARAM_IN {name}\n#PARAM_OUT INV_STERADIAN\n"
            table = load((head + " ".join(repr(float(x)) for x in [*row, 4.0])).encode())
            # Isotropic: only the angles between the directions and the normal are stated.
            assert table.wi[0, 2] == pytest.approx(wi[2], abs=1e-12)
            assert table.wo[0, 2] == pytest.approx(wo[2], abs=1e-12)
            assert table.wi[0] @ table.wo[0] == pytest.approx(wi @ wo, abs=1e-12)

    @pytest.mark.parametrize("kind", [1, 2])
    def test_confidence_intervals_are_skipped_and_said(self, kind: int):
        plain = load(alta_bytes())
        lines = alta_bytes().replace(b"#VS 0", f"#VS {kind}".encode()).decode().splitlines()
        more = "".join(f" {0.1 * k}" for k in range(kind))
        table = load("".join(f"{line}{'' if line[0] == '#' else more}\n" for line in lines).encode())
        np.testing.assert_array_equal(table.value, plain.value)
        assert table.sigma is None
        assert any("confidence intervals" in note for note in table.metadata.notes)

    def test_intervals_of_every_output(self):
        head = "#DIM 3 3\n#PARAM_IN ISOTROPIC_TL_TV_DPHI\n#PARAM_OUT INV_STERADIAN\n#VS {}\n"
        for said, more in (("2", "0 9"), ("2", "0 9 0 9 0 9"), ("1 1 1", "7 8 9"), ("2 0 1", "0 9 5")):
            table = load((head.format(said) + f"0.3 0.7 2.0 1 2 3 {more}\n").encode())
            assert table.value.tolist() == [[1, 2, 3]]

    @pytest.mark.parametrize("endian", ["little", "big"])
    @pytest.mark.parametrize("kind", [0, 1, 2])
    def test_binary(self, endian: str, kind: int):
        plain, table = load(alta_bytes()), load(alta_binary_bytes(endian, kind))
        np.testing.assert_array_equal(table.value, plain.value)
        np.testing.assert_array_equal(table.wo, plain.wo)
        assert any("confidence" in note for note in table.metadata.notes) == (kind > 0)
        assert not any("line end" in note for note in table.metadata.notes)

    @pytest.mark.parametrize(
        ("old", "new"),
        [
            (b"COUNT 27", b"COUNT 26"), (b"COUNT 27", b"COUNT 28"), (b"COUNT 27", b"COUNT -1"),
            (b"COUNT 27", b"COUNT 99999999999999999999"), (b"COUNT 27", b""), (b"VERSION 0", b"VERSION 1"),
            (b"ieee754-double", b"ieee754-single"), (b"little", b"middle"), (b"#VS 0", b"#VS 1"),
            (b"BEGIN_STREAM", b"STREAM"), (b"#FORMAT binary", b"#FORMAT text"), (b"#END_STREAM", b""),
        ],
    )  # fmt: skip
    def test_binary_damage(self, old: bytes, new: bytes):
        assert old in alta_binary_bytes()
        with pytest.raises(TableError) as caught:
            load(alta_binary_bytes().replace(old, new, 1), name="bad.alta")
        assert caught.value.file == "bad.alta"
        assert caught.value.remedy

    @pytest.mark.parametrize(
        ("old", "new", "row"),
        [
            (b"#DIM 3 1", b"#DIM 4 1", 2),
            (b"#DIM 3 1", b"#DIM three", 2),
            (b"#VS 0", b"#VS 3", 3),
            (b"#VS 0", b"#VS 0 0", 3),
            (b"#VS 0", b"#VS 2", 6),
            (b"ISOTROPIC_TL_TV_PROJ_DPHI", b"SCHLICK_VK", 4),
            (b"#VS 0", b"#FORMAT binary", 3),
            (b"0.25  0.25", b"0.25  x", 6),
            (b"0.25  0.25", b"0.25  25", 6),
        ],
    )
    def test_damage(self, old: bytes, new: bytes, row: int):
        with pytest.raises(TableError) as caught:
            load(alta_bytes().replace(old, new, 1))
        assert caught.value.row == row
