"""The range of directions of a table, and its median, against what every single sample says."""

from __future__ import annotations

import numpy as np
import pytest

from fitter import Table, directions
from fitter.domain import FLAT, PER_RADIAN
from fitter.formats.describe import describe
from fitter.grid import Grid


def _table(theta_h, theta_d, phi_d, seed: int, share: float = 0.7) -> Table:
    rng = np.random.default_rng(seed)
    axes = {"theta_h": np.asarray(theta_h), "theta_d": np.asarray(theta_d), "phi_d": np.asarray(phi_d)}
    grid = Grid("half_difference", axes)
    value = np.where(rng.random(grid.size) < share, rng.lognormal(size=grid.size), -1.0)
    value[grid.size // 2] = 1.0
    return Table(value=value, grid=grid, symmetry="isotropic")


@pytest.mark.parametrize("share", [1.0, 0.4, 0.02])
@pytest.mark.parametrize(
    "axes",
    [
        (np.linspace(0, 1.4, 12), np.linspace(0, 1.5, 9), np.linspace(0, np.pi, 8)[:-1]),
        (np.linspace(0.01, 1.2, 7), np.linspace(0.02, 1.4, 5), np.linspace(0.1, 3.0, 11)),
        # In one plane, and angles that their cosines can't tell from 0.
        ((0.0, 0.3, 0.9), np.linspace(0, 1.5, 9), (0.0, np.pi)),
        ((1e-9, 2e-9), (3e-9, 0.5), (0.0, 1.0, 2.0)),
    ],
)
def test_half_difference_grids_cover_what_their_samples_do(axes, share):
    table = _table(*axes, seed=5, share=share)
    wi, wo = (w[table.mask] for w in (table.wi, table.wo))
    theta_i, theta_o = (directions.spherical_from_vector(w)[0] for w in (wi, wo))
    found = table.domain
    # Within 2e-8 of the normal all cosines are 1.
    np.testing.assert_allclose(found.theta_i, (theta_i.min(), theta_i.max()), rtol=1e-12, atol=2e-8)
    np.testing.assert_allclose(found.theta_o, (theta_o.min(), theta_o.max()), rtol=1e-12, atol=2e-8)
    assert found.incidences == len(np.unique(np.rint(theta_i * PER_RADIAN)))
    assert found.in_plane == (np.abs(np.cross(wi, wo)[:, 2]).max() < FLAT)


@pytest.mark.parametrize(
    "make",
    [
        lambda rng, n: rng.lognormal(size=n),
        lambda rng, n: np.round(rng.gamma(2.0, size=n)),
        lambda rng, n: np.sort(rng.normal(10.0, size=n)),
        # What a sample at even distances gets wrong.
        lambda rng, n: np.where(np.arange(n) % 41 == 0, 5.0, rng.random(n)),
        lambda rng, n: np.r_[np.zeros(n // 2), np.ones(n - n // 2)],
    ],
)
@pytest.mark.parametrize("n", [60_000, 170_000, 170_001])
def test_median_of_many_values(make, n):
    value = make(np.random.default_rng(2), n)
    wi, wo = np.tile([0.0, 0.0, 1.0], (n, 1)), np.tile([0.6, 0.0, 0.8], (n, 1))
    table = Table(wi=wi, wo=wo, value=value, negatives="keep", duplicates="keep")
    assert describe(table)["channels"][0]["median_per_sr"] == np.median(value)
