"""The interpolant of an adaptive parameterisation: the file's own; its bounds, its draws."""

from __future__ import annotations

import csv
import pickle
from pathlib import Path

import numpy as np
import pytest

import fitter
from fitter.directions import vector_from_spherical
from fitter.errors import SpecError, TableError
from fitter.sampling import TableSampler
from fitter.sampling.warp import Warp
from fitter.table import Table
from tests.formats.samples import rgl_bytes
from tests.models import cells
from tests.models.statistics import chi_square_p
from tests.sampling.tables import adaptive as made

TABLES = [made(), made((-3.0, -1.0, 1.0, 3.0))]
DRAWS = 100_000
EDGES = cells.edges(12, 24)
FINE = 20


def expected_of(table: Table, wi: np.ndarray) -> np.ndarray:
    """(bins,) integral of f cos by the midpoint rule in the angles: f itself has no limit at the horizon."""
    theta, phi = (
        (np.arange(12 * FINE) + 0.5) / (12 * FINE) * np.pi / 2,
        (np.arange(24 * FINE) + 0.5) / (24 * FINE),
    )
    t, p = (x.reshape(-1) for x in np.meshgrid(theta, phi * 2 * np.pi, indexing="ij"))
    wo = vector_from_spherical(t, p)
    value = table.evaluate(wi, wo)[0].mean(axis=1) * np.cos(t) * np.sin(t)
    size = np.pi / 2 / (12 * FINE) * 2 * np.pi / (24 * FINE)
    return np.bincount(cells.bin_of(wo, *EDGES), value * size, 12 * 24)


@pytest.mark.long
@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize("degree", [0.0, 50.0])
def test_draws_follow_the_files_interpolant(table: Table, degree: float) -> None:
    wi = vector_from_spherical(np.deg2rad(degree), -0.4)
    sampler = TableSampler(table, cells=8000)
    drawn = sampler.sample(wi, DRAWS, 3)
    expected = expected_of(table, wi)
    seen = np.bincount(cells.bin_of(drawn.wo, *EDGES), minlength=len(expected))
    assert chi_square_p(seen, expected * (DRAWS / expected.sum())) > 1e-3
    info = sampler.info(wi)
    assert info.integral == pytest.approx(expected.sum(), rel=2e-3)
    assert (info.method, info.clamped_share) == ("rejection", 0.0)
    assert info.blind == pytest.approx(0.0, abs=5e-3)
    assert info.acceptance > 0.8
    few = drawn.wo[:500]
    np.testing.assert_allclose(sampler.pdf(wi, few), drawn.pdf[:500], rtol=1e-6)
    value, outside = table.evaluate(wi, few)
    assert not outside.any()
    weight = value * few[:, 2:] / drawn.pdf[:500, None]
    np.testing.assert_allclose(weight, drawn.weight[:500], rtol=1e-6)


@pytest.mark.parametrize("table", TABLES)
def test_bounds_hold(table: Table) -> None:
    for degree in (0.0, 33.0, 57.0):
        wi = vector_from_spherical(np.deg2rad(degree), 0.9)
        envelope = TableSampler(table, cells=3000).envelope(wi)
        field, bound = envelope.attack(np.random.default_rng(1), 100_000)
        assert not (field > bound).any()
        assert np.nanmedian(field / bound) > 0.5


def test_samples_are_on_the_interpolant_and_quantities_are_kept() -> None:
    table = made()
    # At the mirror direction all azimuths of the half vector are one direction, with several samples.
    tilted = np.linalg.norm((table.wi + table.wo)[:, :2], axis=1) > 1e-3
    use = np.flatnonzero(table.mask & (table.wo[:, 2] > 0.05) & tilted)[::3]
    value, outside = table.evaluate(table.wi[use], table.wo[use])
    assert not outside.any()
    np.testing.assert_allclose(value, table.value[use], rtol=1e-4)
    for quantity, factor in (("brdf", table.wo[use, 2:]), ("reflectance_factor", table.wo[use, 2:] / np.pi)):
        other = made(quantity=quantity)
        found, _ = other.evaluate(table.wi[use], table.wo[use])
        np.testing.assert_allclose(found, value * factor, rtol=1e-9)
        wi = vector_from_spherical(0.4, 0.0)
        sampler = TableSampler(other, cells=1000)
        drawn = sampler.sample(wi, 2000, 1)
        np.testing.assert_allclose(sampler.pdf(wi, drawn.wo), drawn.pdf, rtol=1e-6)


def test_outside_and_unmeasured() -> None:
    table = made()
    steep = vector_from_spherical(1.4, 0.0)
    value, outside = table.evaluate(steep, vector_from_spherical(0.3, [0.0, 1.0]))
    assert outside.all()
    assert (value > 0).all()
    with pytest.raises(TableError) as caught:
        TableSampler(table).sample(steep, 5, 0)
    assert caught.value.code == "incidence-not-measured"
    assert TableSampler(table).info(steep, allow_extrapolated=True).extrapolated
    with pytest.raises(SpecError) as refused:
        TableSampler(table, method="inversion").sample([0, 0, 1.0], 5, 0)
    assert refused.value.code == "no-inversion"
    with pytest.raises(SpecError) as refused:
        TableSampler(table, method="inversion").sample_pairs(5, 0)
    assert refused.value.code == "no-inversion"


def test_what_a_file_says_survives_pickling_but_not_a_selection() -> None:
    table = fitter.load(rgl_bytes())
    again = pickle.loads(pickle.dumps(table))
    wi, wo = vector_from_spherical(0.3, 0.0), vector_from_spherical(0.2, [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(again.evaluate(wi, wo)[0], table.evaluate(wi, wo)[0])
    assert Table(wi=table.wi, wo=table.wo, value=table.value).between is None


def test_a_blended_warp_is_the_blend() -> None:
    rng = np.random.default_rng(2)
    warp = Warp(rng.random((3, 6, 5)))
    x, y = rng.random((2, 50))
    node = np.zeros(50, np.intp)
    blend = [(node, np.full(50, 0.3)), (node + 2, np.full(50, 0.7))]
    alone = warp.blended([(0, 0.3), (2, 0.7)])
    np.testing.assert_allclose(
        alone.inverse([(node, np.ones(50))], x, y), warp.inverse(blend, x, y), rtol=1e-12
    )


@pytest.mark.measured
def test_the_independent_renderer(shared: Path) -> None:
    """Tables of the database are evaluated as a renderer does that reads them."""
    folder = shared / "measured/rgl"
    with (folder / "reference_evaluations.csv").open() as file:
        rows = [row for row in csv.reader(file) if row[0] == "irid_flake_paint1_rgb.bsdf"]
    numbers = np.array([[float(x) for x in row[1:]] for row in rows])
    theta_i, phi_i, theta_o, phi_o = np.deg2rad(numbers[:, :4]).T
    wo = vector_from_spherical(theta_o, phi_o)
    table = fitter.load(folder / "irid_flake_paint1_rgb.bsdf")
    value, _ = table.evaluate(vector_from_spherical(theta_i, phi_i), wo)
    assert len(numbers) == 300
    np.testing.assert_allclose(value * wo[:, 2:], numbers[:, 4:], rtol=1e-3, atol=1e-5)
