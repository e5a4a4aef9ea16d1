"""Mixed parameters, coefficients that are not free, anisotropic surfaces, and the energy of a fit."""

from __future__ import annotations

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import fitter
from fitter import FitSpec, ModelSpec, SpecError, models
from fitter.fitting import energy, separable
from fitter.fitting.curve import best_on_curve
from fitter.fitting.layout import channel_groups, layout
from fitter.fitting.order import in_order, order_axes, ordered_axes
from fitter.fitting.polish import normal_equations
from fitter.fitting.usable import usable
from fitter.spec import Select
from tests.fitting.conftest import TRUTHS, scattered
from tests.fitting.test_fit import pull

MIXED = ModelSpec(family="lafortune", per_channel=("n",))
#: Samples of a table that is fitted here: a search takes as much longer as there are more.
N = 1000
GLOSS = {"kd": [0.1, 0.2, 0.3], "ks": [0.05, 0.06, 0.07]}
NEW = {
    "full": ("oren_nayar:full", {"rho": [0.3, 0.6, 0.9], "sigma": 0.5}),
    "eon": ("oren_nayar:eon", {"rho": [0.3, 0.6, 0.9], "sigma": 0.5}),
    "ward": ("ward:anisotropic", {**GLOSS, "alpha_x": 0.1, "alpha_y": 0.3, "psi": 0.4}),
    # The azimuth at the end of its half turn.
    "turned": ("ward:anisotropic", {**GLOSS, "alpha_x": 0.1, "alpha_y": 0.3, "psi": 1.57}),
    # alpha shared, the index of the metal each channel's own; ks, eta and kappa lie in a valley.
    "conductor": (
        "torrance_sparrow:conductor",
        {"kd": 0.05, "ks": 1.0, "alpha": 0.2, "eta": [0.2, 0.9, 1.5], "kappa": [3.0, 2.5, 2.0]},
    ),
    "mixed": (MIXED, {"kd": [0.1, 0.2, 0.3], "ks": 0.2, "gamma": 0.8, "n": [20.0, 30.0, 40.0]}),
    "lafortune": (
        "lafortune:anisotropic",
        {
            "kd": [0.1, 0.2], "ks": 0.2, "gamma": [0.75, 0.8], "n": [20.0, 30.0], "delta": [0.6, 0.65],
            "psi": 0.5,
        },
    ),
}  # fmt: skip


@cache
def fitted(name: str) -> tuple[models.ReflectanceModel, fitter.Table, fitter.FitResult]:
    """A truth, its table and its fit: the same for all tests that look at one."""
    spec, values = NEW[name]
    truth = models.create(spec, **values)
    table = scattered(truth, seed=1, n=N, azimuths=True)
    return truth, table, fitter.fit(table, truth.spec)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.long] * (n in ("conductor", "lafortune"))) for n in NEW]
)
def test_recovers_the_truth(name):
    new, _, fit = fitted(name)
    assert fit.status == "converged", fit.message
    z = pull(fit, new)
    assert len(z) == len(fit.labels)
    assert np.abs(z).max() < 5.0


@pytest.mark.long
@pytest.mark.parametrize("name", ["eon", "mixed", "lafortune"])
def test_stated_noise_explains_the_residuals(name):
    spec, values = NEW[name]
    model = models.create(spec, **values)
    fit = fitter.fit(scattered(model, seed=2, n=N, azimuths=True, sigma=True), model.spec)
    assert fit.metrics["chi2_per_dof"] == pytest.approx(1.0, abs=0.15)
    assert np.abs(pull(fit, model)).max() < 5.0


@pytest.mark.long
@pytest.mark.parametrize("name", ["eon", "mixed"])
def test_nlopt_reaches_the_same_optimum(name):
    model, table, ours = fitted(name)
    theirs = fitter.fit(table, model.spec, solver="nlopt")
    assert theirs.metrics["objective"] == pytest.approx(ours.metrics["objective"], rel=1e-6)
    for parameter, estimate in ours.parameters.items():
        np.testing.assert_allclose(theirs.parameters[parameter].value, estimate.value, rtol=2e-3, atol=1e-6)


@pytest.mark.long
def test_uncertainties_of_mixed_parameters_cover_at_their_rate():
    model = models.create(MIXED, **NEW["mixed"][1])
    # Two starts find this optimum: the search is a third of the time less, and not what is tested.
    tables = (scattered(model, seed=200 + k, n=300) for k in range(40))
    z = np.stack([pull(fitter.fit(table, MIXED, starts=2), model) for table in tables])
    for level, limit in ((0.6827, 1.0), (0.9545, 2.0)):
        assert abs((np.abs(z) < limit).mean() - level) < 4 * np.sqrt(level * (1 - level) / 40)


def test_labels_and_covariance_of_a_mixed_fit():
    model = models.create(MIXED, **NEW["mixed"][1])
    fit = fitter.fit(scattered(model, seed=4, n=N), MIXED)
    assert fit.labels[6:] == ("gamma", "n[R]", "n[G]", "n[B]")
    assert fit.parameters["gamma"].value.shape == ()
    assert fit.parameters["n"].value.shape == (3,)
    assert len(fit.evidence["groups"]) == 1
    # Channels are tied by what they share: their own parameters are correlated.
    assert fit.covariance[7, 8] != 0.0
    again = fitter.FitResult.from_dict(fit.to_dict())
    assert again.to_dict() == fit.to_dict()


@pytest.mark.long
def test_bounds_and_fixed_hold_in_every_channel():
    model = models.create(MIXED, **NEW["mixed"][1])
    table = scattered(model, seed=5, n=N)
    fit = fitter.fit(table, MIXED, bounds={"n": (25.0, 35.0)})
    assert fit.parameters["n"].at_bound == ("lower", None, "upper")
    np.testing.assert_allclose(fit.parameters["n"].value[[0, 2]], [25.0, 35.0])
    fixed = fitter.fit(table, MIXED, fixed={"n": 30.0})
    assert fixed.parameters["n"].value.shape == ()
    assert fixed.labels[6:] == ("gamma",)


def test_channels_with_nothing_in_common_are_solved_apart():
    request = FitSpec(model=MIXED, fixed={"gamma": 0.8})
    assert channel_groups(request, 3) == [[0], [1], [2]]
    assert not layout(request, 3).mixed
    assert channel_groups(FitSpec(model=MIXED), 3) == [[0, 1, 2]]
    assert layout(FitSpec(model=MIXED), 3).where.tolist() == [[0, 1], [0, 2], [0, 3]]
    assert not layout(FitSpec(model=MIXED), 1).mixed


@pytest.mark.parametrize("name", ["full", "eon", "mixed", "lafortune", "ward"])
@pytest.mark.parametrize("metric", ["cosine", "cbrt"])
def test_normal_equations_hold_the_gradient(name, metric):
    spec, values = NEW[name]
    model = models.create(spec, **values)
    data = usable(scattered(model, seed=6, n=200, azimuths=True), metric, Select())
    c = len(data.channels)
    places = layout(FitSpec(model=model.spec), c)
    blocks = data.blocks(list(range(c)))
    rng = np.random.default_rng(0)
    low, high = places.box
    u = low + (high - low) * rng.uniform(0.4, 0.6, len(low))
    inner = np.asarray(separable.inner(places, jnp.asarray(u), *(jnp.asarray(a) for a in (
        blocks[0].pair, blocks[0].y.T, blocks[0].weight.T))))  # fmt: skip
    p = np.concatenate([u, 0.9 * inner.reshape(-1) + 0.01])
    here = normal_equations(places, metric, data.floor, p, blocks)
    for k in range(len(p)):
        h = 1e-6 * max(1.0, abs(p[k]))
        sides = [
            normal_equations(places, metric, data.floor, p + s * h * np.eye(len(p))[k], blocks).objective
            for s in (1, -1)
        ]
        slope = (sides[0] - sides[1]) / (2 * h)
        assert -2 * here.rhs[k] == pytest.approx(slope, rel=1e-4, abs=1e-7 * here.objective)


def _coefficients(places, u, rho):
    return np.asarray(places.coefficients(u, jnp.array([[rho]])))[:, 0]


@pytest.mark.parametrize("name", ["oren_nayar:full", "oren_nayar:eon"])
def test_inner_problem_on_the_curve_is_scipys(name):
    places = layout(FitSpec(model=ModelSpec.parse(name)))
    upper = float(places.inner_box[1][0])
    solve = jax.jit(partial(best_on_curve, places))
    u = jnp.array([0.6])
    rng = np.random.default_rng(0)
    for scale in (1e-12, 0.1, 1.0, 2.0):
        a = rng.uniform(0.0, 1.0, (30, 2))
        rho = scale * rng.uniform(0.1, 0.6)

        y = a @ _coefficients(places, u, rho) + 0.01 * scale * rng.standard_normal(30)
        found = float(solve(u, jnp.asarray(a.T @ a), jnp.asarray(a.T @ y))[0])

        def misfit(rho, a=a, y=y):
            return float(np.sum((a @ _coefficients(places, u, rho) - y) ** 2))

        # Brent's method sees the objective alone: half the digits.
        expected = minimize_scalar(misfit, bounds=(0, min(upper, 4 * scale)), method="bounded",
                                   options={"xatol": 1e-10 * scale}).x  # fmt: skip
        assert found == pytest.approx(expected, rel=1e-6)
        assert misfit(found) <= misfit(expected) * (1 + 1e-12)
    # Values that no albedo reaches, and values below 0.
    big = float(solve(u, jnp.eye(2), jnp.array([50.0, 1e4]))[0])
    assert big == pytest.approx(float(places.inner_box[1][0])) or big > 1
    assert float(solve(u, jnp.eye(2), jnp.array([-1.0, -1.0]))[0]) == 0.0


def test_reduced_gradient_on_the_curve_is_the_finite_difference():
    model = models.create("oren_nayar:eon", **NEW["eon"][1])
    table = scattered(model, seed=5, n=300)
    places = layout(FitSpec(model=model.spec))
    pair, value = jnp.concatenate([table.wi.T, table.wo.T]), jnp.asarray(table.value)

    def residuals(u):
        return separable.residuals(places, u, pair, value, jnp.ones_like(value))

    u, h = jnp.array([0.3]), 1e-6
    numeric = (residuals(u + h) - residuals(u - h)) / (2 * h)
    np.testing.assert_allclose(jax.jacfwd(residuals)(u)[..., 0], numeric, atol=1e-7)


@pytest.mark.long
def test_an_albedo_above_its_bound_is_on_the_bound():
    model = models.create("oren_nayar:eon", rho=[0.99, 0.5], sigma=0.3)
    exact = scattered(model, seed=1, noise=0.0)
    table = fitter.Table(wi=exact.wi, wo=exact.wo, value=1.2 * exact.value)
    fit = fitter.fit(table, "oren_nayar:eon")
    assert fit.parameters["rho"].at_bound == ("upper", None)
    assert float(fit.parameters["rho"].value[0]) == 1.0


# Anisotropic surfaces -----------------------------------------------------------------------------------


@pytest.mark.parametrize("psi", [-3.0, -1.571, 0.0, 1.4, 2.5])
def test_every_azimuth_comes_out_in_the_half_turn(psi):
    model = models.create("ward:anisotropic", **{**GLOSS, "alpha_x": 0.3, "alpha_y": 0.1, "psi": psi})
    fit = fitter.fit(scattered(model, seed=7, n=N, azimuths=True), "ward:anisotropic")
    found = {name: float(np.atleast_1d(e.value)[0]) for name, e in fit.parameters.items()}
    assert found["alpha_x"] == pytest.approx(0.1, rel=0.01)
    assert found["alpha_y"] == pytest.approx(0.3, rel=0.01)
    assert -np.pi / 2 <= found["psi"] < np.pi / 2
    assert abs(np.sin(found["psi"] - psi - np.pi / 2)) < 0.01
    u = fit.parameters["alpha_x"].standard_uncertainty
    assert 0 < float(u) < float(fit.parameters["alpha_y"].standard_uncertainty)


@pytest.mark.parametrize("name", ["ward:anisotropic", "lafortune:2:anisotropic"])
@pytest.mark.parametrize("channels", [1, 2])
def test_order_changes_labels_alone(name, channels):
    """Values stay, and the normal equations of the ordered vector are those that were reordered."""
    spec = ModelSpec.parse(name)
    places = layout(FitSpec(model=spec), channels)
    data = usable(
        scattered(models.create(spec, kd=0.2, channels=list("ab")[:channels]), seed=8, n=150, azimuths=True),
        "cosine", Select(),
    )  # fmt: skip
    blocks = data.blocks(list(range(channels)))
    low, high = places.box
    rng = np.random.default_rng(3)
    for _ in range(6):
        u = low + (high - low) * rng.uniform(0.05, 0.95, len(low))
        inner = rng.uniform(0.1, 1.0, (2 if name.startswith("ward") else 3, channels))
        p = np.concatenate([u, inner.reshape(-1)])
        before = normal_equations(places, "cosine", data.floor, p, blocks)
        q, turned = order_axes(places, p, before)
        after = normal_equations(places, "cosine", data.floor, q, blocks)
        assert after.objective == pytest.approx(before.objective, rel=1e-9)
        np.testing.assert_allclose(turned.rhs, after.rhs, rtol=1e-6, atol=1e-9 * np.abs(after.rhs).max())
        largest = np.abs(after.matrix).max()
        np.testing.assert_allclose(turned.matrix, after.matrix, rtol=1e-6, atol=1e-9 * largest)
        again = in_order(places, p)
        assert normal_equations(
            places, "cosine", data.floor, again, blocks
        ).objective == pytest.approx(before.objective, rel=1e-9)  # fmt: skip
        np.testing.assert_allclose(in_order(places, again), again, atol=1e-12)
        centre = np.where(np.arange(len(u)) == len(u) - 1, 2.0, u)
        near = ordered_axes(places, u, centre)
        assert abs(near[-1] - 2.0) <= np.pi / 2


def test_azimuth_of_an_isotropic_surface_is_not_identified():
    model = models.create("ward", **TRUTHS["ward"])
    for azimuths in (True, False):
        table = scattered(model, seed=9, n=N, azimuths=azimuths)
        fit = fitter.fit(table, "ward:anisotropic")
        assert fit.status == "not_identified"
        assert "psi" in fit.message
        assert np.isnan(fit.parameters["psi"].standard_uncertainty)
        for name in ("alpha_x", "alpha_y"):
            e = fit.parameters[name]
            assert abs(float(e.value) - 0.15) < 5 * float(e.standard_uncertainty)
        said = any("the table is isotropic and this model is not" in w for w in fit.warnings)
        assert said == (table.symmetry == "isotropic")


def test_the_warning_of_anisotropic_tables_knows_the_model():
    _, table, fit = fitted("ward")
    assert table.symmetry == "anisotropic"
    assert any("an average over azimuths" in w for w in fitter.fit(table, "ward").warnings)
    assert not any("azimuth" in w for w in fit.warnings)


def test_an_isotropic_table_is_turned_for_anisotropic_models_alone():
    table = scattered(models.create("ward"), seed=11, n=500)
    plain = usable(table, "cosine", Select())
    turned = usable(table, "cosine", Select(), anisotropic=True)
    np.testing.assert_array_equal(plain.pair.T[:, :3], table.wi)
    phi = np.arctan2(turned.pair[1], turned.pair[0])
    assert np.histogram(phi, bins=8, range=(-np.pi, np.pi))[0].min() > 50
    for kind in (plain, turned):
        np.testing.assert_allclose((kind.pair[:3] * kind.pair[3:]).sum(0), (table.wi * table.wo).sum(1))


# Energy and requests ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spec", "values"),
    [
        ("ward:bounded", {"kd": 0.2, "ks": 0.3, "alpha": 0.02}),
        ("ward:anisotropic", {"kd": 0.1, "ks": 0.3, "alpha_x": 0.05, "alpha_y": 0.4, "psi": 0.3}),
        ("torrance_sparrow", {"kd": 0.1, "ks": 0.8, "f0": 0.9, "alpha": 0.3}),
        ("lafortune:2", TRUTHS["lafortune:2"]),
        ("oren_nayar", {"rho": 0.8, "sigma": 0.4}),
    ],
)
def test_the_quick_albedo_is_the_albedo(spec, values):
    model = models.create(spec, **values)
    found = energy.largest_albedo(model, (0.0, 1.4))
    theta, phi = found.theta_i, found.phi_i
    wi = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    assert found.value == pytest.approx(float(np.asarray(model.albedo(wi))[found.channel]), rel=3e-3)
    assert not found.exceeds


def test_a_fit_that_reflects_more_than_arrives_says_how_much():
    model = models.create("ward:duer", kd=[0.3, 0.5], ks=[0.2, 0.8], alpha=0.5)
    table = scattered(model, seed=12)
    fit = fitter.fit(table, "ward:duer")
    largest = fit.evidence["largest_albedo"]
    theta = np.deg2rad(largest["theta_i_deg"])
    exact = np.asarray(fit.model.albedo([np.sin(theta), 0.0, np.cos(theta)]))
    assert largest["channel"] == "c1"
    assert largest["value"] == pytest.approx(exact[1], rel=1e-6)
    assert largest["value"] > 1
    where = f"{largest['theta_i_deg']:.0f} deg, channel c1: more than arrives"
    said = f"reflects {largest['value']:.3g} of the light at theta_i = {where}"
    assert said in fit.warnings
    # A dimmer surface of the same shape is no offender.
    dim = fitter.Table(wi=table.wi, wo=table.wo, value=0.5 * table.value)
    fit = fitter.fit(dim, "ward:duer")
    assert fit.evidence["largest_albedo"]["value"] == pytest.approx(0.5 * exact[1], rel=5e-3)
    assert not any("more than arrives" in warning for warning in fit.warnings)


@pytest.mark.parametrize(
    ("model", "settings", "code", "parameter"),
    [
        (ModelSpec(family="lafortune", per_channel=("alpha",)), {}, "unknown-parameter", "per_channel"),
        ("specular", {}, "not-fitted", "model"),
        ("lafortune", {"bounds": {"n": (0.0, 10.0)}}, "bad-bounds", "n"),
        ("ward:anisotropic", {"fixed": {"psi": 7.0}}, "bad-fixed", "psi"),
    ],
)
def test_bad_requests_are_named(model, settings, code, parameter):
    table = scattered(models.create("ward", **TRUTHS["ward"]), seed=1, n=50)
    with pytest.raises(SpecError) as caught:
        fitter.fit(table, model, **settings)
    assert caught.value.code == code
    assert caught.value.parameter == parameter
    assert caught.value.remedy


def test_deltas_of_channels_that_share_gamma_are_not_exchanged() -> None:
    """Gamma would have to turn with one of them and to stay with the other."""
    values = {"kd": [0.2, 0.3], "ks": 0.1, "gamma": 0.7, "delta": 0.3, "n": 8.0, "psi": 0.2}
    model = models.create("lafortune:anisotropic", **values)
    table = scattered(model, seed=1, n=300, sigma=True, azimuths=True)
    fit = fitter.fit(table, ModelSpec(family="lafortune", anisotropic=True, per_channel=("delta",)))
    np.testing.assert_allclose(fit.parameters["delta"].value, 0.3, atol=0.02)
