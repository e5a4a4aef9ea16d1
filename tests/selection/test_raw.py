"""What the raw table predicts of itself, and what follows from it: no model is fitted here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fitter
from fitter.grid import Grid
from fitter.selection.compare import Difference
from fitter.selection.data import Data
from fitter.selection.raw import RawPrediction, raw_prediction, repeatability
from fitter.selection.result import Ranked, RawTable
from fitter.selection.words import Facts, sentences, verdict
from fitter.spec import selection_spec
from tests.selection.conftest import geometry


def smooth(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """Linear in wo on the disk, and in theta_i: what the interpolant of scans predicts without an error."""
    theta = np.arccos(np.clip(wi[:, 2], -1, 1))
    return 2.0 + wo[:, :1] + 0.5 * wo[:, 1:2] + theta[:, None]


def of(table: fitter.Table, **settings: object) -> Data:
    return Data.of(table, selection_spec({"metric": "absolute", **settings}))


def test_a_held_out_scan_is_predicted_from_its_neighbours():
    wi, wo = geometry((0, 10, 20, 30, 40, 50, 60, 70))
    data = of(fitter.Table(wi=wi, wo=wo, value=smooth(wi, wo), symmetry="isotropic"))
    found = raw_prediction(data)
    assert isinstance(found, RawPrediction)
    # The first and the last scan have a neighbour on one side only.
    block = data.blocks.block[found.rows]
    assert set(block.tolist()) == set(range(1, 7))
    inside = wo[found.rows][:, 2] > 0.5  # away from the rim, where triangles of neighbours differ
    np.testing.assert_allclose(found.value[inside], smooth(wi, wo)[found.rows][inside], rtol=0.01)


def test_a_grid_is_held_out_node_by_node():
    axes = {
        "theta_i": np.deg2rad(np.arange(5, 86, 5.0)), "theta_o": np.deg2rad(np.arange(5, 86, 5.0)),
        "dphi": np.deg2rad(np.arange(0, 181, 15.0)),
    }  # fmt: skip
    grid = Grid("spherical_isotropic", axes)
    theta_i, theta_o, dphi = grid.coordinates()
    value = 1.0 + theta_i + 0.5 * theta_o + 0.1 * np.square(dphi)
    data = of(fitter.Table(grid=grid, value=value))
    found = raw_prediction(data)
    assert isinstance(found, RawPrediction)
    assert "dphi" in found.words  # the only axis along which it is not linear
    error = np.abs(found.value[:, 0] - data.used.value[found.rows, 0])
    # The chord of 0.1 x^2 over two steps h misses its middle by 0.1 h^2.
    assert np.median(error) == pytest.approx(0.1 * np.deg2rad(15.0) ** 2, rel=1e-6)
    wide = of(fitter.Table(grid=grid, value=value), folds=4)
    assert np.isfinite(found.errors(wide)).all()


def test_the_table_is_not_judged_where_nothing_can_be_held_out():
    wi, wo = geometry((30,))
    assert raw_prediction(of(fitter.Table(wi=wi, wo=wo, value=np.ones(len(wi))))) == "no scan can be held out"


def test_repeated_geometries_give_the_noise():
    wi, wo = geometry((0, 20, 40, 60))
    wi, wo = np.tile(wi, (3, 1)), np.tile(wo, (3, 1))
    value = 1.0 + 0.05 * np.random.default_rng(0).standard_normal(len(wi))
    table = fitter.Table(wi=wi, wo=wo, value=value)
    relative = repeatability(table, 0)
    assert relative == pytest.approx(0.05, rel=0.1)
    data = of(table)
    noise = data.noise(data.rows, relative)
    assert noise is not None
    np.testing.assert_allclose(noise, relative * np.abs(data.used.value[data.rows]))


def test_a_table_larger_than_the_limit_gives_each_scan_its_share():
    wi, wo = geometry(tuple(range(0, 75, 5)), step=1.0)
    data = of(fitter.Table(wi=wi, wo=wo, value=np.ones(len(wi))))
    assert not data.whole
    assert len(data.rows) == pytest.approx(6144, abs=20)
    share = np.bincount(data.blocks.block[data.rows]) / np.bincount(data.blocks.block)
    np.testing.assert_allclose(share, share.mean(), rtol=0.01)
    again = of(fitter.Table(wi=wi, wo=wo, value=np.ones(len(wi))))
    np.testing.assert_array_equal(again.rows, data.rows)


def facts(ratio: float, lower: float, upper: float, noise: float | None = None) -> Facts:
    wi, wo = geometry()
    data = of(fitter.Table(wi=wi, wo=wo, value=np.ones(len(wi))))
    same = Difference(1.0, 0.0, 1.0, 1.0)
    one = Ranked("ward", 3, 0.1, 0.23, True, (0.1,) * 5, same, True, 0.0, "converged", 1.0)
    raw = RawTable(0.05, 0.09, 0.21, Difference(ratio, 0.1, lower, upper), 500, "each block from the others")
    return Facts(data, [one], one, raw, None, noise)


def test_no_model_is_good_enough_where_the_table_predicts_itself_better_beyond_doubt():
    assert verdict(facts(2.4, 1.8, 3.2)) == "raw_table"
    said = sentences(facts(2.4, 1.8, 3.2))[1]
    assert said.startswith("No model is good enough")
    for number in ("21 % and 9 %", "2.4 times", "1.8 to 3.2", "use the raw table"):
        assert number in said
    assert verdict(facts(2.4, 0.9, 6.0)) == "model"  # not beyond doubt
    assert verdict(facts(1.1, 1.05, 1.15)) == "model"  # not enough to give up a model
    better = sentences(facts(0.5, 0.4, 0.6))[1]
    assert "better than the table itself" in better
    assert "A typical sample is closer to the interpolant" in better  # the two errors disagree


def test_a_model_as_good_as_the_noise_needs_no_comparison():
    assert verdict(facts(2.4, 1.8, 3.2, noise=1.1)) == "model"
    assert "1.1 times that of the noise" in sentences(facts(2.4, 1.8, 3.2, noise=1.1))[1]
    assert verdict(facts(2.4, 1.8, 3.2, noise=3.0)) == "raw_table"


def test_what_can_not_be_judged_is_said():
    found = replace(facts(1.0, 1.0, 1.0), raw=None, raw_reason="no scan can be held out")
    assert verdict(found) == "not_judged"
    assert "no scan can be held out" in sentences(found)[1]
