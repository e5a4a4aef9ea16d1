"""Incidences and scattered directions drawn together; several incidences; moments."""

from __future__ import annotations

import numpy as np
import pytest

from fitter.directions import vector_from_spherical
from fitter.errors import FitError, SpecError, TableError
from fitter.sampling import Samples, TableSampler, moment
from fitter.table import Table
from tests.models.statistics import chi_square_p
from tests.sampling.tables import adaptive, anisotropic, merl, scattered, spherical

DRAWS = 20_000
TABLES = [spherical(0.3, 20, 19), anisotropic(), scattered(0.3, count=300), merl(0.3, shape=(20, 18, 24))]
ADAPTIVE = [adaptive(), adaptive((-np.pi, -1.5, 0.0))]
BINS = 5
LEVEL = 1e-3


def bins_of(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """Of pairs, by projected radius of both and by the azimuth between them."""
    turn = np.arctan2(wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0], (wi[:, :2] * wo[:, :2]).sum(axis=1))
    shares = [1 - wi[:, 2] ** 2, 1 - wo[:, 2] ** 2, (turn / np.pi + 1) / 2]
    index = [np.minimum((x * BINS).astype(int), BINS - 1) for x in shares]
    return (index[0] * BINS + index[1]) * BINS + index[2]


@pytest.mark.long
@pytest.mark.parametrize("table", TABLES + ADAPTIVE)
def test_pairs_follow_the_interpolant(table: Table) -> None:
    sampler = TableSampler(table, cells=40_000 if table.between is None else 1000)
    drawn = sampler.sample_pairs(DRAWS, 3)
    assert drawn.wi is not None
    info = sampler.info_pairs()
    # Expected counts from cosine-distributed pairs, weighted; many more of them than draws.
    rng = np.random.default_rng(4)
    n = 400_000
    u, phi = rng.random((2, n)), rng.uniform(-np.pi, np.pi, (2, n))
    w = [
        np.stack([np.sqrt(a) * np.cos(b), np.sqrt(a) * np.sin(b), np.sqrt(1 - a)], axis=1)
        for a, b in zip(u, phi, strict=True)
    ]
    value, extrapolated = table.evaluate(*w)
    mass = np.where(extrapolated, 0.0, value.mean(axis=1)) * np.pi**2
    expected = np.bincount(bins_of(*w), mass, BINS**3)
    error = np.bincount(bins_of(*w), mass**2, BINS**3)
    seen = np.bincount(bins_of(drawn.wi, drawn.wo), minlength=BINS**3)
    # Bins whose expectation is itself uncertain by more than a fifth of the draws' own spread are pooled.
    share = expected / expected.sum() * DRAWS
    sure = error * (DRAWS / expected.sum()) ** 2 < 0.04 * share
    rest = np.append(seen[sure], seen[~sure].sum()), np.append(share[sure], share[~sure].sum())
    assert sure.sum() > (20 if table.between is None else 8)
    assert chi_square_p(*rest) > LEVEL
    z = (info.integral - expected.sum() / n) / np.hypot(
        mass.std() / np.sqrt(n), info.integral * info.integral_error
    )
    assert abs(z) < 4
    assert info.acceptance > (0.7 if table.between is None else 0.4)
    assert drawn.acceptance == pytest.approx(info.acceptance, abs=0.02)
    # The density is f cos cos over the integral, the weight f cos cos over that.
    few = slice(0, 300)
    f, _ = table.evaluate(drawn.wi[few], drawn.wo[few])
    steep = drawn.wi[few, 2] * drawn.wo[few, 2]
    np.testing.assert_allclose(drawn.pdf[few], f.mean(axis=1) * steep / info.integral, rtol=1e-6)
    np.testing.assert_allclose(drawn.weight[few], f * (steep / drawn.pdf[few])[:, None], rtol=1e-6)


def test_pairs_are_the_same_for_the_same_seed_and_end_with_the_budget() -> None:
    sampler = TableSampler(TABLES[0])
    a, b = (sampler.sample_pairs(500, 3) for _ in range(2))
    assert a.wi is not None
    assert b.wi is not None
    np.testing.assert_array_equal(np.c_[a.wi, a.wo], np.c_[b.wi, b.wo])
    with pytest.raises(FitError, match="acceptance"):
        sampler.sample_pairs(5000, 0, max_evaluations=1000)


def test_pairs_need_several_incidences_and_something_positive() -> None:
    one = scattered(0.3, degrees=(30,), count=200)
    with pytest.raises(TableError) as caught:
        TableSampler(one).sample_pairs(10, 0)
    assert caught.value.code == "too-few-incidences"
    for table in TABLES:
        dark = {"grid": table.grid} if table.grid is not None else {"wi": table.wi, "wo": table.wo}
        with pytest.raises(TableError) as caught:
            TableSampler(Table(value=np.zeros(len(table)), **dark)).sample_pairs(10, 0)
        assert caught.value.code in ("slice-empty", "too-few-incidences")


def test_negative_values_and_holes_of_pairs() -> None:
    base = spherical(0.3, 20, 19)
    rng = np.random.default_rng(0)
    table = Table(
        value=base.value - 0.15, grid=base.grid, mask=rng.random(len(base)) > 0.002, negatives="keep"
    )
    drawn = TableSampler(table).sample_pairs(5000, 0)
    assert drawn.wi is not None
    assert not table.evaluate(drawn.wi, drawn.wo)[1].any()


def test_several_incidences_at_once() -> None:
    table = TABLES[0]
    wi = vector_from_spherical(np.deg2rad([10.0, 40.0]), 0.3)
    drawn = TableSampler(table).sample(wi, 700, 5)
    assert drawn.wi is not None
    assert len(drawn) == 1400
    np.testing.assert_array_equal(drawn.wi, np.repeat(wi, 700, axis=0))
    for k, one in enumerate(wi):
        part = slice(k * 700, (k + 1) * 700)
        np.testing.assert_allclose(TableSampler(table).pdf(one, drawn.wo[part]), drawn.pdf[part], rtol=1e-6)
    assert not np.array_equal(drawn.wo[:700, 2], drawn.wo[700:, 2])


@pytest.mark.parametrize("method", ["rejection", "inversion"])
def test_a_moment_is_within_its_standard_error(method: str) -> None:
    table = TABLES[0]
    wi = vector_from_spherical(0.6, 0.2)
    sampler = TableSampler(table, method=method)  # pyright: ignore[reportArgumentType]
    n = 500
    u, phi = (np.arange(n) + 0.5) / n, (np.arange(2 * n) + 0.5) / n * np.pi
    uu, pp = (x.reshape(-1) for x in np.meshgrid(u, phi, indexing="ij"))
    wo = np.stack([np.sqrt(uu) * np.cos(pp), np.sqrt(uu) * np.sin(pp), np.sqrt(1 - uu)], axis=1)
    f, _ = table.evaluate(wi, wo)

    def g(w: np.ndarray) -> np.ndarray:
        return np.stack([w[:, 2], w[:, 0] ** 2], axis=1)

    exact = np.pi * (f[:, :, None] * g(wo)[:, None, :]).mean(axis=0)
    found = moment(sampler.stream(wi, 300_000, 1), g)
    assert found.value.shape == found.standard_error.shape == (2, 2)
    assert found.draws == 300_000
    assert (np.abs(found.value - exact) < 4 * found.standard_error + 2e-4 * exact).all()
    whole = moment(sampler.sample(wi, 300_000, 1), g)
    np.testing.assert_allclose(whole.value, found.value, rtol=1e-12)
    np.testing.assert_allclose(whole.standard_error, found.standard_error, rtol=1e-9)
    albedo = moment(sampler.sample(wi, 20_000, 1))
    assert (np.abs(albedo.value - np.pi * f.mean(axis=0)) < 4 * albedo.standard_error + 2e-4).all()


def test_the_spread_of_moments_is_their_standard_error() -> None:
    sampler = TableSampler(TABLES[0])
    wi = vector_from_spherical(0.6, 0.2)
    found = [moment(sampler.sample(wi, 400, seed), lambda w: w[:, 2]) for seed in range(300)]
    spread = np.std([one.value for one in found], axis=0)
    stated = np.mean([one.standard_error for one in found], axis=0)
    np.testing.assert_allclose(spread / stated, 1.0, atol=0.15)


def test_moments_that_make_no_sense() -> None:
    drawn = TableSampler(TABLES[0]).sample(vector_from_spherical(0.6, 0.2), 10, 0)
    with pytest.raises(SpecError) as caught:
        moment(drawn, lambda w: w[:3, 0])
    assert caught.value.code == "bad-function"
    none: list[Samples] = []
    with pytest.raises(SpecError) as caught:
        moment(none)
    assert caught.value.code == "no-draws"
    assert np.isinf(moment(TableSampler(TABLES[0]).sample([0, 0, 1.0], 1, 0)).standard_error).all()
