"""The majorants are theorems: attacked with rough tables, odd cells and points on their edges."""

from __future__ import annotations

import numpy as np
import pytest

from fitter.directions import vector_from_spherical
from fitter.sampling.bilinear import BilinearEnvelope
from fitter.sampling.cells import ChartSlice
from fitter.sampling.energy import GridEnergy
from fitter.sampling.grid import GridInterpolant
from fitter.sampling.half_difference import HalfDifferenceField
from fitter.sampling.interpolant import interpolant
from fitter.sampling.maxima import BoxMaximum, WindowMaximum
from fitter.sampling.spherical import SphericalField, SphericalSlice
from fitter.sampling.triangles import TriangleEnvelope
from fitter.table import Table
from tests.sampling.tables import anisotropic, merl, scattered, spherical


def rough(table: Table, holes: float) -> Table:
    """The same grid with spiky values over six decades and masked nodes."""
    rng = np.random.default_rng(5)
    value = 10 ** rng.uniform(-3, 3, table.value.shape)
    return Table(value=value, grid=table.grid, mask=rng.random(len(table)) > holes)


def points_in(cells: np.ndarray, per: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points all over each cell, many of them on its sides and corners."""
    share = rng.random((2, len(cells), per))
    share = np.where(rng.random(share.shape) < 0.4, np.round(share), share)
    theta0, theta1, phi0, phi1 = (side[:, None] for side in cells.T)
    return theta0 + share[0] * (theta1 - theta0), phi0 + share[1] * (phi1 - phi0)


@pytest.mark.parametrize("degree", [0.0, 0.01, 30, 75, 89])
@pytest.mark.parametrize("holes", [0.0, 0.01])
def test_half_difference_bounds_hold_on_any_cell(degree: float, holes: float) -> None:
    table = rough(merl(0.1, shape=(20, 18, 36)), holes)
    grid = interpolant(table)
    assert isinstance(grid, GridInterpolant)
    part = grid.slice(vector_from_spherical(np.deg2rad(degree), 0.4))
    assert isinstance(part, ChartSlice)
    field = HalfDifferenceField(grid, part, np.ones(1))
    rng = np.random.default_rng(int(degree * 100))
    count = 3000
    size = 10 ** rng.uniform(-5, 0, (2, count))
    theta0 = rng.uniform(0, np.pi / 2, count)
    # Half of the cells around the mirror direction, where the angles change fastest.
    theta0[::2] = np.clip(np.deg2rad(degree) + rng.normal(0, 0.05, len(theta0[::2])), 0, np.pi / 2 - 1e-6)
    phi0 = np.where(np.arange(count) % 2 == 0, np.pi + rng.normal(0, 0.05, count), rng.uniform(-4, 4, count))
    cells = np.stack([theta0, np.minimum(theta0 + size[0], np.pi / 2), phi0, phi0 + size[1]], axis=1)
    bound = field.bound(cells)
    theta, phi = points_in(cells, 40, rng)
    density = field.field(theta.reshape(-1), phi.reshape(-1)).reshape(theta.shape)
    assert not (density > bound[:, None]).any()
    if holes == 0 and degree >= 30:
        # And they are worth having: tight for small cells (near the normal phi_d is free, so not there).
        small = (size.max(axis=0) < 1e-4) & np.isfinite(density).all(axis=1) & (density > 0).all(axis=1)
        assert np.median(density.max(axis=1)[small] / bound[small]) > 0.5


@pytest.mark.parametrize("root", [1.0, 2.5])
@pytest.mark.parametrize("table", [spherical(0.2, 15, 16), anisotropic()])
def test_bilinear_envelopes_dominate(table: Table, root: float) -> None:
    grid = interpolant(rough(table, 0.02))
    assert isinstance(grid, GridInterpolant)
    incidences = int(np.prod(grid.grid.shape[:-2]))
    vars(grid)["_energies"] = {k: GridEnergy(0.0, root, 0.0) for k in range(incidences)}
    part = grid.slice(vector_from_spherical(0.6, 0.2))
    assert isinstance(part, SphericalSlice)
    channels = part.nodes[0].value.shape[1]
    field = SphericalField(part, np.full(channels, 1 / channels))
    envelope = BilinearEnvelope(field, 0.9, 4000, "rejection")
    density, bound = envelope.attack(np.random.default_rng(1), 100_000)
    assert not (density > bound).any()
    assert np.nanmedian(density / bound) > 0.7
    # The mass that is drawn from is that of a plain sum over the hemisphere.
    u, phi = (np.arange(1500) + 0.5) / 1500, (np.arange(3000) + 0.5) / 3000 * 2 * np.pi - np.pi
    plain = sum(
        float(np.nan_to_num(field.density(np.full(3000, np.arcsin(np.sqrt(x))), phi)).mean()) for x in u
    )
    assert envelope.info.integral == pytest.approx(np.pi * plain / 1500, rel=3e-3)


def test_triangle_majorants_hold() -> None:
    base = scattered(0.2, degrees=(10, 30), count=200)
    rng = np.random.default_rng(5)
    table = Table(wi=base.wi, wo=base.wo, value=10 ** rng.uniform(-3, 3, len(base)), symmetry="isotropic")
    for degree in (10.0, 22.0):
        part = interpolant(table).slice(vector_from_spherical(np.deg2rad(degree), 1.0))
        envelope = part.envelope(np.ones(1), 0.9, 20_000, "rejection")
        assert isinstance(envelope, TriangleEnvelope)
        values, bound = envelope.attack(rng, 50_000)
        assert not (values > bound).any()
        assert envelope.info.acceptance > 0.8


def test_range_maxima_against_brute_force() -> None:
    rng = np.random.default_rng(3)
    table = rng.random((13, 9))
    largest = BoxMaximum(table)
    i = np.sort(rng.integers(0, 13, (200, 2)), axis=1)
    j = np.sort(rng.integers(0, 9, (200, 2)), axis=1)
    expected = [table[a : b + 1, c : d + 1].max() for (a, b), (c, d) in zip(i, j, strict=True)]
    np.testing.assert_array_equal(largest(i[:, 0], i[:, 1], j[:, 0], j[:, 1]), expected)

    nodes = (np.arange(24) + 0.5) / 24 * np.pi
    table = rng.random((3, 2, 24))
    low = rng.uniform(-1, np.pi, 300)
    high = low + rng.uniform(0, 2, 300)
    row, column = rng.integers(0, 3, 300), rng.integers(0, 2, 300)
    found = WindowMaximum(table, nodes, np.pi).between(low, high, row, column)
    for k in range(300):
        angle = np.linspace(low[k], high[k], 400)
        spread = np.interp(angle, nodes, table[row[k], column[k]], period=np.pi)
        assert spread.max() <= found[k]
