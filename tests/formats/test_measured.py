"""The measured tables: they load, and their specular and retro peaks sit where they belong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fitter import directions
from fitter.errors import TableError
from fitter.formats import describe, load, load_all

pytestmark = pytest.mark.measured


def peak(document: dict[str, Any], theta_i: float, side: str) -> tuple[float, float]:
    entry = next(e for e in document["peaks"] if abs(e["theta_i_deg"] - theta_i) < 0.6)
    return entry[side]["theta_o_deg"], entry[side]["value_per_sr"]


def test_garnet_red(shared: Path):
    table = load(shared / "measured/cornell/garnet_red_RGB.astm")
    document = describe(table)
    assert (len(table), document["format"], document["quantity"]) == (1439, "astm", "brdf")
    assert document["masked"] == {"negative": 153}
    for theta_i in (20, 30, 40, 50):
        specular, retro = peak(document, theta_i, "specular_side"), peak(document, theta_i, "retro_side")
        assert (
            abs(specular[0] - theta_i) < 10
        )  # the peak of a glossy paint lies at or beyond the mirror angle
        assert specular[1] > 2 * retro[1]


def test_yellow_tape(shared: Path):
    path = shared / "measured/retro/retro-3M-jaune.dat"
    table = load(path)
    assert (len(table), table.metadata.quantity) == (7397, "ccbrdf")
    assert table.metadata.masked == {"missing or not finite": 86}
    for quantity in (None, "brdf"):
        document = describe(load(path, quantity=quantity))
        for theta_i in (15, 30, 60):
            assert peak(document, theta_i, "retro_side")[0] == pytest.approx(theta_i, abs=1.0)
            assert peak(document, theta_i, "specular_side")[0] == pytest.approx(theta_i, abs=1.0)
    assert load(path, quantity="brdf").value.max() == 19.3009


def test_gray_tape(shared: Path):
    path = shared / "measured/retro/retro-gray-tape.dat"
    with pytest.raises(TableError) as caught:
        load(path)
    assert caught.value.parameter == "quantity"
    table = load(path, quantity="brdf")
    best = int(np.argmax(table.value[:, 0]))
    assert table.value[best, 0] > 72
    np.testing.assert_allclose(table.wo[best], table.wi[best], atol=1e-6)
    document = describe(table)
    for theta_i in (15, 30):
        assert peak(document, theta_i, "retro_side")[1] > 40 * peak(document, theta_i, "specular_side")[1]


@pytest.mark.parametrize(
    "name", ["aluminium_anodised", "aluminium_sandblasted", "brass", "lacquer_smooth", "stainless_steel"]
)
def test_mwir(shared: Path, name: str):
    path = shared / "measured/mwir" / f"{name}.csv"
    with pytest.raises(TableError) as caught:
        load(path)
    assert caught.value.parameter == "convention"
    table = load(path, convention="forward")
    assert table.metadata.masked == {"below the horizon": 10}
    assert table.domain.in_plane
    theta_i, theta_o = (np.rad2deg(np.arccos(w[:, 2])) for w in (table.wi, table.wo))
    assert (table.wi[:, 0] * table.wo[:, 0] <= 0).all()
    for fixed in (20, 30, 40, 50):
        here = np.flatnonzero((np.abs(theta_o - fixed) < 0.1) & table.mask & (theta_i < 85))
        if name != "aluminium_sandblasted":  # too rough: its peak lies beyond the mirror angle
            assert abs(theta_i[here[np.argmax(table.value[here, 0])]] - fixed) <= 2


def test_ptfe_by_declared_columns(shared: Path):
    path = shared / "measured/nist_ptfe/PTFE.data.csv"
    declared = {
        "lambda": "wavelength_um", "thetai": "theta_i_deg", "phi": "phi_i_deg", "thetar": "theta_o_deg",
        "phir": "phi_o_deg", "f_r11": "brdf",
    }  # fmt: skip
    tables = load_all(path, columns=declared)
    assert [t.channels[0].wavelength_nm for t in tables] == [351, 532, 633, 1064]
    table = load(path, columns=declared, item="633nm")
    assert len(table) == 1824
    wi, wo, f = table.wi, table.wo, table.value[:, 0]
    oblique = (wi[:, 2] < np.cos(np.deg2rad(55))) & (wo[:, 2] < np.cos(np.deg2rad(55)))
    cos_dphi = (wi[:, :2] * wo[:, :2]).sum(1) / np.hypot(*wi[:, :2].T) / np.hypot(*wo[:, :2].T)
    forward, back = f[oblique & (cos_dphi < -0.9)].mean(), f[oblique & (cos_dphi > 0.9)].mean()
    assert forward > 1.2 * back


@pytest.mark.parametrize(
    "name",
    ["curet/table.txt", "README.md", "nist_ptfe/PTFE.data.csv", "rgl/reference_evaluations.csv"],
)
def test_what_can_not_be_read_is_a_typed_error(shared: Path, name: str):
    with pytest.raises(TableError) as caught:
        load_all(shared / "measured" / name)
    assert caught.value.file == name.split("/")[1] if "/" in name else "README.md"
    assert caught.value.remedy


def test_curet(shared: Path):
    folder = shared / "measured/curet"
    tables = load_all(folder)
    assert [t.metadata.provenance["sample"] for t in tables] == list(range(1, 46))
    assert {len(t) for t in tables} == {205}
    foil = load(folder / "abrdf.dat", item="15")
    assert foil.hash == tables[14].hash == load(folder, item=15).hash
    for table in (foil, tables[3], tables[11]):  # aluminium foil, rough plastic, rough paper: glossy
        towards_mirror = (directions.mirror(table.wi) * table.wo).sum(axis=1)
        towards_light = (table.wi * table.wo).sum(axis=1)
        best = np.argsort(table.value[:, 0])[-3:]
        assert (towards_mirror[best] > 0.98).all()
        assert (towards_light[best] < 0).all()
    level = np.array([np.mean(t.value[t.mask]) for t in tables])
    assert (level < 0.5).all()
    assert (level > 0.01).all()
