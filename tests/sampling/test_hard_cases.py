"""The sampler's rows of docs/hard-cases.md: what the naive form does, and what ours does."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from fitter.directions import vector_from_spherical
from fitter.errors import FitError, SpecError, TableError
from fitter.sampling import Samples, TableSampler, moment
from fitter.sampling.alias import AliasTable
from fitter.sampling.energy import GridEnergy
from fitter.sampling.grid import GridInterpolant
from fitter.sampling.interpolant import interpolant
from fitter.sampling.mesh import Mesh, overlay
from fitter.table import Table
from tests.sampling.tables import anisotropic, merl, scattered, spherical

GRID = spherical(0.3, 20, 19)
WI = vector_from_spherical(0.6, 0.2)


def test_d01_a_masked_cap_is_never_drawn() -> None:
    """Naive: masked nodes count as 0, and the lobe is drawn dimmer up to the hole's edge and in it."""
    _, wo = GRID.grid.directions() if GRID.grid is not None else (GRID.wi, GRID.wo)
    mirror = vector_from_spherical(0.6, np.pi)
    table = Table(value=GRID.value, grid=GRID.grid, mask=wo @ mirror < np.cos(0.3))
    zeroed = Table(value=np.where(table.mask[:, None], GRID.value, 0.0), grid=GRID.grid)
    drawn = TableSampler(table).sample(WI, 20_000, 1)
    naive = TableSampler(zeroed).sample(WI, 20_000, 1)
    assert not table.evaluate(WI, drawn.wo)[1].any()
    assert table.evaluate(WI, naive.wo)[1].any()
    assert 0.02 < TableSampler(table).info(WI).blind < 0.2


def test_d02_a_slice_of_zeros() -> None:
    """Naive: the sum of the probabilities is 0, and the first item is drawn for ever."""
    with np.errstate(invalid="ignore"):
        assert np.isnan(np.zeros(3) / np.zeros(3).sum()).all()
    with pytest.raises(TableError) as caught:
        TableSampler(Table(value=np.zeros(len(GRID)), grid=GRID.grid)).sample(WI, 1, 0)
    assert caught.value.code == "slice-empty"


def test_d03_negative_lobes() -> None:
    """Naive: a cumulated distribution that falls, so that searching it finds anything."""
    table = Table(value=GRID.value - 0.3, grid=GRID.grid, negatives="keep")
    assert (np.diff(np.cumsum(table.value[:, 0])) < 0).any()
    info = TableSampler(table).info(WI)
    assert info.clamped_share > 0.05
    assert (TableSampler(table).sample(WI, 2000, 0).pdf > 0).all()


def test_d04_an_incidence_that_was_not_measured() -> None:
    """Naive: the nearest incidence's draws, silently."""
    steep = vector_from_spherical(np.deg2rad(88), 0.0)
    with pytest.raises(TableError) as caught:
        TableSampler(GRID).sample(steep, 5, 0)
    assert caught.value.code == "incidence-not-measured"
    assert TableSampler(GRID).info(steep, allow_extrapolated=True).extrapolated


def test_d05_no_draws_and_a_million_million() -> None:
    """Naive: an empty answer, whose mean is NaN; memory that nobody has. A stream has no end to fear."""
    for n in (0, 10**12):
        with pytest.raises(SpecError) as caught:
            TableSampler(GRID).sample(WI, n, 0)
        assert caught.value.code == "bad-count"
    sampler = TableSampler(GRID)
    sampler.info(WI)
    tracemalloc.start()
    first = next(sampler.stream(WI, 10**12, 0))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(first) == 1 << 18
    assert most < 60e6


def test_d06_an_acceptance_without_hope() -> None:
    """Naive: a loop that does not end. A mirror's peak of 1e9 over 1e-9 that a few large cells bound."""
    base = merl(0.2, shape=(60, 20, 24))
    assert base.grid is not None
    near = base.grid.coordinates()[0] < 0.002
    table = Table(value=np.where(near, 1e9, 1e-9), grid=base.grid)
    poor = TableSampler(table, cells=1)
    assert poor.info(WI).acceptance < 0.01
    with pytest.raises(FitError) as caught:
        poor.sample(WI, 1000, 0, max_evaluations=20_000)
    assert caught.value.code == "evaluation-budget"
    assert "acceptance" in caught.value.message
    # Finer cells are what the remedy says.
    assert TableSampler(table).sample(WI, 1000, 0, max_evaluations=20_000).acceptance > 0.5


def test_d07_a_narrow_lobe_gains_energy() -> None:
    """alpha = 0.02 at 75 degrees on 90 x 91 nodes: straight lines between them. Albedo of the lobe: 1.059."""
    both = spherical(0.02, 90, 91)
    table = Table(value=both.value[:, 0], grid=both.grid)
    part = interpolant(table)
    wi = vector_from_spherical(np.deg2rad(75), 0.0)
    ours = TableSampler(table).info(wi)
    vars(part)["_energies"] = {k: GridEnergy(0.0, 1.0, 0.0) for k in range(len(table))}
    naive = TableSampler(table).info(wi)
    assert naive.integral == pytest.approx(1.79, abs=0.01)
    assert ours.integral == pytest.approx(1.19, abs=0.02)
    assert ours.energy_error == pytest.approx(0.50, abs=0.02)
    assert ours.acceptance > 0.7


def test_d08_smooth_tables_stay_bilinear() -> None:
    """Naive: a root for all tables, which takes energy from lobes that straight lines integrate to 1e-3."""
    for table in (spherical(0.2, 40, 41), anisotropic(), Table(value=np.ones(len(GRID)), grid=GRID.grid)):
        assert table.grid is not None
        part = interpolant(table)
        assert isinstance(part, GridInterpolant)
        assert all(part.energy(k).root == 1 for k in range(int(np.prod(table.grid.shape[:-2]))))


def test_d09_probabilities_over_thirty_decades() -> None:
    """Naive: cumulated from large to small, the small ones are lost, and what is impossible is chosen."""
    weights = np.array([1.0, 1e-30, 0.0, 1e-30])
    cumulated = np.cumsum(weights) / weights.sum()
    assert np.searchsorted(cumulated, cumulated[-1], side="right") == 4  # past the last item
    chosen = AliasTable(weights).choose(np.linspace(0, 1 - 1e-16, 100_000))
    assert set(np.unique(chosen)) <= {0, 1, 3}


def test_d10_the_lobe_at_the_horizon() -> None:
    """Naive: cos(theta_o) of an angle next to pi/2 comes out negative: below the surface."""
    assert np.cos(np.nextafter(np.pi / 2, 2.0)) < 0
    assert GRID.grid is not None
    last = GRID.grid.coordinates()[1] > GRID.grid.axes["theta_o"][-5]
    table = Table(value=np.where(last, 1e6, 0.0), grid=GRID.grid)
    for method in ("rejection", "inversion"):
        drawn = TableSampler(table, method=method).sample(WI, 200_000, 0)
        assert drawn.wo[:, 2].min() >= 0
        assert drawn.wo[:, 2].min() < 2e-3
        assert np.isfinite(drawn.pdf).all()


def test_d11_triangles_that_share_sides() -> None:
    """Naive: pieces of two meshes along a common side, of no area but with corners, counted twice."""
    square = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], float)
    mesh = Mesh(square, np.ones((2, 3, 1)))
    both = overlay(mesh, mesh)
    assert both.areas.sum() == pytest.approx(1.0, abs=1e-12)
    assert float(both.integrals().sum()) == pytest.approx(2.0, abs=1e-12)


def test_d12_the_spread_of_a_moment_of_large_numbers() -> None:
    """Naive: mean of squares less square of the mean: all digits cancel."""
    n = 1000
    weight = 1e8 + np.tile([1.0, -1.0], n // 2)[:, None]
    flat = np.zeros(n)
    drawn = Samples(
        wo=np.tile([0, 0, 1.0], (n, 1)), pdf=flat, weight=weight, valid=flat == 0, is_delta=flat > 0,
        acceptance=1.0, seed=0,
    )  # fmt: skip
    naive = np.mean(weight**2) - np.mean(weight) ** 2
    assert abs(naive - 1.0) > 0.5
    assert moment(drawn).standard_error[0] == pytest.approx(1 / np.sqrt(n - 1), rel=1e-9)
    assert moment([drawn, drawn]).standard_error[0] == pytest.approx(1 / np.sqrt(2 * n - 1), rel=1e-9)


def test_d13_a_lobe_between_two_light_directions() -> None:
    """Naive: the two measured lobes blended where they stand are two lobes. See test_interpolant.py."""
    table = scattered(0.08, count=1500)
    theta = np.deg2rad(40.0)
    drawn = TableSampler(table).sample(vector_from_spherical(theta, 0.0), 50_000, 1)
    near = np.hypot(drawn.wo[:, 0] + np.sin(theta), drawn.wo[:, 1]) < 0.08
    apart = [np.hypot(drawn.wo[:, 0] + np.sin(np.deg2rad(d)), drawn.wo[:, 1]) < 0.08 for d in (30.0, 50.0)]
    assert near.mean() > 2 * max(side.mean() for side in apart)
