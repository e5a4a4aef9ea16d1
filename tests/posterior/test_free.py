"""Free coordinates and blobs: exact changes of variables, moves that keep their target, hard posteriors."""

from __future__ import annotations

import emcee
import numpy as np
import pytest
from scipy import special

import fitter
from fitter import models
from fitter.fitting.layout import layout
from fitter.posterior.blobs import blobs
from fitter.posterior.density import Data, Density
from fitter.posterior.free import Free
from fitter.posterior.moves import BlobsMove, free_mixture
from fitter.spec import FitSpec, ModelSpec
from tests.fitting.conftest import scattered


def _free(spec: str, values: dict, y: np.ndarray) -> Free:
    """Of a table of one channel, with an inferred noise."""
    table = scattered(models.create(spec, **values), seed=1, n=200, sigma=True, azimuths=True)
    places = layout(FitSpec(model=ModelSpec.parse(spec)))
    count = len(places.linear)
    low, high = places.box
    lower, upper = np.r_[np.zeros(count), low, 0.0, 0.0], np.r_[np.full(count, 9.0), high, 3.0, np.inf]
    data = Data(np.concatenate([table.wi.T, table.wo.T]), table.value.T, None)
    return Free(Density(places, data, lower, upper, y), 1.0 / np.square(table.sigma.T))


@pytest.mark.parametrize(
    ("spec", "values", "y", "linear"),
    [
        (
            "lafortune:anisotropic", {"kd": 0.2, "ks": 0.1, "gamma": 0.7, "delta": 0.3, "n": 8.0, "psi": 0.2},
            [0.2, 0.1, 0.7, 0.3, np.log(8.0), 0.2, 0.02, 0.001], 2,
        ),
        # Its coefficients are products: nothing is counted from its best value.
        ("oren_nayar:full", {"rho": 0.5, "sigma": 0.4}, [0.5, 0.4, 0.02, 0.001], 0),
        # Next to nothing at most samples.
        ("ward:no_diffuse", {"ks": 0.3, "alpha": 0.3}, [0.3, np.log(0.02), 0.053, 0.001], 1),
    ],
)  # fmt: skip
def test_there_and_back_with_the_volume_of_the_change(spec, values, y, linear):
    y = np.array(y)
    free = _free(spec, values, y)
    assert free.linear == linear
    v, volume = free.into(y[None])
    back, same = free.back(v)
    np.testing.assert_allclose(back[0], y, rtol=1e-9)
    np.testing.assert_allclose(same, volume, rtol=1e-9)
    step = 1e-5 * np.eye(len(y))
    slopes = (free.back(v + step)[0] - free.back(v - step)[0]) / 2e-5
    assert np.linalg.slogdet(slopes)[1] == pytest.approx(float(volume[0]), abs=1e-5)


def test_anything_is_within_the_bounds():
    y = np.array([0.2, 0.1, 0.7, 0.3, np.log(8.0), 0.2, 0.02, 0.001])
    free = _free("lafortune:anisotropic", {"kd": 0.2, "ks": 0.1, "gamma": 0.7, "delta": 0.3, "n": 8.0}, y)
    found = free.back(2.0 * np.random.default_rng(0).standard_normal((500, len(y))))[0]
    found[:, [0, 1, 6]] = 1.0  # these have bounds in y alone
    assert free.density.within(found).all()


def test_blobs_are_where_the_points_are():
    rng = np.random.default_rng(2)
    x = np.concatenate([rng.normal(-20, 1, (3000, 2)), rng.normal(20, [1, 3], (1000, 2))])
    found = blobs(x, np.arange(len(x)) % 2 == 0, rng)
    left = found.mean[:, 0] < 0
    assert found.weight[left].sum() == pytest.approx(0.75, abs=0.01)
    np.testing.assert_allclose(found.weight[left] @ found.mean[left] / 0.75, -20, atol=0.2)
    assert len(blobs(x[:3000], np.arange(3000) % 2 == 0, rng).weight) == 1  # a normal is one blob


class Between:
    """y = ndtr(v), between 0 and 1."""

    def into(self, y):
        v = special.ndtri(y)
        return v, self._volume(v)

    def back(self, v):
        return special.ndtr(v), self._volume(v)

    def _volume(self, v):
        return -0.5 * np.square(v).sum(axis=1)


@pytest.mark.parametrize("alone", [True, False])
def test_moves_keep_two_islands_in_coordinates(alone):
    """One of three quarters, one against a bound, with blobs that are wrong about both."""
    middle, sd = np.array([[0.3, 0.4], [1.0, 0.9]]), np.array([[0.03, 0.05], [0.05, 0.02]])
    share = [0.75, 0.25]
    rng = np.random.default_rng(3)
    which = rng.random(200_000) < share[0]
    plain = np.where(which[:, None], rng.normal(middle[0], sd[0], (200_000, 2)),
                     middle[1] - np.abs(rng.normal(0, sd[1], (200_000, 2))))  # fmt: skip

    def log_density(y):
        z = np.square((y[:, None] - middle) / sd).sum(axis=2)
        one = np.log(share) - np.log(sd).sum(axis=1) - 0.5 * z + np.log([1.0, 4.0])
        one[:, 1] = np.where((y < middle[1]).all(axis=1), one[:, 1], -np.inf)
        inside = ((y > 0) & (y < 1)).all(axis=1)
        return np.where(inside, np.logaddexp.reduce(one, axis=1), -np.inf)

    wrong = np.concatenate([plain[which][:500], plain[~which][:500]])
    near = wrong + rng.normal(0, 0.01, wrong.shape).clip(-1, 1e-9)
    found = blobs(Between().into(near)[0], np.arange(len(near)) % 2 == 0, rng)
    moves = [(BlobsMove(found, Between()), 1.0)] if alone else free_mixture(found, 2, Between())
    sampler = emcee.EnsembleSampler(40, 2, log_density, vectorize=True, moves=moves)
    sampler.random_state = np.random.RandomState(1).get_state()
    sampler.run_mcmc(plain[:40], 3000)
    draws = sampler.get_chain(discard=200, flat=True)
    assert (draws[:, 0] < 0.65).mean() == pytest.approx(0.75, abs=0.02)
    np.testing.assert_allclose(draws.mean(axis=0), plain.mean(axis=0), atol=0.01)
    np.testing.assert_allclose(draws.std(axis=0), plain.std(axis=0), rtol=0.03)


@pytest.mark.long
def test_a_lobe_seen_by_its_flank_alone_converges(tmp_path):
    """Strength, direction and shape follow each other along curves (tests/evidence/sbc.py); its draws are
    the same where the run is stopped and goes on, and within a range that is given."""
    from tests.evidence.sbc import goniometer

    wi, wo = goniometer(anisotropic=True)
    values = {"kd": 0.36, "ks": 0.21, "gamma": -0.805, "delta": -0.04, "n": 12.5, "psi": -0.46}
    model = models.create("lafortune:anisotropic", channels=["c"], **values)
    f = np.asarray(model.evaluate(wi, wo))
    sigma = 0.02 * f + 2e-3
    value = f + sigma * np.random.default_rng(1).standard_normal(f.shape)
    table = fitter.Table(
        wi=wi, wo=wo, value=value, sigma=sigma, channels=["c"], symmetry="anisotropic", negatives="keep",
        duplicates="keep",
    )  # fmt: skip
    fit = fitter.fit(table, model.spec, bounds={"gamma": (-1.1, 1.1), "n": (2.0, 100.0)})
    asked = {"ensembles": 2, "rhat": 1.05, "ess": 400, "budget_seconds": 300.0}
    asked |= {"checkpoint": tmp_path / "kept", "within": {"ks[c]": (0.0, 0.3)}}
    whole = fitter.posterior(table, fit, **asked)
    assert whole.status != "not_converged", whole.message
    assert whole.draws[:, whole.labels.index("ks[c]")].max() <= 0.3
    again = fitter.posterior(table, fit, **asked)
    np.testing.assert_array_equal(again.draws, whole.draws)
