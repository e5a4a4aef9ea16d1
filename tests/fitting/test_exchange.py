"""Single lobes by branch and bound against a plain scan of everything that a lobe can be."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import nnls

from fitter import FitSpec, directions
from fitter.fitting import exchange
from fitter.fitting.layout import layout
from fitter.spec import model_spec

FloatArray = NDArray[np.float64]


def _columns(pair: FloatArray, weight: FloatArray, lobes: FloatArray) -> FloatArray:
    """(n, 1 + L) weighted terms at lobes (gamma, ln n), in degrees of plain trigonometry."""
    (ix, iy, iz), (ox, oy, oz) = pair[:3], pair[3:]
    columns = [np.full(len(ix), 1 / np.pi)]
    for gamma, log_n in lobes:
        c = np.array([-np.sin(gamma), -np.sin(gamma), np.cos(gamma)])
        c /= np.abs(c).max()
        base = np.maximum(c[0] * ix * ox + c[1] * iy * oy + c[2] * iz * oz, 0.0)
        n = np.exp(log_n)
        columns.append((n + 2) / (2 * np.pi) * base**n)
    return weight[:, None] * np.stack(columns, axis=1)


def _objective(pair: FloatArray, y: FloatArray, weight: FloatArray, lobes: FloatArray) -> float:
    a = _columns(pair, weight, lobes)
    scale = np.maximum(np.abs(a).max(axis=0), 1e-80)
    return nnls(a / scale, weight * y)[1] ** 2


def _table(seed: int, samples: int, lobes: FloatArray, strengths: FloatArray, in_plane: bool):
    rng = np.random.default_rng(seed)
    theta_i, theta_o = rng.uniform(0, 1.3, samples), rng.uniform(0, 1.4, samples)
    if in_plane:
        theta_i = np.repeat(rng.uniform(0, 1.3, 4), -(-samples // 4))[:samples]
        turn = np.pi * rng.integers(0, 2, samples)
    else:
        turn = rng.uniform(0, 2 * np.pi, samples)
    wi = directions.vector_from_spherical(theta_i, np.zeros(samples))
    pair = np.concatenate([wi.T, directions.vector_from_spherical(theta_o, turn).T])
    exact = _columns(pair, np.ones(samples), lobes) @ np.concatenate([[0.2], strengths])
    sigma = 0.1 * (exact + 0.01)
    return pair, exact + sigma * rng.standard_normal(samples), 1 / sigma


@pytest.mark.long
@pytest.mark.parametrize("in_plane", [False, True])
@pytest.mark.parametrize("strength", [1e-4, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_no_node_of_a_scan_is_lower(seed: int, strength: float, in_plane: bool):
    pair, y, weight = _table(seed, 60, np.array([[0.6, 5.0]]), np.array([strength]), in_plane)
    places = layout(FitSpec(model=model_spec("lafortune")))
    p, fell = exchange.improved(places, pair, y[:, None], weight[:, None], [np.array([-2.0, 1.0])])
    gamma, log_n = np.meshgrid(np.linspace(-np.pi, np.pi, 360), np.log(np.geomspace(0.1, 1e5, 60)))
    nodes = np.stack([gamma, log_n], axis=-1).reshape(-1, 1, 2)
    lowest = min(_objective(pair, y, weight, lobes) for lobes in nodes)
    found = _objective(pair, y, weight, p[:2][None])
    assert found <= lowest + 1e-3
    assert 0 <= fell < 1
    # The coefficients are those of the model's terms.
    residual = _columns(pair, weight, p[:2][None]) @ p[2:] - weight * y
    assert residual @ residual == pytest.approx(found, rel=1e-9)


def test_two_lobes_from_a_start_that_has_neither():
    truth = np.array([[-0.7, np.log(4.0)], [0.75, np.log(3000.0)]])
    pair, y, weight = _table(5, 2000, truth, np.array([0.3, 0.01]), False)
    places = layout(FitSpec(model=model_spec("lafortune:2")))
    start = np.array([2.0, 0.0, 2.5, 1.0])
    p, _ = exchange.improved(places, pair, y[:, None], weight[:, None], [start])
    assert _objective(pair, y, weight, p[:4].reshape(2, 2)) <= _objective(pair, y, weight, truth)


def test_channels_are_searched_with_the_usual_effort_only():
    usual = FitSpec(model=model_spec("lafortune"))
    one = layout(usual)
    assert exchange.wanted(one, usual, 500, 1)
    for changed, samples, channels in (
        ({}, 500, 3), ({}, 100_000, 1), ({"starts": 1}, 500, 1), ({"subset": 256}, 500, 1),
        ({"solver": "nlopt"}, 500, 1),
    ):  # fmt: skip
        assert not exchange.wanted(one, usual.model_copy(update=changed), samples, channels)
    fixed = FitSpec(model=model_spec("lafortune"), fixed={"gamma": 0.7})
    assert not exchange.wanted(layout(fixed), fixed, 500, 1)
