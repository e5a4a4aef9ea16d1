"""The sampler is exact: chi-square against the integrated interpolant, and what it refuses."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.spatial import Delaunay

import fitter
from fitter.directions import vector_from_spherical
from fitter.errors import FitError, SpecError, TableError
from fitter.sampling import TableSampler
from fitter.sampling.curvature import gain_of_triangles
from fitter.table import Table
from tests.sampling.tables import anisotropic, ggx, merl, scattered, spherical

DRAWS = 200_000
RINGS, SECTORS, FINE = 10, 24, 40
LEVEL = 0.01


def bins_of(wo: np.ndarray) -> np.ndarray:
    u = np.minimum(wo[:, 0] ** 2 + wo[:, 1] ** 2, 1 - 1e-12)
    turn = np.mod(np.arctan2(wo[:, 1], wo[:, 0]) / (2 * np.pi), 1.0)
    return (u * RINGS).astype(int) * SECTORS + np.minimum((turn * SECTORS).astype(int), SECTORS - 1)


def expected_of(table: Table, wi: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """(bins,) integral of f cos over each bin by the midpoint rule, with the public interpolant."""
    u = (np.arange(RINGS * FINE) + 0.5) / (RINGS * FINE)
    phi = (np.arange(SECTORS * FINE) + 0.5) / (SECTORS * FINE) * 2 * np.pi
    uu, pp = (x.reshape(-1) for x in np.meshgrid(u, phi, indexing="ij"))
    wo = np.stack([np.sqrt(uu) * np.cos(pp), np.sqrt(uu) * np.sin(pp), np.sqrt(1 - uu)], axis=1)
    value, extrapolated = table.evaluate(wi, wo)
    value = value.mean(axis=1) if weights is None else value @ weights
    mass = np.where(extrapolated, 0.0, np.maximum(value, 0.0)) * np.pi / len(u) / len(phi)
    return np.bincount(bins_of(wo), mass, RINGS * SECTORS)


def p_value(wo: np.ndarray, expected: np.ndarray) -> float:
    seen = np.bincount(bins_of(wo), minlength=len(expected)).astype(float)
    expected = expected / expected.sum() * len(wo)
    order = np.argsort(expected)
    small = np.cumsum(expected[order]) < 20  # the faintest bins together are one
    keep = order[~small]
    seen = np.append(seen[keep], seen[order[small]].sum())
    expected = np.append(expected[keep], expected[order[small]].sum())
    use = expected > 0
    assert seen[~use].sum() == 0
    statistic = ((seen[use] - expected[use]) ** 2 / expected[use]).sum()
    return float(stats.chi2.sf(statistic, use.sum() - 1))


MERL, GRID, SCANS, BRUSHED = merl(0.15), spherical(0.15), scattered(0.2), anisotropic()
CASES = [
    *((MERL, d, 0.3) for d in (0.0, 45.0, 75.0)),
    *((GRID, d, 0.3) for d in (0.0, 37.0, 75.0)),
    *((SCANS, d, 1.0) for d in (10.0, 42.0, 60.0, 75.0)),
    *((BRUSHED, d, 0.4) for d in (30.0, 60.0)),
]


@pytest.mark.parametrize(("table", "degree", "phi"), CASES)
def test_draws_follow_the_interpolant(table: Table, degree: float, phi: float) -> None:
    wi = vector_from_spherical(np.deg2rad(degree), phi)
    sampler = TableSampler(table)
    samples = sampler.sample(wi, DRAWS, 11)
    expected = expected_of(table, wi)
    assert p_value(samples.wo, expected) > 1 - (1 - LEVEL) ** (1 / len(CASES))
    info = sampler.info(wi)
    assert info.integral == pytest.approx(expected.sum(), rel=2e-3)
    spread = np.sqrt(info.acceptance * (1 - info.acceptance) / DRAWS)
    assert samples.acceptance == pytest.approx(info.acceptance, abs=5 * spread + 1e-3)
    assert samples.acceptance > 0.7
    np.testing.assert_allclose(np.linalg.norm(samples.wo, axis=1), 1, atol=1e-12)
    # pdf agrees with the sampler's own pdf, and weight with f cos / pdf of the public interpolant.
    few = samples.wo[:500]
    np.testing.assert_allclose(sampler.pdf(wi, few), samples.pdf[:500], rtol=1e-6)
    f, extrapolated = table.evaluate(wi, few)
    ok = ~extrapolated  # a draw may lie on the rim of the domain, to rounding
    assert ok.mean() > 0.99
    weight = f * few[:, 2:] / samples.pdf[:500, None]
    np.testing.assert_allclose(samples.weight[:500][ok], weight[ok], rtol=1e-6)


@pytest.mark.parametrize("table", [GRID, SCANS, MERL])
def test_pdf_integrates_to_one_and_weights_to_the_albedo(table: Table) -> None:
    wi = vector_from_spherical(np.deg2rad(42), 0.0)
    sampler = TableSampler(table)
    n = 400
    u, phi = (np.arange(n) + 0.5) / n, (np.arange(2 * n) + 0.5) / n * np.pi
    uu, pp = (x.reshape(-1) for x in np.meshgrid(u, phi, indexing="ij"))
    wo = np.stack([np.sqrt(uu) * np.cos(pp), np.sqrt(uu) * np.sin(pp), np.sqrt(1 - uu)], axis=1)
    density = sampler.pdf(wi, wo) / wo[:, 2]
    assert density.mean() * np.pi == pytest.approx(1, abs=1e-3)
    samples = sampler.sample(wi, 50_000, 3)
    value, extrapolated = table.evaluate(wi, wo)
    albedo = np.where(extrapolated[:, None], 0, value).mean(axis=0) * np.pi
    error = samples.weight.std(axis=0) / np.sqrt(len(samples)) + 1e-3 * albedo
    assert (np.abs(samples.weight.mean(axis=0) - albedo) < 4 * error).all()


def test_a_single_channel_has_constant_weight() -> None:
    samples = TableSampler(SCANS).sample(vector_from_spherical(np.deg2rad(30), 0.0), 1000, 3)
    assert np.ptp(samples.weight) == 0


def test_channel_weights() -> None:
    wi = vector_from_spherical(np.deg2rad(30), 0.0)
    samples = TableSampler(GRID, weights=[1, 0]).sample(wi, DRAWS, 5)
    assert p_value(samples.wo, expected_of(GRID, wi, np.array([1.0, 0.0]))) > LEVEL
    assert np.ptp(samples.weight[:, 0]) < 1e-9
    for bad in ([1.0], [0.0, 0.0], [-1.0, 2.0], [np.nan, 1.0]):
        with pytest.raises(SpecError, match="weights"):
            TableSampler(GRID, weights=bad)


def test_negative_values_count_as_zero_and_the_share_is_stated() -> None:
    base = spherical(0.3, 20, 19)
    value = base.value[:, 0] - 0.1
    table = Table(value=value, grid=base.grid, negatives="keep")
    info = TableSampler(table).info(vector_from_spherical(0.5, 0.0))
    assert info.clamped_share > 0.01
    clamped = Table(value=np.maximum(value, 0), grid=base.grid)
    same = TableSampler(clamped).info(vector_from_spherical(0.5, 0.0))
    assert info.integral == pytest.approx(same.integral, rel=1e-12)
    assert same.clamped_share == 0


def test_masked_regions_are_never_drawn() -> None:
    base = merl(0.4, shape=(20, 20, 24))
    rng = np.random.default_rng(0)
    table = Table(value=base.value, grid=base.grid, mask=rng.random(len(base)) > 0.01)
    wi = vector_from_spherical(0.6, 0.2)
    sampler = TableSampler(table)
    samples = sampler.sample(wi, 20_000, 0)
    assert not table.evaluate(wi, samples.wo)[1].any()
    assert 0.5 < sampler.info(wi).coverage < 0.99


def test_the_same_seed_gives_the_same_draws_and_streams_agree() -> None:
    wi = vector_from_spherical(0.5, 0.0)
    a = TableSampler(GRID).sample(wi, 3000, 7)
    b = TableSampler(GRID).sample(wi, 3000, np.int64(7))
    c = TableSampler(GRID).sample(wi, 3000, 8)
    assert np.array_equal(a.wo, b.wo)
    assert not np.array_equal(a.wo, c.wo)
    assert a.seed == 7
    parts = list(TableSampler(GRID).stream(wi, 700_000, 7))
    assert len(parts) > 2
    assert max(len(part) for part in parts) <= 1 << 18
    assert sum(len(part) for part in parts) == 700_000


def test_a_jax_key_is_a_seed() -> None:
    jax = pytest.importorskip("jax")
    wi = vector_from_spherical(0.5, 0.0)
    for key in (jax.random.key(3), jax.random.PRNGKey(3)):
        a, b = (TableSampler(GRID).sample(wi, 100, key) for _ in range(2))
        assert np.array_equal(a.wo, b.wo)
        assert a.seed is None
    c = TableSampler(GRID).sample(wi, 100, jax.random.key(4))
    assert not np.array_equal(a.wo, c.wo)


@pytest.mark.parametrize("n", [0, -1, 10**12, 2.5, True])
def test_counts_that_make_no_sense(n: Any) -> None:
    with pytest.raises(SpecError) as caught:
        TableSampler(GRID).sample(vector_from_spherical(0.5, 0.0), n, 0)
    assert caught.value.code == "bad-count"


@pytest.mark.parametrize("seed", [None, -1, 1.5, "x", True])
def test_seeds_that_make_no_sense(seed: Any) -> None:
    with pytest.raises(SpecError, match="seed"):
        TableSampler(GRID).sample(vector_from_spherical(0.5, 0.0), 10, seed)


def test_incidences_that_were_not_measured() -> None:
    steep = vector_from_spherical(np.deg2rad(85), 0.3)
    for table in (GRID, SCANS):
        sampler = TableSampler(table)
        with pytest.raises(TableError, match="outside the measured") as caught:
            sampler.sample(steep, 10, 0)
        assert caught.value.code == "incidence-not-measured"
        samples = sampler.sample(steep, 5000, 0, allow_extrapolated=True)
        assert sampler.info(steep, allow_extrapolated=True).extrapolated
        assert (samples.wo[:, 2] > 0).all()
    for wi in ([0, 0, -1.0], [0, 0, 2.0], [np.nan, 0, 1], [[0, 0, -1.0]], [[[0, 0, 1.0]]]):
        with pytest.raises(SpecError, match="wi must"):
            TableSampler(GRID).sample(wi, 10, 0)


def test_tables_that_cannot_be_drawn_from() -> None:
    theta = np.deg2rad(np.arange(5, 71, 5.0))
    wi = np.broadcast_to(vector_from_spherical(0.3, 0.0), (len(theta), 3))
    plane = Table(wi=wi, wo=vector_from_spherical(theta, np.pi), value=np.ones(len(theta)))
    with pytest.raises(TableError) as caught:
        TableSampler(plane)
    assert caught.value.code == "in-plane-only"
    few = Table(wi=wi[:2], wo=vector_from_spherical([0.3, 0.5], [1.0, 2.0]), value=np.ones(2))
    for table, code in (
        (few, "table-few-directions"),
        (Table(value=np.zeros(len(GRID)), grid=GRID.grid), "slice-empty"),
        (Table(value=np.zeros(len(MERL)), grid=MERL.grid), "slice-empty"),
        (Table(wi=SCANS.wi, wo=SCANS.wo, value=np.zeros(len(SCANS))), "slice-empty"),
    ):
        with pytest.raises(TableError) as caught:
            TableSampler(table).sample(vector_from_spherical(0.3, 0.0), 10, 0, allow_extrapolated=True)
        assert caught.value.code == code


def test_the_evaluation_budget() -> None:
    with pytest.raises(FitError, match="acceptance") as caught:
        TableSampler(GRID).sample(vector_from_spherical(0.5, 0.0), 1000, 0, max_evaluations=500)
    assert caught.value.code == "evaluation-budget"


@pytest.mark.parametrize(("alpha", "degree"), [(0.1, 45), (0.02, 45), (0.02, 75)])
def test_energy_error_of_the_interpolant_is_stated(
    alpha: float, degree: float, capsys: pytest.CaptureFixture[str]
) -> None:
    """Interpolation itself creates energy: the sampler is exact for the interpolant, not for the lobe."""
    wi = vector_from_spherical(np.deg2rad(degree), 0.0)
    info = TableSampler(spherical(alpha, 90, 91), weights=[1, 0]).info(wi)
    h = np.random.default_rng(0).random((2, 400_000))
    theta_h, phi = np.arctan(alpha * np.sqrt(h[0] / (1 - h[0]))), 2 * np.pi * h[1]
    n = vector_from_spherical(theta_h, phi)
    along = n @ wi
    wo = 2 * along[:, None] * n - wi
    c2 = n[:, 2] ** 2
    pdf = n[:, 2] / (np.pi * alpha**2 * (c2 + (1 - c2) / alpha**2) ** 2) / (4 * np.abs(along))
    up = (wo[:, 2] > 0) & (along > 0)
    true = float(np.where(up, ggx(np.broadcast_to(wi, wo.shape), wo, alpha) * wo[:, 2] / pdf, 0).mean())
    true += 0.02 * np.pi
    with capsys.disabled():
        print(f"\nalpha {alpha}, {degree} degrees: albedo {info.integral:.4f}, of the lobe itself {true:.4f}")
    assert info.acceptance > 0.89
    assert info.integral >= 0.97 * true


@pytest.mark.parametrize("degree", [5, 60])
def test_energy_error_of_grids_in_half_and_difference_angles(degree: float) -> None:
    """Against the lobe itself, over the disk."""
    wi = vector_from_spherical(np.deg2rad(degree), 0.0)
    table = merl(0.3, shape=(14, 12, 16))
    u, turn = np.random.default_rng(0).random((2, 200_000))
    wo = vector_from_spherical(np.arcsin(np.sqrt(u)), 2 * np.pi * turn)
    value, outside = table.evaluate(wi, wo)
    gained = value[:, 0] - ggx(np.broadcast_to(wi, wo.shape), wo, 0.3) - 0.05
    info = TableSampler(table).info(wi)
    assert info.energy_error == pytest.approx(
        gained[~outside].sum() * np.pi / len(u) / info.integral, rel=0.1
    )


@pytest.mark.parametrize("seed", range(3))
def test_energy_error_of_triangles(seed: int) -> None:
    """Of two sines that vanish at the rim."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(*2 * (np.linspace(0, 1, 16),)), axis=-1).reshape(-1, 2)
    inside = ((grid > 0) & (grid < 1)).all(axis=1)
    points = grid + inside[:, None] * rng.uniform(-0.02, 0.02, grid.shape)
    triangles, value = Delaunay(points).simplices, np.sin(np.pi * points).prod(axis=1)
    p = points[triangles]
    e, g = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    areas = 0.5 * np.abs(e[:, 0] * g[:, 1] - e[:, 1] * g[:, 0])
    true = float((areas * value[triangles].mean(axis=1)).sum()) - 4 / np.pi**2
    assert gain_of_triangles(points, value, triangles) == pytest.approx(true, rel=0.25)


def test_the_samplers_import_no_jax() -> None:
    code = "import fitter.sampling, sys; sys.exit('jax' in sys.modules)"
    root = Path(fitter.__file__).resolve().parent.parent
    assert subprocess.run([sys.executable, "-c", code], cwd=root, check=False).returncode == 0


@pytest.mark.long
@pytest.mark.measured
def test_measured_tables(shared: Path) -> None:
    tables = [
        (fitter.load(shared / "measured/cornell/garnet_red_RGB.astm"), (10, 25, 45, 60, 75)),
        (fitter.load(shared / "measured/retro/retro-3M-jaune.dat", quantity="brdf"), (15, 22, 30, 40, 60)),
    ]
    for table, degrees in tables:
        for degree in degrees:
            wi = vector_from_spherical(np.deg2rad(degree), 0.7)
            samples = TableSampler(table).sample(wi, DRAWS, 2)
            p = p_value(samples.wo, expected_of(table, wi))
            assert p > 1 - (1 - LEVEL) ** 0.1, (table.metadata.name, degree, p)
