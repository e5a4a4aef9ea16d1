"""Lafortune's lobes near delta = -45 deg: two names for one neighbourhood, and the move between them."""

from __future__ import annotations

import emcee
import jax.numpy as jnp
import numpy as np
import pytest

import fitter
from fitter import FitSpec, ModelSpec, Table, models
from fitter.fitting.layout import Layout, layout
from fitter.fitting.order import swaps
from fitter.posterior.density import Data, Density
from fitter.posterior.moves import DifferenceMove, TwinMove
from tests.evidence.sbc import goniometer


def places(name: str) -> Layout:
    return layout(FitSpec(model=ModelSpec.parse(name)))


def vectors(where: Layout, deltas: np.ndarray) -> np.ndarray:
    """u (W, T) with deltas (W, lobes), the rest drawn."""
    u = np.random.default_rng(0).uniform(0.3, 1.0, (len(deltas), len(where.entries)))
    u[:, swaps(where)[0].delta] = deltas
    return u


BORDER = np.deg2rad([[-45.0], [45.0]]), np.deg2rad([[-60.0, 30.0], [-50.0, -40.0], [10.0, 80.0]])
INSIDE = np.deg2rad([[-44.0], [-10.0], [30.0]]), np.deg2rad([[-50.0, 38.0], [-41.0, -40.0], [5.0, 80.0]])


@pytest.mark.parametrize("lobes", [1, 2])
def test_at_the_border_of_their_order_twins_are_one_surface(lobes: int):
    where = places(f"lafortune:anisotropic:{lobes}:no_diffuse")
    swap = swaps(where)[0]
    pair = np.concatenate([w.T for w in goniometer(anisotropic=True)])
    for u in vectors(where, BORDER[lobes - 1]):
        there = swap.across(u)
        assert np.abs(there[swap.psi] - u[swap.psi]) == pytest.approx(np.pi / 2)
        a, b = (np.asarray(where.terms(jnp.asarray(v), jnp.asarray(pair))) for v in (u, there))
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12 * np.max(a))


@pytest.mark.parametrize("lobes", [1, 2])
def test_the_way_to_a_twin_leads_back_and_keeps_volumes(lobes: int):
    where = places(f"lafortune:anisotropic:{lobes}:no_diffuse")
    swap = swaps(where)[0]
    for u in vectors(where, INSIDE[lobes - 1]):
        there = swap.across(u)
        assert not swap.wanted(there)
        back = swap.across(there)
        back[swap.psi] -= np.pi
        np.testing.assert_allclose(back, u, atol=1e-14)
        step = 1e-4 * np.eye(len(u))
        slopes = (swap.across(u + step) - swap.across(u - step)) / 2e-4
        assert abs(np.linalg.det(slopes)) == pytest.approx(1.0, abs=1e-8)


def test_three_lobes_may_have_no_twin():
    """Reflected, the delta of -70 deg would be beyond -90."""
    where = places("lafortune:anisotropic:3:no_diffuse")
    far = vectors(where, np.deg2rad([[1.0, 2.0, -70.0]]))
    np.testing.assert_array_equal(swaps(where)[0].across(far), far)


def test_the_move_keeps_a_normal_across_the_border():
    """gamma, delta and psi of one lobe about delta = -46 deg: by their one name two islands, the greater
    where gamma is turned, and all walkers begin on the other."""
    where = places("lafortune:anisotropic:no_diffuse")
    nothing, low, high = np.ones((1, 1)), *where.box
    lower, upper = np.array([0.0, *low]), np.array([1.0, *high])
    density = Density(
        where, Data(np.zeros((6, 1)), nothing, nothing), lower, upper, np.array([0.5, 0.6, -0.7, 1.0, 0.1])
    )
    assert len(density.twins) == 1
    middle = np.array([0.5, 0.6, np.deg2rad(-46.0), 1.0, 0.1])
    sd = np.array([0.1, 0.05, np.deg2rad(2.0), 0.1, 0.05])
    plain = density.renamed(np.random.default_rng(1).normal(middle, sd, (200_000, 5)))

    def log_density(y: np.ndarray) -> np.ndarray:
        other = y.copy()
        other[:, 1:] = swaps(where)[0].apply(y[:, 1:])[0]
        each = []
        for name in (y, other):
            away = name - middle
            away[:, 4] -= np.pi * np.round(away[:, 4] / np.pi)
            each.append(-0.5 * np.square(away / sd).sum(axis=1))
        return np.where(density.within(y), np.logaddexp(*each), -np.inf)

    moves = [(DifferenceMove(2), 0.6), (TwinMove(density.twins[0]), 0.4)]
    sampler = emcee.EnsembleSampler(100, 5, log_density, vectorize=True, moves=moves)
    sampler.random_state = np.random.RandomState(2).get_state()
    sampler.run_mcmc(plain[plain[:, 1] > 0][:100], 1500)
    draws = sampler.get_chain(discard=200, flat=True)
    share = (plain[:, 1] > 0).mean()
    assert 0.25 < share < 0.4
    assert (draws[:, 1] > 0).mean() == pytest.approx(share, abs=0.02)
    for side in (1.0, -1.0):
        found, right = (some[side * some[:, 1] > 0][:, :4] for some in (draws, plain))
        np.testing.assert_allclose(found.mean(axis=0), right.mean(axis=0), atol=0.01)
        np.testing.assert_allclose(found.std(axis=0), right.std(axis=0), rtol=0.08)


@pytest.mark.long
def test_a_surface_at_the_border_has_both_names_by_their_shares():
    """Delta of -45 deg: part of the posterior has the one name, part the other, and their shares are right.
    Without names there is one mode: importance sampling about it (20,000 draws of Student's t, worth 16,300)
    has .721 of it beyond -45 deg. Without the move this run found .88, all its walkers in agreement."""
    wi, wo = goniometer(anisotropic=True)
    values = {"kd": 0.2, "ks": 0.15, "gamma": 0.6, "delta": -np.pi / 4, "n": 4.0, "psi": 0.4}
    model = models.create("lafortune:anisotropic", channels=["c"], **values)
    f = np.asarray(model.evaluate(wi, wo))
    sigma = 0.02 * f + 2e-3
    value = f + sigma * np.random.default_rng(1).standard_normal(f.shape)
    table = Table(
        wi=wi, wo=wo, value=value, sigma=sigma, channels=["c"], symmetry="anisotropic", negatives="keep",
        duplicates="keep",
    )  # fmt: skip
    fit = fitter.fit(table, model.spec)
    found = fitter.posterior(
        table, fit, ensembles=2, rhat=1.05, ess=400, budget_seconds=600.0, seed=1, robust=False
    )
    assert found.status != "not_converged", found.message
    turned = found.draws[:, found.labels.index("gamma")] < 0
    assert turned.mean() == pytest.approx(0.721, abs=0.06)


@pytest.mark.parametrize("name", ["ward", "ward:anisotropic", "lafortune", "torrance_sparrow:anisotropic"])
def test_other_surfaces_have_no_twin(name: str):
    where = places(name)
    low, high = where.box
    k = len(where.linear)
    lower, upper = np.array([0.0] * k + [*low]), np.array([1.0] * k + [*high])
    nothing = np.ones((1, 1))
    density = Density(where, Data(np.zeros((6, 1)), nothing, nothing), lower, upper, 0.5 * (lower + upper))
    assert not density.twins
