"""The first look: noise, and how much of the measured region no usable sample covers."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import fitter
from fitter.directions import vector_from_spherical
from fitter.quality import overview
from tests.quality.tables import glossy, table

FloatArray = NDArray[np.float64]
THETA_I = np.deg2rad(40.0)


def spread(count: int) -> FloatArray:
    """(count, 3) directions spread evenly over the cosine-weighted hemisphere up to 85 degrees."""
    k = np.arange(count) + 0.5
    theta = np.arcsin(np.sqrt(k / count) * np.sin(np.deg2rad(85.0)))
    return vector_from_spherical(theta, k * np.pi * (3.0 - np.sqrt(5.0)))


def hidden(wi: FloatArray, radius: float) -> float:
    """Cosine-weighted share of the region that a cone around the light takes, from random points."""
    rng = np.random.default_rng(3)
    theta = np.arcsin(np.sqrt(rng.random(200_000)) * np.sin(np.deg2rad(85.0)))
    wo = vector_from_spherical(theta, rng.uniform(0, 2 * np.pi, len(theta)))
    return float((wo @ wi > np.cos(radius)).mean())


def one_scan() -> tuple[FloatArray, FloatArray]:
    wo = spread(6000)
    return np.broadcast_to(vector_from_spherical(THETA_I, 0.0), wo.shape), wo


@pytest.mark.parametrize("radius", [12.0, 20.0])
@pytest.mark.parametrize("marked", ["missing", "negative"])
def test_the_cone_behind_the_lamp_is_measured(radius: float, marked: str):
    """Whether its samples are missing or unusable: the share is that of the cone, and it is named."""
    wi, wo = one_scan()
    cone = (wi * wo).sum(axis=1) > np.cos(np.deg2rad(radius))
    value = np.where(cone, -1.0, glossy(wi, wo))
    keep = ~cone if marked == "missing" else np.ones(len(wo), bool)
    found = overview(table(value[keep], wi=wi[keep], wo=wo[keep], symmetry="anisotropic"))["blind_spots"]
    assert found["share"] == pytest.approx(hidden(wi[0], np.deg2rad(radius)), rel=0.1)
    assert found["largest"]["radius_deg"] == pytest.approx(radius, abs=1.5)
    assert found["largest"]["theta_o_deg"] == pytest.approx(40.0, abs=2.0)
    assert (found["incidences"], found["blind_to_retro"], found["blind_to_mirror"]) == (1, 1, 0)
    assert "around the direction towards the light" in found["sentences"][0]
    assert f"{100 * found['share']:.2g} %" in found["sentences"][0]
    assert "towards the light" in found["sentences"][1]


def test_a_whole_hemisphere_has_none():
    wi, wo = one_scan()
    found = overview(table(glossy(wi, wo), wi=wi, wo=wo, symmetry="anisotropic"))["blind_spots"]
    assert found["share"] == 0.0
    assert found["largest"] is None
    assert (found["blind_to_retro"], found["blind_to_mirror"]) == (0, 0)


def test_a_grid_with_a_cone_masked():
    """The same on a grid, whose cells around the light are missing."""
    axes = {
        "theta_i": np.deg2rad([30.0, 40.0, 50.0]), "theta_o": np.deg2rad(np.arange(1.0, 86.0, 2.0)),
        "dphi": np.deg2rad(np.arange(0.0, 360.0, 4.0)),
    }  # fmt: skip
    grid = fitter.Grid("spherical_isotropic", axes, {"dphi": 2 * np.pi})
    wi, wo = grid.directions()
    value = glossy(wi, wo)
    value[(wi * wo).sum(axis=1) > np.cos(np.deg2rad(20.0))] = np.nan
    found = overview(fitter.Table(grid=grid, value=value))["blind_spots"]
    each = [hidden(vector_from_spherical(theta, 0.0), np.deg2rad(20.0)) for theta in axes["theta_i"]]
    assert found["share"] == pytest.approx(np.mean(each), rel=0.15)
    assert found["blind_to_retro"] == 3


def test_in_plane_tables_have_no_region():
    theta = np.deg2rad(np.arange(0.0, 80.0, 2.0))
    wi = np.broadcast_to(vector_from_spherical(THETA_I, 0.0), (len(theta), 3))
    wo = vector_from_spherical(theta, np.pi)
    found = overview(table(glossy(wi, wo), wi=wi, wo=wo))["blind_spots"]
    assert found["share"] is None
    assert found["blind_to_retro"] == 1
    assert "do not cover an area" in found["sentences"][0]


def test_noise_comes_from_repeats_where_there_are_any():
    rng = np.random.default_rng(1)
    wi, wo = one_scan()
    smooth = glossy(wi, wo)
    noisy = smooth * (1 + 0.03 * rng.standard_normal(len(wo)))
    found = overview(table(noisy, wi=wi, wo=wo))["noise"]
    assert found["relative_sd"] == pytest.approx(0.03, rel=0.15)
    assert found["basis"].startswith("neighbours")
    twice = np.concatenate([noisy, smooth * (1 + 0.03 * rng.standard_normal(len(wo)))])
    both = table(twice, wi=np.concatenate([wi, wi]), wo=np.concatenate([wo, wo]))
    found = overview(both)["noise"]
    assert found["relative_sd"] == pytest.approx(0.03, rel=0.05)
    assert found["basis"] == "repeated geometries"
    few = overview(table(smooth[:3], wi=wi[:3], wo=wo[:3]))
    assert few["noise"]["relative_sd"] is None
    assert few["blind_spots"]["share"] is None
