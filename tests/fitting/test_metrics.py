"""Metrics and weightings: what they promise about bias, spacing, likelihood, and what they leave out."""

from __future__ import annotations

from typing import get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import fitter
from fitter import FitError, SpecError, Table, directions, models
from fitter.fitting import metrics
from fitter.fitting.measures import measures
from fitter.fitting.usable import usable
from fitter.grid import Grid
from fitter.spec import Metric, Select
from tests.fitting.conftest import TRUTHS, scattered
from tests.fitting.test_fit import pull

CENTRES = {"theta_h": 40, "theta_d": 30, "phi_d": 36}


def half_difference(square: bool) -> Grid:
    """A grid of cell centres, its theta_h even or dense near 0 as MERL's."""
    axes = {
        "theta_h": np.pi / 2 * (np.linspace(0, 1, 41) ** 2 if square else np.linspace(0, 1, 41)),
        "theta_d": np.linspace(0, np.pi / 2, 31),
        "phi_d": np.linspace(0, np.pi, 37),
    }
    centres = {name: 0.5 * (edges[1:] + edges[:-1]) for name, edges in axes.items()}
    return Grid("half_difference", centres, {"phi_d": np.pi})


def in_out(steps: int, azimuths: int) -> Grid:
    theta = np.pi / 2 * (np.arange(steps) + 0.5) / steps
    dphi = np.pi * np.arange(azimuths) / (azimuths - 1)
    return Grid("spherical_isotropic", {"theta_i": theta, "theta_o": theta, "dphi": dphi})


GRIDS = {
    "half/difference": half_difference(False), "MERL": half_difference(True), "in/out": in_out(24, 25),
    "coarse": in_out(12, 13),
}  # fmt: skip


def tabulated(grid: Grid, model: models.ReflectanceModel) -> Table:
    wi, wo = grid.directions()
    above = (wi[:, 2] > 1e-6) & (wo[:, 2] > 1e-6)
    value = np.ones((len(wi), 1))
    value[above] = np.asarray(model.evaluate(wi[above], wo[above]))[:, :1]
    return Table(grid=grid, value=value, mask=above)


@pytest.mark.parametrize("grid", GRIDS.values(), ids=list(GRIDS))
@pytest.mark.parametrize(
    ("function", "mean"),
    [
        (lambda wi, wo: wi[:, 2] * wo[:, 2], 1 / 4),
        (lambda wi, wo: wi[:, 2] ** 2 * wo[:, 2], 1 / 6),
        # The mean of (wi.wo)^2, and of the product, over both hemispheres.
        (lambda wi, wo: np.square((wi * wo).sum(axis=1)), 1 / 3),
        (lambda wi, wo: (wi * wo).sum(axis=1), 1 / 4),
    ],
)
def test_measures_integrate(grid, function, mean):
    """Means over pairs of directions are those of the product of two hemispheres, on any grid."""
    table = tabulated(grid, models.create("lambert", kd=0.5, channels=["c"]))
    index = np.flatnonzero(table.mask)
    weight = measures(table, table.mask)[index]
    assert weight.mean() == pytest.approx(1.0)
    found = np.average(function(*table.directions(index)), weights=weight)
    # A cell on the horizon is in or out as a whole.
    assert found == pytest.approx(mean, rel=0.03)


@pytest.mark.parametrize("metric", get_args(Metric))
def test_the_slope_is_the_residual_s(metric):
    """Where it is not, passes end beside the optimum."""
    rng = np.random.default_rng(0)
    f, y = 10.0 ** rng.uniform(-7, 3, (2, 1000, 1))
    w, e = 10.0 ** rng.uniform(-6, 3, (1000, 1)), np.array([1e-3])
    f[:10] = 0.0
    y, w, e = (jnp.asarray(a) for a in (y, w, e))

    def total(f: jax.Array) -> jax.Array:
        return metrics.residual(metric, f, y, w, e).value.sum()

    expected = jax.grad(total)(jnp.asarray(f))
    slope = metrics.residual(metric, jnp.asarray(f), y, w, e).slope
    above = f > 0 if metric in metrics.POSITIVE else np.full(f.shape, True)
    np.testing.assert_allclose(np.asarray(slope)[above], np.asarray(expected)[above], rtol=1e-6)


def scans(seed: int = 0, count: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """Five scans of viewing directions crowded towards the normal."""
    rng = np.random.default_rng(seed)
    theta = np.repeat(np.deg2rad([5, 20, 40, 60, 75]), count)
    wi = directions.vector_from_spherical(theta, 0.0)
    theta_o = np.pi / 2 * rng.random(len(theta)) ** 1.5
    return wi, directions.vector_from_spherical(theta_o, rng.uniform(0, 2 * np.pi, len(theta)))


def test_measures_of_scans_integrate():
    wi, wo = scans()
    table = Table(wi=wi, wo=wo, value=np.ones(len(wi)))
    weight = measures(table, table.mask)
    for theta in np.unique(np.round(wi[:, 2], 9)):
        own = np.abs(wi[:, 2] - theta) < 1e-6
        assert np.average(wo[own, 2], weights=weight[own]) == pytest.approx(0.5, abs=0.02)
        assert wo[own, 2].mean() > 0.6
    # The scans have the solid angle of the bands of incidence that they are in the middle of.
    edges = np.cos(np.deg2rad([0, 12.5, 30, 50, 67.5, 82.5]))
    share = [weight[np.abs(wi[:, 2] - z) < 1e-6].sum() for z in sorted(set(wi[:, 2].tolist()), reverse=True)]
    expected = -np.diff(edges) / (edges[0] - edges[-1])
    np.testing.assert_allclose(np.array(share) / sum(share), expected, rtol=1e-6)


def test_measures_in_plane_are_arcs():
    theta_o = np.deg2rad([-80, -40, -38, -36, 0, 60])
    wi = np.tile(directions.vector_from_spherical(0.5, 0.0), (6, 1))
    wo = directions.vector_from_spherical(np.abs(theta_o), np.where(theta_o < 0, np.pi, 0.0))
    weight = measures(Table(wi=wi, wo=wo, value=np.ones(6)), np.ones(6, bool))
    # The first cell ends at the horizon, 10 deg on, and the last one too.
    expected = np.array([10 + 20, 20 + 1, 2, 1 + 18, 18 + 30, 30 + 30.0])
    np.testing.assert_allclose(weight, expected / expected.mean(), rtol=1e-6)


def test_scattered_samples_without_scans_are_told():
    with pytest.raises(SpecError) as caught:
        fitter.fit(scattered(models.create("ward"), seed=1, n=100), "ward", weighting="solid_angle")
    assert caught.value.code == "no-scans"


@pytest.mark.long
@pytest.mark.parametrize(("metric", "within"), [("relative", 0.04), ("log", 0.03), ("cbrt", 0.02)])
def test_the_spacing_of_a_grid_does_not_decide(metric, within):
    """A surface that the model can't follow, on a grid like MERL's and on one in theta_i and theta_o: albedos
    that are two to three times apart when every sample counts alike agree by solid angles."""
    surface = models.create("torrance_sparrow:ggx:smith", kd=0.2, ks=0.8, f0=0.05, alpha=0.25, channels=["c"])
    tables = [tabulated(GRIDS[name], surface) for name in ("MERL", "in/out")]
    apart = {}
    for weighting in ("samples", "solid_angle"):
        fits = [fitter.fit(table, "ward", metric=metric, weighting=weighting) for table in tables]
        found = [[float(fit.parameters[name].value[0]) for name in ("kd", "ks")] for fit in fits]
        apart[weighting] = np.abs(np.log(np.array(found[1]) / found[0])).max()
    assert apart["solid_angle"] < within
    assert apart["samples"] > 0.7


def test_solid_angles_are_no_likelihood():
    wi, wo = scans(count=60)
    exact = np.asarray(models.create("ward", **TRUTHS["ward"]).evaluate(wi, wo))
    u = 0.02 * exact
    value = exact + u * np.random.default_rng(1).standard_normal(exact.shape)
    table = Table(wi=wi, wo=wo, value=value, sigma=u)
    plain, weighted = (fitter.fit(table, "ward", weighting=w) for w in ("samples", "solid_angle"))
    assert (plain.uncertainty, weighted.uncertainty) == ("curvature", "sandwich")
    assert "chi2_per_dof" not in weighted.metrics
    assert weighted.table["weighting"] == "solid_angle"
    assert np.abs(pull(weighted, models.create("ward", **TRUTHS["ward"]))).max() < 6.0


# Published ----------------------------------------------------------------------------------------------


def test_published_errors_are_their_definitions():
    """Against the sums written out, on scans; and of one constant offset, in closed form."""
    from fitter.fitting import published

    model = models.create("ward", **TRUTHS["ward"])
    wi, wo = scans(count=80)
    f = np.asarray(model.evaluate(wi, wo))
    table = Table(wi=wi, wo=wo, value=f + 0.25, channels=model.channels)
    found = published(model, table)
    w, cos_i = measures(table, table.mask)[:, None] * np.ones(3), wi[:, 2:]
    steep = (np.minimum(wi[:, 2], wo[:, 2]) > np.cos(np.deg2rad(80)))[:, None]
    assert found.solid_angles
    assert found.left_out == 0
    assert found.low_e1 == pytest.approx(0.0625 * np.average(cos_i[:, 0] ** 2, weights=w[:, 0]))
    below = w * steep
    assert found.ngan_l2 == pytest.approx(0.25 * np.sqrt((below * cos_i**2).sum() / below.sum()))
    logs = np.log((1 + f * cos_i) / (1 + (f + 0.25) * cos_i))
    assert found.low_e2 == pytest.approx((w * logs**2).sum() / w.sum())


def test_published_errors_without_scans_say_so_and_count():
    from fitter.fitting import published

    model = models.create("ward", channels=["value"])
    table = scattered(model, seed=1, n=60)
    value = table.value.copy()
    value[0] = -100.0
    found = published(model, Table(wi=table.wi, wo=table.wo, value=value, negatives="keep"))
    assert not found.solid_angles
    assert found.left_out == 1
    assert np.isfinite(found).all()
    with pytest.raises(SpecError, match="no channel 'x'"):
        published(models.create("ward", channels=["x"]), table)


# Relative -----------------------------------------------------------------------------------------------


def noisy(noise: float = 0.1, n: int = 20_000) -> tuple[Table, np.ndarray]:
    """A table of Ward's model with noise in proportion to the value, and the values without."""
    model = models.create("ward", **TRUTHS["ward"])
    exact = np.asarray(model.evaluate(*scans(count=n // 5)))
    value = exact * (1 + noise * np.random.default_rng(5).standard_normal(exact.shape))
    wi, wo = scans(count=n // 5)
    return Table(wi=wi, wo=wo, value=value), exact


@pytest.mark.long
def test_relative_weights_come_from_the_model_and_bias_nothing():
    """Weights 1/y of the noisy values bias the diffuse albedo by many standard errors; those of the model, as
    the metric has them and as three reweightings of the measurement metric have them, do not."""
    model = models.create("ward", **TRUTHS["ward"])
    table, _ = noisy()
    fit = fitter.fit(table, "ward", metric="relative")
    assert np.abs(pull(fit, model)).max() < 4.5
    naive = fitter.fit(Table(wi=table.wi, wo=table.wo, value=table.value, sigma=0.1 * table.value), "ward")
    kd, u = naive.parameters["kd"].value, naive.parameters["kd"].standard_uncertainty
    assert ((kd - np.array(TRUTHS["ward"]["kd"])) / u).max() < -15.0
    again = naive
    floor = 1e-3 * np.median(table.value, axis=0)
    for _ in range(5):
        weights = 0.1 * (np.asarray(again.model.evaluate(table.wi, table.wo)) + floor)
        again = fitter.fit(Table(wi=table.wi, wo=table.wo, value=table.value, sigma=weights), "ward")
    for name, estimate in fit.parameters.items():
        shift = (estimate.value - again.parameters[name].value) / estimate.standard_uncertainty
        assert np.abs(shift).max() < 0.02


def test_deviance_is_its_derivative():
    """r r' = (f - y)/(f + e)^2: what makes its optimum that of model-based weights; on both sides of where
    the series takes over."""
    y = jnp.array([[0.3], [0.3], [0.3], [1e-9], [50.0]])
    f = jnp.array([[0.3], [0.3 * 1.009], [0.3 * 1.011], [0.2], [0.2]])
    w, floor = jnp.full_like(y, 2.0), jnp.array([1e-3])
    r = metrics.residual("relative", f, y, w, floor)
    np.testing.assert_allclose(r.value * r.slope, 4 * (f - y) / (f + floor) ** 2, rtol=1e-9, atol=1e-300)
    t = (y + floor) / (f + floor)
    np.testing.assert_allclose(r.value**2, 8 * (t - 1 - jnp.log(t)), rtol=1e-7, atol=1e-12)
    slope = jax.jvp(
        lambda v: metrics.residual("relative", v, y, w, floor).value, (f,), (jnp.ones_like(f),)
    )[1]  # fmt: skip
    np.testing.assert_allclose(slope, r.slope, rtol=1e-8)


@pytest.mark.parametrize("metric", ["relative", "log"])
def test_what_a_metric_forbids_is_counted(metric):
    base = scattered(models.create("ward", **TRUTHS["ward"]), seed=3, n=400)
    value = base.value.copy()
    value[:7] = -0.5
    table = Table(wi=base.wi, wo=base.wo, value=value, negatives="keep")
    fit = fitter.fit(table, "ward", metric=metric)
    assert fit.table["left_out"] == {f"too negative for the metric {metric}": 7}
    assert any(f"7 usable samples left out: too negative for the metric {metric}" in w for w in fit.warnings)
    assert fit.table["fitted"] == 393
    every = Table(wi=base.wi, wo=base.wo, value=-base.value, negatives="keep")
    with pytest.raises(FitError) as caught:
        fitter.fit(every, "ward", metric=metric)
    assert caught.value.code == "nothing-to-fit"
    assert "too negative" in str(caught.value)


def test_weights_of_a_selection_are_those_of_its_samples():
    table = tabulated(GRIDS["in/out"], models.create("ward", **TRUTHS["ward"]))
    select = Select(theta_i_max_deg=40.0)
    data = usable(table, "absolute", select, weighting="solid_angle")
    assert np.square(data.weight).mean() == pytest.approx(1.0)
    wi = data.pair[2]
    assert np.average(wi, weights=np.square(data.weight[:, 0])) == pytest.approx(
        (1 + np.cos(np.deg2rad(41.25))) / 2, rel=0.01
    )
