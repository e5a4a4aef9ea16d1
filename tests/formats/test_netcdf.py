"""Classic NetCDF: coordinates spread over the grid, CF's attributes obeyed, nothing believed about sizes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import netcdf_file

from fitter import directions
from fitter.errors import TableError
from fitter.formats import labelled, load, load_all, write
from fitter.table import Table
from tests.formats.samples import delimited_bytes, netcdf_bytes

Variables = Mapping[str, tuple[Sequence[str], Any, Mapping[str, Any]]]
DEG = {"units": b"degrees"}


def made(dimensions: Mapping[str, int], variables: Variables, **attributes: bytes) -> bytes:
    """A file of variables (dimensions, numbers, attributes)."""
    sink = BytesIO()
    file: Any = netcdf_file(sink, "w")
    for key, text in attributes.items():
        setattr(file, key, text)
    for name, size in dimensions.items():
        file.createDimension(name, size)
    for name, (over, numbers, said) in variables.items():
        numbers = np.asarray(numbers)
        variable = file.createVariable(name, numbers.dtype, tuple(over))
        variable[...] = numbers
        for key, value in said.items():
            setattr(variable, key, value)
    file.flush()
    return sink.getvalue()


def test_coordinates_are_axes():
    ours, text = load(netcdf_bytes()), load(delimited_bytes())
    assert ours.grid is not None
    assert ours.grid.system == "spherical_isotropic"
    np.testing.assert_allclose(ours.wo, text.wo, atol=1e-15)
    np.testing.assert_array_equal(ours.value, text.value)
    assert ours.metadata.provenance["title"] == "made up"
    peak = int(np.argmax(ours.value[:, 0]))
    assert directions.mirror(ours.wi[peak]) @ ours.wo[peak] > 0.99


def test_any_order_of_dimensions():
    """brdf(dphi, theta_o) with theta_i for each theta_o: every number at its own direction."""
    wanted = np.arange(6.0).reshape(3, 2) + 1
    table = load(made(
        {"a": 3, "b": 2},
        {
            "dphi": (["a"], [0.0, 90.0, 180.0], DEG), "theta_o": (["b"], [10.0, 20.0], DEG),
            "theta_i": (["b"], [30.0, 40.0], DEG), "brdf": (["a", "b"], wanted, {}),
            "sigma": (["b", "a"], 0.1 * wanted.T, {}),
        },
    ))  # fmt: skip
    assert table.sigma is not None
    for row in range(6):
        a, b = divmod(row, 2)
        at = int(np.flatnonzero(table.value[:, 0] == wanted[a, b])[0])
        expected = directions.vector_from_spherical(np.deg2rad([10, 20][b]), np.deg2rad([0, 90, 180][a]))
        np.testing.assert_allclose(table.wo[at], expected, atol=1e-12)
        assert table.wi[at, 2] == pytest.approx(np.cos(np.deg2rad([30, 40][b])))
        assert table.sigma[at, 0] == pytest.approx(0.1 * wanted[a, b])


ANGLES: Variables = {
    "theta_i_deg": (["n"], [30.0, 30.0, 30.0], {}), "theta_o_deg": (["n"], [30.0, 40.0, 50.0], {}),
    "dphi": (["n"], [np.pi, np.pi, 0.0], {"units": b"radian"}),
}  # fmt: skip


def test_packed_and_missing_numbers():
    packed = {"scale_factor": 0.5, "add_offset": 1.0, "_FillValue": np.int16(-999)}
    stored = np.array([4, -999, 6], "i2")
    table = load(made({"n": 3}, {**ANGLES, "brdf": (["n"], stored, packed)}))
    np.testing.assert_array_equal(table.value[[0, 2], 0], [3.0, 4.0])
    assert table.metadata.masked == {"missing or not finite": 1}
    np.testing.assert_allclose(table.wo[0], directions.mirror(table.wi[0]), atol=1e-12)


def test_wavelengths_and_items():
    spectral: Variables = {
        **ANGLES, "wavelength": (["w"], [0.5, 0.6], {"units": b"um"}),
        "brdf": (["w", "n"], [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], {}),
    }  # fmt: skip
    tables = load_all(made({"n": 3, "w": 2}, spectral))
    assert [t.channels[0].wavelength_nm for t in tables] == [500.0, 600.0]
    assert tables[1].value[:, 0].tolist() == [4, 5, 6]
    letters = np.array([list("red "), list("blue"), list("red ")], "S1")
    named: Variables = {
        **ANGLES, "item": (["n", "letters"], letters, {}), "brdf": (["n"], [1.0, 2.0, 3.0], {}),
    }  # fmt: skip
    assert load(made({"n": 3, "letters": 4}, named), item="red").value[:, 0].tolist() == [1, 3]
    named = {key: entry for key, entry in named.items() if key != "item"}
    numbered = made({"n": 3}, {**named, "item": (["n"], [7.0, 8.0, 7.0], {})})
    assert load(numbered, item="7").value[:, 0].tolist() == [1, 3]


@pytest.mark.parametrize(
    ("variables", "attributes", "code"),
    [
        ({**ANGLES, "value": (["n"], np.ones(3), {})}, {}, "table-quantity"),
        ({**ANGLES, "brdf": (["n"], np.ones(3), {}), "sigma": (["m"], np.ones(2), {})}, {}, "table-columns"),
        ({**ANGLES, "brdf": (["n"], np.ones(3), {}), "phi_i": (["n"], np.ones(3), {})}, {}, "table-unit"),
        ({**ANGLES, "theta_i_deg": (["n"], np.ones(3), {"units": b"radian"})}, {}, "table-unit"),
        ({**ANGLES, "brdf": (["n"], np.array(list("abc"), "S1"), {})}, {}, "table-not-a-number"),
        ({**ANGLES, "brdf": (["n"], np.ones(3), {})}, {"quantity": b"btdf"}, "table-header"),
        ({**ANGLES, "brdf": (["n"], np.ones(3), {})}, {"notes": b"none"}, "table-header"),
        ({**ANGLES, "brdf": (["n"], np.ones(3), {})}, {"quantity": b"\xff"}, "table-truncated"),
        ({}, {}, "table-empty"),
    ],
)
def test_refused(variables: Variables, attributes: dict[str, bytes], code: str):
    with pytest.raises(TableError) as caught:
        load(made({"n": 3, "m": 2}, variables, **attributes), name="bad.nc")
    assert caught.value.code == code
    assert caught.value.file == "bad.nc"
    assert caught.value.remedy


def test_what_spreads_without_limit(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(labelled, "LARGEST", 100)
    with pytest.raises(TableError) as caught:
        load(netcdf_bytes())
    assert caught.value.code == "table-too-large"


@pytest.mark.parametrize("magic", [b"\x89HDF\r\n\x1a\n", b"CDF\x05"])
def test_newer_kinds_are_named(magic: bytes):
    with pytest.raises(TableError, match="NetCDF-4"):
        load(magic + bytes(500))


def test_written_file_has_axes_and_units(tmp_path: Path):
    table = load(delimited_bytes())
    assert write(table, tmp_path / "t.nc", "netcdf") == []
    file: Any = netcdf_file(tmp_path / "t.nc", "r", mmap=False)
    assert file.variables["brdf_per_sr_R"].dimensions == ("theta_i_rad", "theta_o_rad", "dphi_rad")
    assert file.variables["brdf_per_sr_R"].units == b"sr-1"
    assert file.variables["theta_i_rad"].units == b"radian"
    np.testing.assert_array_equal(file.variables["theta_o_rad"][:], np.deg2rad([5, 25, 45, 65]))
    file.close()


def test_text_beyond_ascii(tmp_path: Path):
    w = directions.vector_from_spherical(np.deg2rad([10.0, 20.0]), 0.0)
    table = Table(wi=w, wo=directions.mirror(w), value=[1.0, 2.0], channels=["grün"])
    assert write(table, tmp_path / "t", "netcdf") == []
    assert load(tmp_path / "t").channels[0].name == "grün"
