"""RGL tensor files: samples where they belong, the evaluation against an independent renderer's, damage."""

from __future__ import annotations

import csv
import struct
import time
from pathlib import Path

import numpy as np
import pytest

from fitter import directions
from fitter.errors import TableError
from fitter.formats import describe, load
from fitter.formats.rgl import adaptive_of, samples
from fitter.formats.source import Source
from fitter.formats.tensor_file import fields
from fitter.sampling.parameterisation import Adaptive
from tests.formats.samples import rgl_bytes, rgl_fields, tensor_file

MATERIALS = ("aurora_white", "cc_ibiza_sunset", "cm_military_green", "irid_flake_paint1", "vch_silk_blue")


def opened(given: bytes | Path) -> Adaptive:
    source = Source(given)
    return adaptive_of(source, fields(source))[0]


def bilinear(image: list[float], columns: int, x: float) -> float:
    """An image whose rows are alike, along x."""
    k = min(int(x * (columns - 1)), columns - 2)
    share = x * (columns - 1) - k
    return (1 - share) * image[k] + share * image[k + 1]


def unit(theta: float, phi: float) -> np.ndarray:
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


class TestSamples:
    @pytest.mark.parametrize("phi_i", [(0.0,), (-3.0, -1.0, 1.0, 3.0)])
    @pytest.mark.parametrize("spectral", [False, True])
    def test_one_by_one(self, phi_i: tuple[float, ...], spectral: bool):
        """Every sample by the formula, in plain arithmetic; the warp of the made-up file is the identity."""
        made = rgl_fields(phi_i, spectral)
        table = load(tensor_file(made), negatives="keep", duplicates="keep")
        isotropic, n = len(phi_i) == 1, 4
        assert table.symmetry == ("isotropic" if isotropic else "anisotropic")
        data = np.float32(made["spectra" if spectral else "rgb"][2]).reshape(len(phi_i), 3, -1, n, n)
        row = 0
        for p, phi in enumerate(np.float32(phi_i)):
            for t, theta in enumerate(np.float32([0.0, 0.5, 1.0])):
                wi = unit(float(theta), float(phi))
                sigma = bilinear([1.0, 0.75, 0.5], 3, np.sqrt(theta * 2 / np.pi))
                for y in range(n):
                    for x in range(n):
                        theta_m = (x / 3) ** 2 * np.pi / 2
                        phi_m = (2 * y / 3 - 1) * np.pi + (phi if isotropic else 0)
                        m = unit(theta_m, phi_m)
                        wo = 2 * (m @ wi) * m - wi
                        np.testing.assert_allclose(table.wi[row], wi, atol=1e-7)
                        np.testing.assert_allclose(table.wo[row], wo, atol=1e-6)
                        assert table.mask[row] == (wo[2] > 0)
                        if wo[2] > 0:
                            ndf = bilinear([4.0, 1.0, 0.0], 3, x / 3)
                            expected = data[p, t, :, y, x] * ndf / (4 * sigma) / wo[2]
                            np.testing.assert_allclose(table.value[row], expected, rtol=1e-5)
                        row += 1
        assert row == len(table)

    def test_channels(self):
        table = load(tensor_file(rgl_fields(spectral=True)))
        assert [(c.name, c.wavelength_nm) for c in table.channels] == [
            ("400nm", 400.0), ("500.1nm", 500.1), ("600nm", 600.0), ("700nm", 700.0)
        ]  # fmt: skip
        table = load(rgl_bytes())
        assert [c.name for c in table.channels] == ["R", "G", "B"]
        assert (table.metadata.name, table.metadata.quantity) == ("made up", "ccbrdf")
        assert table.metadata.masked["repeated geometry"] > 0

    def test_values_as_stored(self):
        stored = load(rgl_bytes(), quantity="brdf")
        table = load(rgl_bytes())
        z = stored.wo[stored.mask, 2:]
        np.testing.assert_allclose(stored.value[stored.mask], table.value[stored.mask] * z, rtol=1e-12)

    def test_without_jacobian(self):
        made = rgl_fields()
        made["jacobian"] = ("B", (1,), [0])
        adaptive = opened(tensor_file(made))
        values = samples(adaptive)[2]
        np.testing.assert_array_equal(values[:16, 0], np.float32(made["rgb"][2][:16]))

    def test_other_element_types(self):
        made = rgl_fields()
        for name in ("sigma", "vndf", "rgb"):
            made[name] = ("d", *made[name][1:])
        made["theta_i"] = ("d", (3,), np.float32(made["theta_i"][2]).tolist())
        np.testing.assert_allclose(load(tensor_file(made)).value, load(rgl_bytes()).value, rtol=1e-6)


def test_the_samples_are_on_the_function():
    """What lies between the samples goes through them."""
    rng = np.random.default_rng(3)
    for phi_i in ((0.0,), (-3.0, -1.0, 1.0, 3.0)):
        made = rgl_fields(phi_i, resolution=6)
        made["vndf"] = ("f", made["vndf"][1], rng.uniform(0.2, 1, len(made["vndf"][2])).tolist())
        adaptive = opened(tensor_file(made))
        wi, wo, values = samples(adaptive)
        column, row = np.arange(len(wi)) % 6, np.arange(len(wi)) // 6 % 6
        # At the ends of the square several samples share a direction.
        inner = (wo[:, 2] > 0) & (column > 0) & (row > 0) & (row < 5) & (wi[:, 2] < 0.99)
        assert inner.sum() > 20
        np.testing.assert_allclose(adaptive.evaluate(wi[inner], wo[inner]), values[inner], rtol=1e-9)


@pytest.mark.parametrize(
    ("phi_i", "folds"), [((-np.pi, -2.0, -1.0, 0.0), 2), ((-np.pi, -2.5, -np.pi / 2), 4)]
)
def test_stated_symmetry(phi_i: tuple[float, ...], folds: int):
    adaptive = opened(tensor_file(rgl_fields(phi_i, resolution=6)))
    assert adaptive.folds == folds
    rng = np.random.default_rng(2)
    theta, phi = rng.uniform(0.1, 1, (2, 50)), rng.uniform(-np.pi, np.pi, (2, 50))
    wi, wo = directions.vector_from_spherical(theta, phi)
    value = adaptive.evaluate(wi, wo)
    turns = [[-1, -1, 1]] if folds == 2 else [[-1, -1, 1], [1, -1, 1], [-1, 1, 1]]
    for turn in np.array(turns, float):
        np.testing.assert_allclose(adaptive.evaluate(wi * turn, wo * turn), value, rtol=1e-12)
    assert any("repeat" in note for note in load(tensor_file(rgl_fields(phi_i))).metadata.notes)


class TestDamage:
    @pytest.mark.parametrize(
        "name", ["theta_i", "phi_i", "sigma", "ndf", "vndf", "rgb", "jacobian"]
    )  # fmt: skip
    def test_missing_field(self, name: str):
        made = rgl_fields()
        del made[name]
        with pytest.raises(TableError) as caught:
            load(tensor_file(made), name="f.bsdf")
        error = caught.value
        assert (error.code, error.file) == ("table-header", "f.bsdf")
        assert name in error.message or name == "rgb"
        assert error.remedy

    @pytest.mark.parametrize(
        ("name", "field"),
        [
            ("theta_i", ("f", (3,), [0.0, 1.0, 0.5])),
            ("theta_i", ("f", (3,), [0.0, 30.0, 60.0])),
            ("theta_i", ("f", (3,), [0.0, np.nan, 1.0])),
            ("theta_i", ("f", (2,), [0.0, 1.0])),
            ("theta_i", ("f", (1, 3), [0.0, 0.5, 1.0])),
            ("phi_i", ("f", (2,), [0.0, 1.0])),
            ("sigma", ("f", (2, 3), [1.0, 0.5, 0.0] * 2)),
            ("sigma", ("f", (1, 3), [1.0, 0.5, 0.2])),
            ("ndf", ("f", (2, 3), [1.0, -0.5, 0.0] * 2)),
            ("ndf", ("f", (2, 3), [1.0, np.inf, 0.0] * 2)),
            ("vndf", ("f", (1, 3, 3, 5), [1.0] * 30 + [0.0] * 15)),
            ("vndf", ("f", (1, 3, 3, 5), [1.0] * 44 + [np.nan])),
            ("vndf", ("d", (1, 3, 3, 5), [1e308] * 45)),
            ("rgb", ("f", (1, 3, 4, 4, 4), [1.0] * 192)),
            ("rgb", ("f", (1, 3, 3, 1, 16), [1.0] * 144)),
            ("jacobian", ("B", (0,), [])),
            ("measured", ("B", (3,), [1, 1, 1])),
        ],
    )
    def test_bad_field(self, name: str, field: tuple[str, tuple[int, ...], list[float]]):
        with pytest.raises(TableError) as caught:
            load(tensor_file({**rgl_fields(), name: field}), name="f.bsdf")
        assert caught.value.code == "table-header"
        assert caught.value.remedy

    @pytest.mark.parametrize("wavelengths", [[500.0, 400, 600, 700], [0.0, 1, 2, 3], [np.nan, 400, 500, 600]])
    def test_bad_wavelengths(self, wavelengths: list[float]):
        made = rgl_fields(spectral=True)
        made["wavelengths"] = ("f", (4,), wavelengths)
        with pytest.raises(TableError, match="wavelengths"):
            load(tensor_file(made))

    def test_version(self):
        with pytest.raises(TableError, match="version 2"):
            load(tensor_file(rgl_fields(), version=2))

    def patched(self, name: str, at: int, form: str, value: int) -> bytes:
        """The file with one number behind the name of a field replaced."""
        data = bytearray(rgl_bytes())
        start = data.index(struct.pack("<H", len(name)) + name.encode()) + 2 + len(name)
        struct.pack_into(form, data, start + at, value)
        return bytes(data)

    def test_type(self):
        for kind in (0, 12, 255):
            with pytest.raises(TableError, match=f"unknown type {kind}"):
                load(self.patched("sigma", 2, "<B", kind))

    def test_sizes_are_checked_before_anything_is_allocated(self):
        start = time.perf_counter()
        for at, value in ((3, 2**63), (3, 10**6), (11, 2**62), (11, 2**64 - 1), (11, 10**12)):
            with pytest.raises(TableError) as caught:
                load(self.patched("vndf", at, "<Q", value))
            assert caught.value.code == "table-truncated"
        with pytest.raises(TableError):
            load(self.patched("vndf", 0, "<H", 65535))
        with pytest.raises(TableError, match="shape"):
            load(self.patched("vndf", 11, "<Q", 0))
        many = bytearray(rgl_bytes())
        struct.pack_into("<I", many, 14, 2**32 - 1)
        with pytest.raises(TableError):
            load(bytes(many))
        assert time.perf_counter() - start < 2

    def test_twice(self):
        data = rgl_bytes().replace(b"\x03\x00ndf", b"\x03\x00rgb")
        with pytest.raises(TableError, match="twice"):
            load(data)


@pytest.mark.measured
class TestMeasured:
    @pytest.mark.parametrize("material", MATERIALS)
    def test_against_an_independent_renderer(self, shared: Path, material: str):
        folder = shared / "measured/rgl"
        with (folder / "reference_evaluations.csv").open() as file:
            rows = [list(row.values()) for row in csv.DictReader(file) if row["file"].startswith(material)]
        assert len(rows) == 300
        numbers = np.array([row[1:] for row in rows], float)
        wi, wo = (directions.vector_from_spherical(*np.deg2rad(numbers[:, k : k + 2].T)) for k in (0, 2))
        found = opened(folder / f"{material}_rgb.bsdf").evaluate(wi, wo)
        off = np.abs(found - numbers[:, 4:]) / np.maximum(np.abs(numbers[:, 4:]), 1e-2)
        print(f"{material}: largest difference {off.max():.1e}, median {np.median(off):.1e}")
        assert off.max() < 1e-5

    @pytest.mark.parametrize("material", MATERIALS)
    def test_the_table(self, shared: Path, material: str):
        path = shared / f"measured/rgl/{material}_rgb.bsdf"
        load(path)
        start = time.perf_counter()
        table = load(path)
        assert time.perf_counter() - start < 1.0
        assert len(table) == 8 * 32 * 32
        assert table.symmetry == "isotropic"
        assert table.domain.incidences == 7  # the eighth is on the horizon
        adaptive = opened(path)
        own = np.flatnonzero(table.mask & (np.abs(table.wo[:, 1]) > 1e-6))
        found = adaptive.evaluate(table.wi[own], table.wo[own]) / table.wo[own, 2:]
        # The file has float32 angles, here they have gone through a vector.
        off = np.abs(found - table.value[own]) / np.maximum(np.abs(table.value[own]), 1e-2)
        assert off.max() < 1e-4
        if material != "vch_silk_blue":  # its specular directions are negative in red: outside the gamut
            for peak in describe(table)["peaks"]:
                assert 0 <= peak["specular_side"]["theta_o_deg"] - peak["theta_i_deg"] < 7
                if peak["retro_side"] is not None:
                    assert peak["specular_side"]["value_per_sr"] > peak["retro_side"]["value_per_sr"]

    @pytest.mark.parametrize("material", MATERIALS)
    def test_it_reflects_no_more_than_arrives(self, shared: Path, material: str):
        """The values hold the cosine: their integral over directions is the reflectance."""
        adaptive = opened(shared / f"measured/rgl/{material}_rgb.bsdf")
        theta, phi = (np.arange(180) + 0.5) / 180 * np.pi / 2, (np.arange(360) + 0.5) / 180 * np.pi
        t, p = (g.reshape(-1) for g in np.meshgrid(theta, phi, indexing="ij"))
        wo, area = directions.vector_from_spherical(t, p), np.sin(t) * (np.pi / 360) * (np.pi / 180)
        for theta_i in np.deg2rad([10.0, 50.0]):
            wi = np.tile(directions.vector_from_spherical(theta_i, 0.0), (len(wo), 1))
            reflectance = adaptive.evaluate(wi, wo).T @ area
            print(material, np.rad2deg(theta_i), reflectance)
            assert (reflectance > -0.01).all()
            assert (reflectance < 1.0).all()

    @pytest.mark.parametrize("material", MATERIALS)
    def test_the_directions_are_those_of_its_makers(self, shared: Path, material: str):
        """The file's own bits say which samples lie above the horizon (in one file: which do not)."""
        path = shared / f"measured/rgl/{material}_rgb.bsdf"
        stated = np.unpackbits(fields(Source(path))["valid"]).astype(bool)
        _, wo, _ = samples(opened(path))
        above = wo[:, 2] > 0
        same = (above == stated).mean() if material != "vch_silk_blue" else (above != stated).mean()
        assert same > 0.99
