"""Blocks: whole scans are held out, whatever the geometry."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fitter import directions
from fitter.selection.blocks import blocks
from tests.selection.conftest import geometry


@given(st.sets(st.integers(0, 16), min_size=4, max_size=17), st.integers(3, 20))
def test_no_scan_is_split_and_every_fold_has_samples(scans, folds):
    wi, wo = geometry(tuple(5.0 * k for k in scans), step=20.0)
    found = blocks(wi, wo, folds, isotropic=True)
    assert found.kind == "theta_i"
    assert found.count == len(scans)
    assert found.folds == min(folds, len(scans))
    theta = np.round(np.rad2deg(directions.spherical_from_vector(wi)[0])).astype(int)
    for angle in np.unique(theta):
        assert len(np.unique(found.block[theta == angle])) == 1
    for block in range(found.count):
        assert len(np.unique(found.fold[found.block == block])) == 1
    used = np.bincount([found.fold[found.block == b][0] for b in range(found.count)])
    assert used.max() - used.min() <= 1


def test_neighbouring_scans_are_in_different_folds():
    wi, wo = geometry(tuple(range(0, 80, 5)))
    found = blocks(wi, wo, 5, isotropic=True)
    fold = [int(found.fold[found.block == b][0]) for b in range(found.count)]
    assert all(a != b for a, b in itertools.pairwise(fold))


def test_few_incidences_hold_out_scattered_angles():
    """Retro-reflective tapes are measured at three."""
    wi, wo = geometry((15, 30, 60))
    found = blocks(wi, wo, 5, isotropic=True)
    assert found.kind == "theta_o"
    theta = np.round(np.rad2deg(directions.spherical_from_vector(wo)[0])).astype(int)
    assert len({(t, f) for t, f in zip(theta, found.fold, strict=True)}) == len(np.unique(theta))


def test_where_the_light_moves_the_scans_are_those_of_the_receiver():
    """In-plane infrared tables: four receiver angles, the light from everywhere."""
    wo, wi = geometry((20, 30, 40, 50), step=0.5)
    wi, wo = wi[::12], wo[::12]
    found = blocks(wi, wo, 5, isotropic=True)
    assert (found.kind, found.count) == ("theta_o", 4)


def test_one_incidence_can_not_be_held_out():
    found = blocks(*geometry((30,)), 5, isotropic=True)
    assert found.kind is None
    assert found.folds == 0
    assert found.words == "one incidence"


def test_azimuths_are_grouped_where_polar_angles_are_many_and_blocks_where_they_are_few():
    many = blocks(*geometry((10, 25, 40, 55), azimuths=(0, 45, 90)), 5, isotropic=False)
    assert (many.kind, many.count) == ("theta_i", 4)
    few = blocks(*geometry((30, 60), azimuths=(0, 45, 90)), 5, isotropic=False)
    assert (few.kind, few.count) == ("incidence", 6)


def test_angles_without_scans_are_bands():
    """Grids in half and difference angles have no two samples at one incidence."""
    rng = np.random.default_rng(0)
    theta = rng.uniform(0, 1.4, 3000)
    wi = directions.vector_from_spherical(theta, 0.0)
    wo = directions.vector_from_spherical(rng.uniform(0, 1.4, 3000), rng.uniform(0, 6, 3000))
    found = blocks(wi, wo, 5, isotropic=True)
    assert found.kind == "theta_i"
    assert found.count == 11
    for block in range(found.count):
        assert np.ptp(theta[found.block == block]) <= np.deg2rad(7.5) + 1e-9


def test_a_stray_sample_belongs_to_the_nearest_scan():
    wi, wo = geometry((0, 20, 40, 60))
    stray = directions.vector_from_spherical(np.deg2rad([41.5]), 0.0)
    found = blocks(np.concatenate([wi, stray]), np.concatenate([wo, wo[:1]]), 5, isotropic=True)
    assert found.count == 4
    assert found.block[-1] == 2


@pytest.mark.parametrize("isotropic", [True, False])
def test_azimuth_at_the_normal_means_nothing(isotropic):
    wi, wo = geometry((0,), azimuths=(0, 45, 90, 135))
    assert blocks(wi, wo, 5, isotropic=isotropic).kind is None
