"""The majorants are theorems: attacked with rough tables, odd cells and points on their edges."""

from __future__ import annotations

import numpy as np
import pytest

from fitter.directions import vector_from_spherical
from fitter.sampling.grid import GridInterpolant, HalfDifferenceSlice, SphericalSlice
from fitter.sampling.half_difference import HalfDifferenceField
from fitter.sampling.interpolant import interpolant
from fitter.sampling.majorants import SphericalField
from fitter.sampling.maxima import BoxMaximum, WindowMaximum
from fitter.table import Table
from tests.sampling.tables import anisotropic, merl, spherical


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
    assert isinstance(part, HalfDifferenceSlice)
    field = HalfDifferenceField(part, np.ones(1))
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
    density = field.density(theta.reshape(-1), phi.reshape(-1)).reshape(theta.shape)
    assert not (density > bound[:, None]).any()
    if holes == 0 and degree >= 30:
        # And they are worth having: tight for small cells (near the normal phi_d is free, so not there).
        small = (size.max(axis=0) < 1e-4) & np.isfinite(density).all(axis=1) & (density > 0).all(axis=1)
        assert np.median(density.max(axis=1)[small] / bound[small]) > 0.5


@pytest.mark.parametrize("table", [spherical(0.2, 15, 16), anisotropic()])
def test_spherical_bounds_hold_on_cells_between_nodes(table: Table) -> None:
    grid = interpolant(rough(table, 0.02))
    assert isinstance(grid, GridInterpolant)
    part = grid.slice(vector_from_spherical(0.6, 0.2))
    assert isinstance(part, SphericalSlice)
    channels = part.raw.shape[1]
    field = SphericalField(part, np.full(channels, 1 / channels))
    theta, phi = field.edges()
    rng = np.random.default_rng(1)
    i, j = rng.integers(0, len(theta) - 1, 3000), rng.integers(0, len(phi) - 1, 3000)
    ends = np.sort(rng.random((2, 2, 3000)), axis=1)
    cells = np.stack(
        [theta[i] + ends[0, k] * (theta[i + 1] - theta[i]) for k in (0, 1)]
        + [phi[j] + ends[1, k] * (phi[j + 1] - phi[j]) for k in (0, 1)],
        axis=1,
    )
    bound = field.bound(cells)
    t, p = points_in(cells, 40, rng)
    density = field.density(t.reshape(-1), p.reshape(-1)).reshape(t.shape)
    # A cell with a masked corner is not measured: neither bound nor density say anything there.
    assert not (density > bound[:, None]).any()


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
    found = WindowMaximum(table, nodes, np.pi).between(low, high)(row, column)
    for k in range(300):
        angle = np.linspace(low[k], high[k], 400)
        spread = np.interp(angle, nodes, table[row[k], column[k]], period=np.pi)
        assert spread.max() <= found[k]
