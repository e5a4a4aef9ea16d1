"""fit: the truth comes back, both solvers agree, bounds and failures are said."""

from __future__ import annotations

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special
from scipy.optimize import nnls

import fitter
from fitter import FitError, FitSpec, ModelSpec, SpecError, Table, directions, models
from fitter.fitting import separable
from fitter.fitting.layout import layout
from fitter.spec import Select
from tests.evidence.global_optimum import problem
from tests.fitting.conftest import TRUTHS, scattered


def pull(fit: fitter.FitResult, model: models.ReflectanceModel) -> np.ndarray:
    """(estimate - truth)/u of every parameter with a stated uncertainty, as a normal variable: u itself is
    known with so many degrees of freedom."""
    parts = []
    for name, estimate in fit.parameters.items():
        true = np.broadcast_to(np.asarray(model.values[name]), estimate.value.shape)
        t = (estimate.value - true) / estimate.standard_uncertainty
        parts.append(special.ndtri(special.stdtr(estimate.degrees_of_freedom, t)).reshape(-1))
    found = np.concatenate(parts)
    return found[~np.isnan(found)]


@cache
def fitted(name: str, metric: str) -> tuple[Table, fitter.FitResult]:
    """The table of a truth, and its fit: the same for all tests that look at one."""
    truth = models.create(name, **TRUTHS[name])
    table = scattered(truth, seed=1)
    return table, fitter.fit(table, truth.spec, metric=metric)


# Every model is tried with both kinds of metric, of values and of transformed values, two with all metrics.
@pytest.mark.parametrize(
    ("name", "metric"),
    [
        *((name, metric) for name in TRUTHS for metric in ("cosine", "cbrt")),
        *((name, metric) for name in ("ward", "lafortune:2") for metric in ("absolute", "log")),
    ],
)
def test_recovers_the_truth(name, metric):
    truth = models.create(name, **TRUTHS[name])
    fit = fitted(name, metric)[1]
    assert fit.status == "converged", fit.message
    assert fit.uncertainty == "sandwich"
    z = pull(fit, truth)
    assert len(z) >= 2
    assert np.abs(z).max() < 5.0


def test_f13_a_lobe_whose_flank_is_a_few_samples():
    """Problem 20262 of the study of the global optimum: an exhaustive scan ends at 15,603.438."""
    table = problem("ward", 20_262).table
    used = int(table.mask.sum())
    found = fitter.fit(table, "ward")
    assert found.metrics["objective"] * used == pytest.approx(15_603.438, abs=0.01)
    hurried = fitter.fit(table, "ward", starts=6)
    assert hurried.metrics["objective"] * used > 15_650


def test_stated_noise_is_the_default_metric_and_explains_the_residuals(truth):
    table = scattered(truth, seed=2, sigma=True)
    fit = fitter.fit(table, truth.spec)
    assert fit.uncertainty == "curvature"
    assert fit.metrics["chi2_per_dof"] == pytest.approx(1.0, abs=0.15)
    assert np.abs(pull(fit, truth)).max() < 5.0


@pytest.mark.long
@pytest.mark.parametrize(("name", "metric"), [*((name, "cosine") for name in TRUTHS), ("ward", "cbrt")])
def test_nlopt_reaches_the_same_optimum(name, metric):
    table, ours = fitted(name, metric)
    theirs = fitter.fit(table, ours.spec.model, metric=metric, solver="nlopt")
    assert theirs.metrics["objective"] == pytest.approx(ours.metrics["objective"], rel=1e-6)
    for parameter, estimate in ours.parameters.items():
        np.testing.assert_allclose(theirs.parameters[parameter].value, estimate.value, rtol=2e-3, atol=1e-6)


@pytest.mark.long
def test_standard_uncertainties_cover_at_their_rate():
    """60 simulated tables: 68 % and 95 % intervals within binomial bands of 4 standard deviations."""
    model = models.create("ward", **TRUTHS["ward"])
    z = np.stack([pull(fitter.fit(scattered(model, seed=100 + k, n=400), "ward"), model) for k in range(60)])
    for level, limit in ((0.6827, 1.0), (0.9545, 2.0)):
        inside = (np.abs(z) < limit).mean()
        # Seven correlated parameters a table: the tables are what is independent.
        assert abs(inside - level) < 4 * np.sqrt(level * (1 - level) / 60)


def test_inner_problem_is_scipys_nnls():
    rng = np.random.default_rng(0)
    solve = jax.jit(separable.non_negative)
    for k in (1, 2, 3, 4):
        for _ in range(40):
            a, y = rng.standard_normal((30, k)), rng.standard_normal(30)
            expected, _ = nnls(a, y)
            found = np.asarray(solve(jnp.asarray(a.T @ a), jnp.asarray(a.T @ y)))
            np.testing.assert_allclose(found, expected, atol=1e-10)


def test_inner_problem_survives_equal_columns():
    a = np.ones((10, 3))
    b = np.asarray(separable.non_negative(jnp.asarray(a.T @ a), jnp.asarray(a.T @ np.full(10, 2.0))))
    assert np.isfinite(b).all()
    assert b.sum() == pytest.approx(2.0, rel=1e-6)


def test_reduced_gradient_is_the_finite_difference():
    model = models.create("torrance_sparrow", **TRUTHS["torrance_sparrow"])
    table = scattered(model, seed=5, n=300)
    places = layout(FitSpec(model=ModelSpec.parse("torrance_sparrow")))
    pair, value = jnp.concatenate([table.wi.T, table.wo.T]), jnp.asarray(table.value)
    weight = jnp.ones_like(value)

    def objective(u):
        return jnp.sum(jnp.square(separable.residuals(places, u, pair, value, weight)))

    u, h = jnp.array([-1.2]), 1e-5
    numeric = (objective(u + h) - objective(u - h)) / (2 * h)
    assert float(jax.grad(objective)(u)[0]) == pytest.approx(float(numeric), rel=1e-5)


def test_local_solves_end_where_they_say():
    """After each step: no solve may end at the point before its last."""
    model = models.create("torrance_sparrow", **TRUTHS["torrance_sparrow"])
    table = scattered(model, seed=5, n=300)
    places = layout(FitSpec(model=ModelSpec.parse("torrance_sparrow")))
    pair, value = jnp.concatenate([table.wi.T, table.wo.T]), jnp.asarray(table.value)
    weight, start = jnp.ones_like(value), np.array([[-1.2]])
    ends = [separable.solve_many(places, start, pair, value, weight, steps=steps) for steps in (1, 2, 60)]
    assert float(ends[0][0][0, 0]) == pytest.approx(-1.2)
    assert float(ends[1][1][0]) < 0.999 * float(ends[0][1][0])
    for u, objective, inner in ends:
        r = separable.residuals(places, u[0], pair, value, weight)
        assert float(objective[0]) == pytest.approx(float(jnp.sum(r * r)), rel=1e-9)
        expected = separable.inner(places, u[0], pair, value, weight)
        np.testing.assert_allclose(inner[0], expected, rtol=1e-9, atol=1e-12)


@pytest.mark.long
def test_fixed_and_bounds_are_kept():
    model = models.create("ward", **TRUTHS["ward"])
    table = scattered(model, seed=6)
    fixed = fitter.fit(table, "ward", fixed={"alpha": 0.2})
    assert float(fixed.parameters["alpha"].value) == 0.2
    assert np.isnan(fixed.parameters["alpha"].standard_uncertainty)
    bounded = fitter.fit(table, "ward", bounds={"alpha": (0.2, 0.5)})
    assert float(bounded.parameters["alpha"].value) == pytest.approx(0.2)
    assert bounded.parameters["alpha"].at_bound == ("lower",)
    assert any("alpha is on its lower bound" in warning for warning in bounded.warnings)


def test_selection_of_angles_and_channels():
    model = models.create("ward", **TRUTHS["ward"])
    table = scattered(model, seed=7)
    fit = fitter.fit(table, "ward", select=Select(theta_i_max_deg=40.0, channels=("G",)))
    assert fit.model.channels == ("G",)
    assert fit.cost["samples"] < len(table)
    assert fit.parameters["kd"].value == pytest.approx([0.2], rel=0.05)
    assert any("theta_i beyond 40 deg" in warning for warning in fit.warnings)


def test_shared_exponents_for_lafortune():
    model = models.create("lafortune", kd=[0.1, 0.2, 0.3], ks=0.2, gamma=0.8, n=30.0)
    table = scattered(model, seed=8)
    fit = fitter.fit(table, ModelSpec(family="lafortune", per_channel=()))
    assert fit.parameters["n"].value.shape == ()
    assert np.abs(pull(fit, model)).max() < 5.0


def test_lobes_are_ordered_from_broad_to_narrow():
    model = models.create("lafortune:2", **TRUTHS["lafortune:2"])
    for seed in range(4):
        fit = fitter.fit(scattered(model, seed=9), "lafortune:2", seed=seed)
        assert fit.parameters["n_1"].value[()] < fit.parameters["n_2"].value[()]


def test_same_seed_same_fit_and_round_trip(tmp_path):
    model = models.create("lafortune", **TRUTHS["lafortune"])
    table = scattered(model, seed=10)
    first, again = fitter.fit(table, "lafortune", seed=3), fitter.fit(table, "lafortune", seed=3)
    for name in first.parameters:
        np.testing.assert_array_equal(first.parameters[name].value, again.parameters[name].value)
    first.save(tmp_path / "fit.json")
    read = fitter.load_fit(tmp_path / "fit.json")
    assert read.spec == first.spec
    assert read.to_dict() == first.to_dict()


def test_fits_on_the_compressed_table():
    model = models.create("ward", **TRUTHS["ward"])
    table = scattered(model, seed=11)
    small = fitter.compress(table, 0.01)
    fit, whole = fitter.fit(small, "ward"), fitter.fit(table, "ward")
    assert fit.table["compressed"]["tolerance"] == 0.01
    for name, estimate in whole.parameters.items():
        shift = np.abs(fit.parameters[name].value - estimate.value) / estimate.standard_uncertainty
        assert shift.max() < 2.0


@pytest.mark.parametrize("n", [1, 2, 5])
def test_too_few_samples_is_a_typed_failure(n):
    model = models.create("torrance_sparrow", kd=0.1)
    table = scattered(model, seed=12, n=max(n, 2))
    table = Table(wi=table.wi[:n], wo=table.wo[:n], value=table.value[:n])
    with pytest.raises(FitError) as caught:
        fitter.fit(table, "lafortune:3")
    assert caught.value.code == "too-few-samples"
    assert caught.value.remedy


def test_all_zero_table_is_a_typed_failure():
    wi = np.tile([[0.0, 0.0, 1.0]], (20, 1))
    theta = np.linspace(0, 1.4, 20)
    wo = np.stack([np.sin(theta), np.zeros(20), np.cos(theta)], axis=1)
    with pytest.raises(FitError, match="all values are zero"):
        fitter.fit(Table(wi=wi, wo=wo, value=np.zeros(20)), "ward")


@pytest.mark.parametrize("name", ["ward", "torrance_sparrow", "lafortune", "oren_nayar"])
def test_constant_table_leaves_the_lobe_open_and_says_so(name):
    model = models.create("ward:duer", kd=[0.3, 0.3, 0.3], ks=0.0)
    table = scattered(model, seed=13, noise=0.0)
    fit = fitter.fit(table, name)
    total = np.asarray(fit.model.evaluate(table.wi, table.wo))
    np.testing.assert_allclose(total, table.value, rtol=1e-4)
    assert fit.status in ("not_identified", "converged")
    stated = fit.parameters["sigma" if name == "oren_nayar" else "ks"]
    assert (
        stated.at_bound[0] == "lower"
        or not np.isfinite(stated.standard_uncertainty).all()
        or (fit.metrics["rmse"] < 1e-4)
    )


def test_one_incidence_fits_and_warns():
    model = models.create("ward", **TRUTHS["ward"])
    rng = np.random.default_rng(1)
    wi = np.tile([[0.6, 0.0, 0.8]], (300, 1))
    wo = rng.standard_normal((300, 3))
    wo[:, 2] = np.abs(wo[:, 2]) + 0.1
    wo /= np.linalg.norm(wo, axis=1, keepdims=True)
    fit = fitter.fit(Table(wi=wi, wo=wo, value=np.asarray(model.evaluate(wi, wo))), "ward")
    assert any("one incidence" in warning for warning in fit.warnings)


@pytest.mark.parametrize(
    ("settings", "code"),
    [
        ({"metric": "measurement"}, "metric-needs-sigma"),
        ({"metric": "vibes"}, "bad-spec"),
        ({"fixed": {"kd": 0.1}}, "bad-fixed"),
        ({"fixed": {"alpha": 99.0}}, "bad-fixed"),
        ({"bounds": {"alpha": (0.5, 0.2)}}, "bad-bounds"),
        ({"bounds": {"n": (1.0, 2.0)}}, "bad-bounds"),
        ({"select": Select(channels=("X",))}, "unknown-channel"),
    ],
)
def test_bad_requests_are_named(settings, code):
    table = scattered(models.create("ward", **TRUTHS["ward"]), seed=1, n=50)
    with pytest.raises(SpecError) as caught:
        fitter.fit(table, "ward", **settings)
    assert caught.value.code == code
    assert caught.value.remedy


def test_values_of_any_scale():
    """The same table in other units of value: parameters scale, the roughness does not move."""
    model = models.create("ward", **TRUTHS["ward"])
    table = scattered(model, seed=14)
    reference = fitter.fit(table, "ward")
    for scale in (1e-12, 1e12):
        fit = fitter.fit(Table(wi=table.wi, wo=table.wo, value=table.value * scale), "ward")
        for name, unit in (("alpha", 1.0), ("kd", scale), ("ks", scale)):
            expected = reference.parameters[name].value * unit
            np.testing.assert_allclose(fit.parameters[name].value, expected, rtol=1e-5)


def test_progress_can_stop_a_fit():
    from fitter.progress import Cancelled

    def stop(share, what):
        if share > 0:
            raise Cancelled

    with pytest.raises(Cancelled):
        fitter.fit(scattered(models.create("ward"), seed=1, n=100), "ward", progress=stop)


def nearly_lambertian(seed: int) -> Table:
    rng = np.random.default_rng(seed)
    theta_i, theta_o = np.deg2rad(rng.uniform(0, 80, (2, 400)))
    wi = directions.vector_from_spherical(theta_i, 0.0)
    wo = directions.vector_from_spherical(theta_o, rng.uniform(0, 2 * np.pi, 400))
    return Table(wi=wi, wo=wo, value=0.1 * (1 + 0.02 * rng.standard_normal(400)))


@pytest.mark.parametrize("seed", range(4))
def test_a_lobe_between_the_samples_is_never_called_determined(seed):
    """Noise on a flat table: the best lobe may be one that only a few samples see, of any strength."""
    fit = fitter.fit(nearly_lambertian(seed), "torrance_sparrow")
    ks = float(fit.parameters["ks"].value[0])
    if ks > 1:
        assert fit.status == "not_identified"
        assert np.isnan(fit.parameters["ks"].standard_uncertainty).all()
        assert "ks" in fit.message
    assert fit.parameters["kd"].value == pytest.approx([0.1 * np.pi], rel=0.01)


@pytest.mark.parametrize(("largest", "sigma"), [(1e300, None), (1e-300, None), (1.0, 1e-300)])
def test_absurd_values_are_a_typed_failure(largest, sigma):
    table = nearly_lambertian(0)
    value = table.value.copy()
    value[3] = largest
    if largest < 1:
        value *= 1e-300
    given = None if sigma is None else np.full_like(value, sigma)
    with pytest.raises(FitError) as caught:
        fitter.fit(Table(wi=table.wi, wo=table.wo, value=value, sigma=given), "ward")
    assert caught.value.code == "values-out-of-range"


@pytest.mark.parametrize("scale", [1.0, 1e-9, 1e-30, 1e30])
def test_bounds_are_judged_whatever_the_scale(scale):
    exact = models.create("ward", kd=0.2, ks=0.0)
    table = scattered(exact, seed=1, noise=0.0)
    flat = fitter.fit(Table(wi=table.wi, wo=table.wo, value=table.value * scale), "ward")
    assert flat.parameters["ks"].at_bound == ("lower",)
    assert flat.status == "not_identified"
    glossy = scattered(models.create("ward", kd=0.2, ks=0.1, alpha=0.2), seed=1)
    found = fitter.fit(Table(wi=glossy.wi, wo=glossy.wo, value=glossy.value * scale), "ward")
    assert found.status == "converged"
    assert found.parameters["ks"].at_bound == (None,)


def test_an_isotropic_model_of_an_anisotropic_table_says_so():
    table = nearly_lambertian(0)
    other = Table(wi=table.wi, wo=table.wo, value=table.value, symmetry="anisotropic")
    assert any("anisotropic" in warning for warning in fitter.fit(other, "ward").warnings)


def test_an_albedo_above_one_is_said():
    table = nearly_lambertian(0)
    fit = fitter.fit(Table(wi=table.wi, wo=table.wo, value=10 * table.value), "oren_nayar")
    assert any("more than arrives" in warning for warning in fit.warnings)


@pytest.mark.parametrize("name", ["lafortune:²", "lafortune:0", "lafortune:9", "ward:2", "ward:ggx", ""])
def test_short_names_that_name_nothing(name):
    with pytest.raises(SpecError):
        ModelSpec.parse(name)


def test_every_short_name_reads_back():
    from tests.models import MODELS

    for name in MODELS:
        assert ModelSpec.parse(name).name == name


def test_channels_of_a_selection_are_distinct_and_some():
    for channels in ((), ("G", "G")):
        with pytest.raises(SpecError):
            fitter.fit(nearly_lambertian(0), "ward", select={"channels": channels})
    with pytest.raises(SpecError, match="both fixed and bounded"):
        fitter.fit(nearly_lambertian(0), "ward", fixed={"alpha": 0.1}, bounds={"alpha": (0.2, 0.3)})
