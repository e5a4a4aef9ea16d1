"""Tables of the plane of incidence only: nothing makes a hemisphere of them without saying so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fitter
from fitter import directions
from fitter.errors import TableError
from fitter.formats import load, write
from fitter.grid import Grid
from fitter.quality import check
from fitter.table import Table
from tests.quality.tables import glossy

INCIDENCES = np.deg2rad([10.0, 30.0, 50.0, 70.0])


def scattered() -> Table:
    theta = np.deg2rad(np.arange(-80, 81, 5.0))
    wi = np.repeat(directions.vector_from_spherical(INCIDENCES, np.pi), len(theta), axis=0)
    wo = np.tile(directions.vector_from_spherical(theta, 0.0), (len(INCIDENCES), 1))
    return Table(wi=wi, wo=wo, value=glossy(wi, wo), symmetry="isotropic")


def gridded(system: str) -> Table:
    theta_o = np.deg2rad(np.arange(0, 81, 5.0))
    azimuths = np.array([0.0, np.pi])
    axes = {"theta_i": INCIDENCES, "theta_o": theta_o, "dphi": azimuths}
    if system == "spherical":
        axes = {"theta_i": INCIDENCES, "phi_i": azimuths, "theta_o": theta_o, "phi_o": azimuths}
    grid = Grid(system, axes)
    return Table(grid=grid, value=glossy(*grid.directions()))


KINDS = {
    "scattered": scattered, "isotropic grid": lambda: gridded("spherical_isotropic"),
    "grid": lambda: gridded("spherical"),
}  # fmt: skip


@pytest.fixture(params=KINDS)
def table(request: pytest.FixtureRequest) -> Table:
    return KINDS[request.param]()


def test_beside_the_plane_is_extrapolated(table: Table):
    wi = directions.vector_from_spherical(INCIDENCES[1], 0.0)
    phi = np.deg2rad([0.0, 180.0, 2.0, 90.0, 178.0])
    wo = directions.vector_from_spherical(np.full(5, np.deg2rad(40.0)), phi)
    values, extrapolated = table.evaluate(wi, wo)
    np.testing.assert_array_equal(extrapolated, [False, False, True, True, True])
    expected = glossy(np.broadcast_to(wi, (2, 3)), wo[:2])
    np.testing.assert_allclose(values[:2, 0], expected, rtol=1e-9)


def test_there_is_nothing_to_draw_from(table: Table):
    with pytest.raises(TableError) as caught:
        fitter.TableSampler(table)
    assert caught.value.code == "in-plane-only"


def test_no_energy_and_no_holes_are_claimed(table: Table):
    found = check(table)
    assert found["domain"].numbers["in_plane"] is True
    assert not found["reflectance"].judged
    assert "plane of incidence" in found["reflectance"].sentence
    assert not found["holes"].judged


@pytest.mark.parametrize("name", ["merl", "rgl", "mbsdf"])
def test_formats_of_a_hemisphere_refuse_it(table: Table, name: str, tmp_path: Path):
    with pytest.raises(TableError) as caught:
        write(table, tmp_path / "t", name)
    assert caught.value.code == "table-unwritable"
    assert not (tmp_path / "t").exists()


@pytest.mark.parametrize("name", ["astm", "delimited", "netcdf", "pab-opto", "parquet", "zemax"])
def test_others_stay_in_the_plane(table: Table, name: str, tmp_path: Path):
    if name == "zemax" and table.symmetry == "anisotropic":
        table = scattered()
    losses = write(table, tmp_path / "t", name)
    assert ("in_plane" in {loss.code for loss in losses}) is (name == "zemax")
    back = load(tmp_path / "t")
    assert back.domain.in_plane
    values, outside = table.evaluate(*back.directions(np.flatnonzero(back.mask)))
    inside = ~outside
    np.testing.assert_allclose(back.value[back.mask][inside], values[inside], rtol=1e-9)
