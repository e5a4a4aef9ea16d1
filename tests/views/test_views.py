"""Views: what is shown is what the table holds, at the angles that are named."""

from __future__ import annotations

import numpy as np
import pytest

import fitter
from fitter import datasets, directions
from fitter.grid import Grid
from fitter.table import Table
from fitter.views import Views, in_plane, lobe
from tests.quality.tables import table


def test_a_slice_is_the_interpolant_in_the_plane():
    found = in_plane(table(), 30.0, 20.0, n=181)
    phi = np.deg2rad(20.0)
    incident = directions.vector_from_spherical(np.deg2rad(30.0), phi)
    for theta, value in list(zip(found.theta_o_deg, found.values, strict=True))[::20]:
        wo = directions.vector_from_spherical(np.deg2rad(abs(theta)), phi if theta < 0 else phi + np.pi)
        assert table().evaluate(incident, wo)[0][0] == pytest.approx(value)
    # The peak is on the specular side.
    assert 20 < found.theta_o_deg[np.argmax(found.values[:, 0])] < 60


def test_a_lobe_is_the_interpolant_over_the_hemisphere():
    found = lobe(table(), 45.0, step_deg=5.0)
    assert found.values.shape == (len(found.theta_o_deg), len(found.turn_deg), 1)
    assert (np.diff(found.theta_o_deg) > 1e-3).all()
    assert (np.diff(found.turn_deg) > 1e-3).all()
    assert (found.turn_deg[0], found.turn_deg[-1]) == (0.0, 360.0)
    assert np.allclose(found.values[:, 0], found.values[:, -1])
    m, k = np.unravel_index(np.argmax(found.values[..., 0]), found.values.shape[:2])
    assert abs(found.turn_deg[k] - 180.0) < 10  # opposite to the light
    incident = directions.vector_from_spherical(np.deg2rad(45.0), 0.0)
    wo = directions.vector_from_spherical(np.deg2rad(found.theta_o_deg[m]), np.deg2rad(found.turn_deg[k]))
    assert table().evaluate(incident, wo)[0][0, 0] == pytest.approx(found.values[m, k, 0])
    # Beyond 85 degrees nothing was measured.
    assert found.extrapolated[found.theta_o_deg > 86].all()
    assert not found.extrapolated[found.theta_o_deg < 80].any()


def test_a_narrow_peak_is_not_missed():
    """Between the nodes of the even raster, at the mirror direction itself, there is a node."""
    found = lobe(table(), 31.7, step_deg=15.0)
    assert 31.7 in found.theta_o_deg
    assert 180.0 in found.turn_deg


def _merl_like(size: tuple[int, int, int], usable: np.ndarray | None = None) -> Table:
    axes = {
        "theta_h": np.deg2rad(90.0 * (np.arange(size[0]) / size[0]) ** 2),
        "theta_d": np.deg2rad(np.arange(size[1]) * 90.0 / size[1]),
        "phi_d": np.deg2rad(np.arange(size[2]) * 180.0 / size[2]),
    }
    rng = np.random.default_rng(3)
    value = rng.lognormal(size=(np.prod(size), 2))
    return Table(grid=Grid("half_difference", axes, periodic={"phi_d": np.pi}), value=value, mask=usable)


def test_the_image_of_a_grid_is_its_mean_over_phi_d():
    size = (6, 5, 8)
    rng = np.random.default_rng(4)
    found_in = _merl_like(size, rng.random(np.prod(size)) > 0.2)
    image = Views(found_in).half_difference()
    assert image.values.shape == (5, 6, 2)
    theta_h, theta_d, _ = np.meshgrid(*found_in.grid.axes.values(), indexing="ij")
    assert image.samples.sum() == image.looked_at == found_in.mask.sum()
    for d in range(5):
        for h in range(6):
            cell = found_in.mask & np.isclose(theta_h.reshape(-1), np.deg2rad(image.theta_h_deg[h]))
            cell &= np.isclose(theta_d.reshape(-1), np.deg2rad(image.theta_d_deg[d]))
            assert image.samples[d, h] == cell.sum()
            expected = found_in.value[cell].mean(axis=0) if cell.any() else np.full(2, np.nan)
            assert image.values[d, h] == pytest.approx(expected, nan_ok=True)


def test_the_image_of_scattered_samples_holds_each_once():
    image = Views(table()).half_difference()
    assert image.samples.sum() == image.looked_at == table().usable
    total = np.nansum(image.values[..., 0] * image.samples)
    assert total == pytest.approx(table().value[:, 0].sum())
    # The mirror direction is brightest.
    _, h, _ = np.unravel_index(np.nanargmax(image.values), image.values.shape)
    assert image.theta_h_deg[h] < 15


@pytest.mark.parametrize("name", list(datasets.samples()))
def test_coverage_and_cuts_are_those_of_the_picture(name: str):
    from fitter.report.portrait import portrait

    measured = fitter.load(datasets.sample(name))
    views, picture = Views(measured), portrait(measured)
    coverage, cuts = views.coverage(), views.cuts()
    assert np.array_equal(coverage.usable, picture.counts)
    assert np.array_equal(coverage.masked, picture.masked)
    assert (coverage.looked_at, coverage.usable.sum()) == (picture.looked_at, measured.usable)
    assert len(cuts.cuts) == len(picture.cuts)
    for mine, drawn in zip(cuts.cuts, picture.cuts, strict=True):
        assert mine.channels.shape == (len(mine.theta_o_deg), len(measured.channels))
        assert mine.value == pytest.approx(drawn.value)
    assert views.coverage() is coverage
