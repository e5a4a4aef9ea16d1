"""Delimited text: declarations, units, conventions, quantities, missing cells, and writing it back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fitter import directions
from fitter.errors import TableError
from fitter.formats import load, load_all, write_delimited
from fitter.formats.merl import merl_grid
from fitter.grid import Grid
from fitter.metadata import Channel, Metadata
from fitter.table import Table


def text(*lines: str) -> bytes:
    return "\n".join(lines).encode()


def angles(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    theta, phi = directions.spherical_from_vector(w)
    return np.rad2deg(theta), np.rad2deg(phi)


HEADER = "theta_i_deg,theta_o_deg,dphi_deg,brdf"


class TestDeclaration:
    @pytest.mark.parametrize("delimiter", [",", ";", "\t", " ", ", ", "   "])
    def test_delimiters(self, delimiter: str):
        rows = [
            ["theta_i_deg", "phi_i_deg", "theta_o_deg", "phi_o_deg", "brdf_R"],
            ["30", "10", "40", "190", "0.5"],
        ]
        table = load(text(*(delimiter.join(row) for row in rows)))
        np.testing.assert_allclose(
            table.wo, [directions.vector_from_spherical(np.deg2rad(40), np.deg2rad(190))[:]]
        )
        assert table.channels == (Channel("R"),)
        assert table.value.tolist() == [[0.5]]

    @pytest.mark.parametrize(
        "name", ["theta_i_deg", "theta_i [deg]", "Theta_i (deg)", "thetai_deg", "theta_in_degrees"]
    )
    def test_spellings(self, name: str):
        assert angles(load(text(f"{name},theta_o_deg,dphi_deg,brdf [1/sr]", "30,40,180,1")).wi)[
            0
        ] == pytest.approx(30)

    def test_columns_by_name_and_position(self):
        lines = ("a,b,c,d,note", "30,40,180,0.5,fine", "30,50,180,0.4,")
        declared = {"a": "theta_i_deg", 1: "theta_o_deg", "2": "dphi_deg", "d": "ccbrdf_633nm"}
        table = load(text(*lines), columns=declared)
        assert table.metadata.quantity == "ccbrdf"
        assert table.channels == (Channel("633nm", 633.0),)
        np.testing.assert_allclose(table.value[:, 0], np.array([0.5, 0.4]) / np.cos(np.deg2rad([40, 50])))
        assert any("note" in note for note in table.metadata.notes)

    def test_no_header_row(self):
        declared = {0: "theta_i_rad", 1: "theta_o_rad", 2: "dphi_rad", 3: "brdf"}
        table = load(text("0.5 0.4 3.0 1", "0.5 0.6 3.0 2"), columns=declared)
        np.testing.assert_allclose(angles(table.wo)[0], np.rad2deg([0.4, 0.6]))

    def test_header_in_the_last_comment(self):
        table = load(text("# made by savetxt", "# theta_i_rad theta_o_rad dphi_rad brdf", "0.5 0.4 3.0 1"))
        assert len(table) == 1

    def test_vectors_and_half_difference(self):
        wi = directions.vector_from_spherical(0.4, 0.3)
        wo = directions.vector_from_spherical(0.9, 2.0)
        h = directions.half_difference_from_vectors(wi, wo)
        a = load(text("wi_x,wi_y,wi_z,wo_x,wo_y,wo_z,brdf", ",".join(map(repr, map(float, [*wi, *wo, 1.0])))))
        b = load(
            text(
                "theta_h_rad,phi_h_rad,theta_d_rad,phi_d_rad,brdf",
                ",".join(repr(float(x)) for x in [*h, 1.0]),
            )
        )
        np.testing.assert_allclose(a.wi[0], wi, atol=1e-14)
        np.testing.assert_allclose(b.wi, a.wi, atol=1e-12)
        np.testing.assert_allclose(b.wo, a.wo, atol=1e-12)

    def test_rounded_vectors_become_unit(self):
        table = load(text("wi_x,wi_y,wi_z,wo_x,wo_y,wo_z,brdf", "0,0,1,0.707,0,0.707,1"))
        assert np.linalg.norm(table.wo) == pytest.approx(1, abs=1e-12)

    def test_header_lines(self):
        table = load(text(
            "# name: paint", "# quantity: reflectance_factor", "# symmetry: anisotropic",
            "# scale_uncertainty: 0.01",
            "# aperture_deg: 0.5", "# operator: A. B.", "# note: Mind the gap.",
            "theta_i_deg,theta_o_deg,dphi_deg,value",
            "30,40,180,1",
        ))  # fmt: skip
        meta = table.metadata
        assert (meta.name, meta.quantity, meta.scale_uncertainty) == ("paint", "reflectance_factor", 0.01)
        assert meta.aperture == pytest.approx(np.deg2rad(0.5))
        assert table.symmetry == "anisotropic"
        assert meta.provenance["operator"] == "A. B."
        assert "Mind the gap." in meta.notes
        assert table.value[0, 0] == pytest.approx(1 / np.pi)

    def test_wavelength_column_gives_one_table_each(self):
        lines = ("wavelength_um,theta_i_deg,theta_o_deg,dphi_deg,brdf", "0.5,30,30,180,1", "0.6,30,30,180,2")
        tables = load_all(text(*lines))
        assert [t.channels[0] for t in tables] == [Channel("500nm", 500.0), Channel("600nm", 600.0)]
        assert load(text(*lines), item="600nm").value.tolist() == [[2.0]]
        assert load(text(*lines), item=0).value.tolist() == [[1.0]]
        with pytest.raises(TableError) as caught:
            load(text(*lines))
        assert caught.value.parameter == "item"

    def test_mueller_elements_are_reported(self):
        lines = (f"{HEADER},m12,m13,f_r44/f_r11,temperature", "30,30,180,1,0.1,0.2,0.3,20")
        notes = load(text(*lines)).metadata.notes
        assert any(note.startswith("3 Mueller elements (m12 ... f_r44/f_r11)") for note in notes)
        assert "Columns not used: temperature." in notes

    def test_columns_where_phi_is_the_zenith(self):
        """Some satellite files call the polar angle phi; their mirror direction is at phi_o = +phi_i."""
        declared = {
            "phi_i": "theta_i_deg",
            "theta_i": "phi_i_deg",
            "phi_o": "theta_o_deg",
            "theta_o": "phi_o_deg",
        }
        lines = ("phi_i theta_i phi_o theta_o brdf", "30 180 30 0 5", "30 -180 30 0 5", "30 180 -30 0 1")
        table = load(text(*lines), columns=declared, duplicates="keep")
        np.testing.assert_allclose(table.wo[:2], directions.mirror(table.wi[:2]), atol=1e-12)
        np.testing.assert_allclose(table.wo[2], table.wi[2], atol=1e-12)

    def test_item_column(self):
        lines = (f"sheet,{HEADER}", "a b,30,30,180,1", "c,30,30,180,2")
        assert [t.metadata.provenance["item"] for t in load_all(text(*lines), columns={"sheet": "item"})] == [
            "a b",
            "c",
        ]


class TestQuantity:
    def test_conversions_include_sigma(self):
        for quantity, factor in (("brdf", 1.0), ("ccbrdf", 2.0), ("reflectance_factor", 1 / np.pi)):
            lines = (f"theta_i_deg,theta_o_deg,dphi_deg,{quantity}_R,sigma_R", "30,60,180,0.5,0.1")
            table = load(text(*lines))
            assert table.value[0, 0] == pytest.approx(0.5 * factor)
            assert table.sigma is not None
            assert table.sigma[0, 0] == pytest.approx(0.1 * factor)

    def test_option_overrides_with_a_note(self):
        table = load(text(HEADER, "30,60,180,0.5"), quantity="ccbrdf")
        assert table.value[0, 0] == pytest.approx(1.0)
        assert any("read as ccbrdf" in note for note in table.metadata.notes)

    def test_none_is_an_error(self):
        with pytest.raises(TableError) as caught:
            load(text("theta_i_deg,theta_o_deg,dphi_deg,value", "30,60,180,0.5"))
        assert caught.value.parameter == "quantity"
        assert caught.value.remedy is not None
        assert "ccbrdf" in caught.value.remedy


class TestConvention:
    def test_specular_side(self):
        for convention, phi in (("phi_specular_180", 180), ("phi_specular_0", 0)):
            table = load(text(HEADER, f"30,30,{phi},1"), convention=convention)
            np.testing.assert_allclose(table.wo, directions.mirror(table.wi), atol=1e-12)

    def test_in_plane(self):
        lines = ("theta_i_deg,theta_o_deg,brdf_per_sr", "30,30,1", "-30,-30,1", "30,-30,2")
        forward, back = load(text(*lines), convention="forward"), load(text(*lines), convention="back")
        np.testing.assert_allclose(forward.wo[:2], directions.mirror(forward.wi[:2]), atol=1e-12)
        np.testing.assert_allclose(forward.wo[2], forward.wi[2], atol=1e-12)
        np.testing.assert_allclose(back.wo[:2], back.wi[:2], atol=1e-12)
        assert forward.symmetry == "isotropic"
        with pytest.raises(TableError) as caught:
            load(text(*lines))
        assert caught.value.parameter == "convention"
        assert load(text("# convention: forward", *lines)).metadata.convention == "forward"

    def test_negative_polar_angle_is_the_other_side(self):
        lines = ("theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,brdf", "-30,0,30,0,1")
        table = load(text(*lines))
        np.testing.assert_allclose(table.wo, directions.mirror(table.wi), atol=1e-12)


class TestBadCells:
    def test_missing_cells_are_masked(self):
        rows = [f"30,{k},180,{v}" for k, v in enumerate(["", "nan", "NA", "-inf", "1e999", "1", "-0.5"])]
        table = load(text(HEADER, *rows))
        assert table.mask.tolist() == [False] * 5 + [True, False]
        assert table.metadata.masked == {"missing or not finite": 5, "negative": 1}
        assert table.value[6, 0] == -0.5

    def test_missing_angles_are_masked(self):
        table = load(text(HEADER, "30,nan,180,1", "30,inf,180,1", ",20,180,1", "30,20,180,1"))
        assert table.metadata.masked == {"direction not finite": 3}

    def test_below_and_on_the_horizon(self):
        table = load(
            text(HEADER, "30,90,180,1", "30,90.00001,180,1", "30,120,180,1", "90,10,0,1", "30,89.9,180,1")
        )
        # A viewer on the horizon is usable (and within rounding of it, the same geometry); a light is not.
        assert table.metadata.masked == {"below the horizon": 2, "repeated geometry": 1}

    def test_repeated_geometry(self):
        table = load(text(HEADER, "30,20,180,1", "30,20,180,2", "30,30,180,2"))
        assert table.metadata.masked == {"repeated geometry": 1}
        assert load(text(HEADER, "30,20,180,1", "30,20,180,2"), duplicates="keep").mask.all()

    def test_one_sample_and_one_incidence_are_said(self):
        assert any("one sample" in n for n in load(text(HEADER, "30,20,180,1")).metadata.notes)
        assert any(
            "one incidence" in n for n in load(text(HEADER, "30,20,180,1", "30,30,180,1")).metadata.notes
        )

    @pytest.mark.parametrize(
        ("lines", "code", "row", "column"),
        [
            ((HEADER, "30,20,180,1", "30,20,180"), "table-row-width", 3, None),
            (("# c", "", HEADER, "30,20,180,1", "30,20,180,1,7", "30,20,1,1"), "table-row-width", 5, None),
            ((HEADER, "30,20,180,1", "", "30,2o,180,1"), "table-not-a-number", 4, "theta_o_deg"),
            ((HEADER, "30,20,180,1_0"), "table-not-a-number", 2, "brdf"),
            ((HEADER.replace(",", ";"), "30;20,5;180;1"), "table-not-a-number", 2, "theta_o_deg"),
            ((HEADER, "30,20,180,1", "30,200,180,1"), "table-angle-range", 3, "theta_o_deg"),
            ((HEADER, "30,20,1800,1"), "table-angle-range", 2, "dphi_deg"),
            ((HEADER.replace("deg", "rad"), ".1,.2,0,1", "30,2,1,1"), "table-angle-range", 3, "theta_i_rad"),
            ((HEADER.replace("_deg", ""), "30,20,180,1"), "table-unit", None, "theta_i"),
            (("theta_i_deg,theta_o_deg,dphi_deg", "30,20,180"), "table-columns", None, None),
            (("theta_i_deg,dphi_deg,brdf", "30,20,180"), "table-columns", None, None),
            (("# quantity: radiance", HEADER, "30,20,180,1"), "table-header", 1, None),
            (("# rows: 5", HEADER, "30,20,180,1"), "table-truncated", 3, None),
            (("# aperture_deg: wide", HEADER, "30,20,180,1"), "table-header", 1, None),
            (("wi_x,wi_y,wi_z,wo_x,wo_y,wo_z,brdf", "0,0,2,0,0,1,1"), "table-not-unit", 2, "wi_x"),
            ((HEADER + ",brdf", "30,20,180,1,1"), "table-columns", None, "brdf"),
            ((HEADER + ",sigma_R", "30,20,180,1,1"), "table-columns", None, "sigma"),
            ((HEADER + ",ccbrdf_G", "30,20,180,1,1"), "table-quantity", None, None),
            ((HEADER + ",wi_x", "30,20,180,1,1"), "table-columns", None, None),
            ((HEADER, "30,20,180,nan"), "table-nothing-usable", None, None),
        ],
    )  # fmt: skip
    def test_errors_name_the_place(
        self, lines: tuple[str, ...], code: str, row: int | None, column: str | None
    ):
        with pytest.raises(TableError) as caught:
            load(text(*lines), name="bad.csv")
        error = caught.value
        assert (error.code, error.row, error.file) == (code, row, "bad.csv")
        if column:
            assert error.column == column
        assert error.remedy

    def test_radians_declared_as_degrees(self):
        rows = [f"{a / 10},{b / 10},3.1,1" for a in range(1, 6) for b in range(1, 8)]
        with pytest.raises(TableError) as caught:
            load(text(HEADER, *rows))
        assert caught.value.code == "table-angle-unit"
        assert caught.value.cause == "the angles are in radians"

    def test_byte_order_mark_and_quotes(self):
        table = load(
            b"\xef\xbb\xbf" + text('"theta_i_deg","theta_o_deg","dphi_deg","brdf"', '"30","20","180","1"')
        )
        assert len(table) == 1

    def test_columns_that_are_not_there(self):
        for columns in ({"x": "brdf"}, {"9": "brdf"}, {"brdf": "nonsense"}):
            with pytest.raises(TableError) as caught:
                load(text(HEADER, "30,20,180,1"), columns=columns)
            assert caught.value.parameter == "columns"


def same(a: Table, b: Table) -> None:
    np.testing.assert_array_equal(a.wi, b.wi)
    np.testing.assert_array_equal(a.wo, b.wo)
    np.testing.assert_array_equal(a.value, b.value)
    np.testing.assert_array_equal(a.mask, b.mask)
    if a.sigma is not None:
        np.testing.assert_array_equal(a.sigma, b.sigma)
    assert (a.channels, a.symmetry, a.hash) == (b.channels, b.symmetry, b.hash)
    # A sample masked for two reasons may be counted under the other one.
    assert sum(a.metadata.masked.values()) == sum(b.metadata.masked.values())


class TestWriter:
    @given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.booleans(), st.booleans())
    def test_scattered_comes_back_bit_for_bit(self, tmp_path_factory, seed, channels, with_sigma, with_mask):  # type: ignore[no-untyped-def]
        rng = np.random.default_rng(seed)
        n = 30
        theta, phi = rng.uniform(0, 1.7, (2, n)), rng.uniform(-7, 7, (2, n))
        theta[:, 0] = 0.3
        value = rng.lognormal(0, 3, (n, channels))
        names = ["R", "near infra-red, 1", "465nm"][:channels]
        value[3:5] = [[np.nan], [-1.0]]
        table = Table(
            wi=directions.vector_from_spherical(theta[0], phi[0]),
            wo=directions.vector_from_spherical(theta[1], phi[1]),
            value=value, sigma=rng.lognormal(0, 1, value.shape) if with_sigma else None,
            mask=np.arange(n) != 7 if with_mask else None,
            channels=[Channel(name, 500.0 + k) for k, name in enumerate(names)],
            metadata=Metadata(name="x", scale_uncertainty=0.1, angle_uncertainty=0.001, aperture=0.02),
        )  # fmt: skip
        path = tmp_path_factory.mktemp("written") / "t.csv"
        write_delimited(table, path)
        back = load(path)
        same(table, back)
        assert (back.metadata.aperture, back.metadata.angle_uncertainty) == (0.02, 0.001)
        assert [p.name for p in path.parent.iterdir()] == ["t.csv"]

    @pytest.mark.parametrize(
        "grid",
        [
            merl_grid((4, 3, 6)),
            merl_grid((4, 3, 6), "corner"),
            Grid("spherical_isotropic", {"theta_i": np.array([0.0, 0.5]), "theta_o": np.linspace(0, 1.5, 4),
                 "dphi": np.linspace(0, np.pi, 3)}),
            Grid("spherical_isotropic", {"theta_i": np.array([0.5]), "theta_o": np.linspace(0, 1.5, 4),
                 "dphi": np.arange(4) * np.pi / 2}, {"dphi": 2 * np.pi}),
            Grid("spherical", {"theta_i": np.array([0.1, 0.5]), "phi_i": np.array([0.0]),
                 "theta_o": np.linspace(0, 1.5, 4), "phi_o": np.arange(5) * 1.2}),
        ],
        ids=["center", "corner", "isotropic", "periodic", "spherical"],
    )  # fmt: skip
    def test_grids_come_back(self, grid: Grid, tmp_path):  # type: ignore[no-untyped-def]
        value = np.random.default_rng(0).lognormal(size=(grid.size, 3))
        table = Table(grid=grid, value=value)
        write_delimited(table, tmp_path / "g.csv")
        back = load(tmp_path / "g.csv")
        same(table, back)
        assert back.grid is not None
        assert dict(back.grid.periodic) == dict(grid.periodic)
        assert back.grid.system == grid.system

    def test_a_cut_file_is_noticed(self, tmp_path):  # type: ignore[no-untyped-def]
        path = tmp_path / "g.csv"
        write_delimited(Table(grid=merl_grid((4, 3, 6)), value=np.ones(72)), path)
        lines = path.read_text().splitlines()
        with pytest.raises(TableError, match="states 72"):
            load("\n".join(lines[:-3]).encode())


def test_a_convention_that_means_nothing_is_refused():
    for header, row in (("theta_h_deg,theta_d_deg,phi_d_deg,brdf", "10,20,30,1"),
                        ("wi_x,wi_y,wi_z,wo_x,wo_y,wo_z,brdf", "0,0,1,0,0,1,1")):  # fmt: skip
        with pytest.raises(TableError) as caught:
            load(text(header, row), convention="phi_specular_0")
        assert caught.value.parameter == "convention"


def test_zeros_and_an_open_last_line_are_noted():
    notes = load(text(HEADER, "30,20,180,0", "30,30,180,1")).metadata.notes
    assert any("exactly 0" in note for note in notes)
    assert any("no line end" in note for note in notes)
