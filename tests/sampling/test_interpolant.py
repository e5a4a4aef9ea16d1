"""The interpolants: exact at the nodes, flagged outside, and a lobe that moves instead of being doubled."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import find_peaks

from fitter.directions import mirror, vector_from_spherical
from fitter.errors import TableError
from fitter.grid import Grid
from fitter.sampling import TableSampler
from fitter.sampling.interpolant import interpolant
from fitter.table import Table
from tests.sampling.tables import anisotropic, ggx, merl, scattered, spherical


@pytest.mark.parametrize("table", [merl(0.2, shape=(12, 10, 16)), spherical(0.2, 20, 19), anisotropic()])
def test_grids_are_exact_at_usable_nodes(table: Table) -> None:
    index = np.flatnonzero(table.mask)[::7]
    wi, wo = table.directions(index)
    value, extrapolated = table.evaluate(wi, wo)
    assert not extrapolated.any()
    np.testing.assert_allclose(value, table.value[index], rtol=1e-6, atol=1e-9)


def test_scattered_tables_are_exact_at_usable_samples() -> None:
    table = scattered(0.2)
    value, extrapolated = table.evaluate(table.wi, table.wo)
    assert not extrapolated.any()
    np.testing.assert_allclose(value, table.value, rtol=1e-9)


def test_isotropic_tables_do_not_see_azimuth_nor_side() -> None:
    rng = np.random.default_rng(0)
    wo = vector_from_spherical(rng.uniform(0, 1.2, 50), rng.uniform(-3, 3, 50))
    flipped = wo * np.array([1, -1, 1])
    turn = np.array([[np.cos(1.0), -np.sin(1.0), 0], [np.sin(1.0), np.cos(1.0), 0], [0, 0, 1]])
    wi = vector_from_spherical(0.7, 0.0)
    for table in (merl(0.3, shape=(12, 10, 16)), spherical(0.3, 20, 19), scattered(0.3)):
        value, _ = table.evaluate(wi, wo)
        np.testing.assert_allclose(table.evaluate(turn @ wi, wo @ turn.T)[0], value, rtol=1e-7)
        if table.grid is None or table.grid.system != "half_difference":
            np.testing.assert_allclose(table.evaluate(wi, flipped)[0], value, rtol=1e-7)


def test_outside_the_measured_domain_is_flagged_with_a_finite_value() -> None:
    for table in (spherical(0.3, 20, 19), scattered(0.3)):
        wo = vector_from_spherical(0.5, np.linspace(0, 3, 9))
        value, extrapolated = table.evaluate(vector_from_spherical(np.deg2rad(88), 0.0), wo)
        assert extrapolated.all()
        assert np.isfinite(value).all()
    value, extrapolated = scattered(0.3).evaluate(
        vector_from_spherical(np.deg2rad(30), 0.0), vector_from_spherical(1.56, np.linspace(0, 3, 9))
    )
    assert extrapolated.all()
    assert (value > 0).all()


def test_masked_nodes_put_their_cells_outside_the_domain() -> None:
    grid = Grid(
        "spherical_isotropic",
        {"theta_i": np.array([0.0, 0.5]), "theta_o": np.linspace(0, 1, 11), "dphi": np.linspace(0, np.pi, 5)},
    )
    value = np.full(grid.shape, 2.0)
    value[:, 4, 2] = np.nan
    value[:, 8:, :] = np.nan
    table = Table(value=value.reshape(-1), grid=grid)
    wi = vector_from_spherical(0.2, 0.0)
    theta = np.array([0.41, 0.35, 0.15, 0.95])
    values, extrapolated = table.evaluate(wi, vector_from_spherical(theta, np.pi / 2 + 0.01))
    assert extrapolated.tolist() == [True, True, False, True]
    np.testing.assert_allclose(values, 2.0)  # usable neighbours, or the nearest usable node


def test_cell_centred_azimuths_reach_the_plane_of_incidence() -> None:
    step = np.pi / 18
    grid = Grid(
        "spherical_isotropic",
        {
            "theta_i": np.array([0.3, 0.6]),
            "theta_o": np.linspace(0, 1.5, 16),
            "dphi": (np.arange(18) + 0.5) * step,
        },
    )
    ramp = np.broadcast_to(np.arange(18.0), grid.shape)
    table = Table(value=ramp.reshape(-1), grid=grid)
    wi = vector_from_spherical(0.4, 0.0)
    value, extrapolated = table.evaluate(wi, vector_from_spherical(0.7, [0.0, -0.01, np.pi, -3.1]))
    assert not extrapolated.any()
    np.testing.assert_allclose(value[:, 0], [0, 0, 17, 17])


def test_a_lobe_between_incidences_moves_and_is_not_doubled() -> None:
    table = scattered(0.08, count=3000)
    theta = np.deg2rad(40.0)
    wi = vector_from_spherical(theta, 0.0)
    x = np.linspace(-0.95, 0.2, 400)
    wo = np.stack([x, np.full_like(x, 1e-4), np.sqrt(1 - x**2)], axis=1)
    value = table.evaluate(wi, wo)[0][:, 0]
    assert abs(x[value.argmax()] + np.sin(theta)) < 0.02
    peaks, _ = find_peaks(value, prominence=0.02 * value.max())
    assert len(peaks) == 1
    truth = ggx(np.broadcast_to(wi, wo.shape), wo, 0.08).max()
    assert 0.8 < value.max() / truth < 1.25


def test_a_retro_reflector_peaks_towards_the_light_between_incidences() -> None:
    base = scattered(0.2, count=3000, one_side=False)
    toward = np.exp(-((base.wi - base.wo) ** 2).sum(axis=1) / 0.15**2)
    table = Table(wi=base.wi, wo=base.wo, value=toward + 0.01, symmetry="isotropic")
    wi = vector_from_spherical(np.deg2rad(40.0), 0.0)
    x = np.linspace(-0.9, 0.9, 400)
    wo = np.stack([x, np.full_like(x, 1e-4), np.sqrt(1 - x**2)], axis=1)
    value = table.evaluate(wi, wo)[0][:, 0]
    assert abs(x[value.argmax()] - wi[0]) < 0.03
    assert value[np.abs(x - wi[0]) > 0.45].max() < 0.1


def test_in_plane_tables_are_evaluated_in_the_plane_only() -> None:
    theta = np.deg2rad(np.arange(-70, 71, 5.0))
    theta_i = np.repeat(np.deg2rad([20.0, 40.0]), len(theta))
    wo = vector_from_spherical(np.abs(np.tile(theta, 2)), np.where(np.tile(theta, 2) < 0, np.pi, 0.0))
    wi = vector_from_spherical(theta_i, 0.0)
    table = Table(wi=wi, wo=wo, value=1 + wo[:, 0] ** 2)
    inside, flagged = table.evaluate(wi[:5], wo[:5])
    np.testing.assert_allclose(inside[:, 0], table.value[:5, 0])
    assert not flagged.any()
    assert table.evaluate(wi[0], vector_from_spherical(0.5, 1.0))[1].all()


def test_a_table_of_single_directions_answers_with_the_nearest() -> None:
    rng = np.random.default_rng(2)
    wi = vector_from_spherical(rng.uniform(0.1, 1, 30), 0.0)
    wo = vector_from_spherical(rng.uniform(0, 1, 30), rng.uniform(0.1, 3, 30))
    table = Table(wi=wi, wo=wo, value=np.arange(1.0, 31))
    value, extrapolated = table.evaluate(wi, wo)
    np.testing.assert_array_equal(value, table.value)
    assert not extrapolated.any()
    assert table.evaluate(wi[0], mirror(wo[0]))[1].all()


@given(st.floats(0, np.pi / 2 - 1e-3), st.floats(0, np.pi / 2 - 1e-3), st.floats(-7, 7), st.floats(-7, 7))
def test_values_are_finite_everywhere(theta_i: float, theta_o: float, phi_i: float, phi_o: float) -> None:
    for table in TABLES:
        wi, wo = vector_from_spherical(theta_i, phi_i), vector_from_spherical(theta_o, phi_o)
        value, _ = table.evaluate(wi, wo)
        assert np.isfinite(value).all()
        usable = table.value[table.mask]
        assert usable.min() - 1e-9 <= value.min()
        assert value.max() <= usable.max() * (1 + 1e-9)


TABLES = [merl(0.2, shape=(8, 9, 10)), spherical(0.2, 9, 10), anisotropic(), scattered(0.2, count=60)]


def test_tables_pickle_after_they_were_evaluated() -> None:
    for table in TABLES:
        wi, wo = table.wi[5:9], table.wo[5:9]
        before = table.evaluate(wi, wo)[0]
        again = pickle.loads(pickle.dumps(table))
        np.testing.assert_array_equal(again.evaluate(wi, wo)[0], before)
        assert interpolant(table) is interpolant(table)


@pytest.mark.parametrize("wo", [[[1.0, 0.0]], [[np.nan, 0.0, 1.0]], np.zeros((2, 2, 3))])
def test_directions_that_make_no_sense(wo: object) -> None:
    with pytest.raises(TableError) as caught:
        TABLES[0].evaluate([0.0, 0.0, 1.0], wo)  # type: ignore[arg-type]
    assert caught.value.code == "bad-directions"


def test_a_node_at_the_end_of_an_even_axis_needs_no_neighbour() -> None:
    """Of pi as a multiple of its step rounding makes less than the whole number that it is: at normal
    incidence, where phi_d is pi everywhere, a masked neighbour was asked then."""
    axes = {"theta_h": np.linspace(0, np.pi / 2, 20), "theta_d": np.linspace(0, np.pi / 2, 20)}
    for n in (8, 18, 19, 37):
        grid = Grid("half_difference", {**axes, "phi_d": np.linspace(0, np.pi, n)})
        mask = np.ones(grid.shape, bool)
        mask[:, :, n - 2] = False
        table = Table(value=np.ones(grid.size), grid=grid, mask=mask.reshape(-1))
        drawn = TableSampler(table).sample(np.array([0.0, 0.0, 1.0]), 1000, seed=1)
        assert drawn.weight.mean() == pytest.approx(np.pi, rel=0.02)
