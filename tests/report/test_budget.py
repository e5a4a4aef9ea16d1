"""The uncertainty budget against refits of shifted and scaled tables, and the propagation against models."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

import fitter
from fitter import directions, models
from fitter.metadata import Metadata
from fitter.posterior import offset_sensitivities, robust
from fitter.posterior.offsets import ANGLES, shifted, tangents
from fitter.report.budget import LEVEL, OFFSETS, budget
from fitter.report.fitted import Fitted
from fitter.report.propagation import section, tolerance
from tests.fitting.conftest import scattered

SCALE, ANGLE = 0.02, np.deg2rad(0.1)


def _table(like: fitter.Table, pair: np.ndarray | None = None, factor: float = 1.0) -> fitter.Table:
    wi, wo = (like.wi, like.wo) if pair is None else (pair[:3].T, pair[3:].T)
    assert like.sigma is not None
    return fitter.Table(
        wi=wi, wo=wo, value=factor * like.value, sigma=factor * like.sigma,
        metadata=Metadata(scale_uncertainty=SCALE, angle_uncertainty=ANGLE), negatives="keep",
    )  # fmt: skip


@pytest.fixture(scope="module")
def found() -> Any:
    model = models.create("ward", kd=0.2, ks=0.1, alpha=0.2)
    table = _table(scattered(model, seed=1, n=300, noise=0.05, sigma=True))
    fit = fitter.fit(table, "ward")
    offsets = offset_sensitivities(table, fit)
    fitted = Fitted.of(table, fit)
    return table, fit, offsets, fitted, budget(fitted, robust(table, fit), offsets)


def _shifted(pair: np.ndarray, angle: int, offset: float, *, signed: bool) -> np.ndarray:
    return np.asarray(shifted(pair, tangents(pair, signed=signed), offset * np.eye(3)[angle]))


@pytest.mark.parametrize("k", range(3))
def test_sensitivities_are_those_of_refits_of_shifted_tables(found: Any, k: int) -> None:
    table, fit, offsets, _, _ = found
    pair, step = np.concatenate([table.wi.T, table.wo.T]), 1e-3
    ends = []
    for side in (1, -1):
        moved = _table(table, _shifted(pair, k, side * step, signed=False))
        ends.append(Fitted.of(moved, fitter.fit(moved, "ward")).estimates)
    u = np.sqrt(np.diagonal(fit.covariance))
    for j, label in enumerate(fit.labels):
        refitted = (ends[0][label] - ends[1][label]) / (2 * step)
        # A hundredth of u for a degree is beneath notice.
        assert offsets[label][k] == pytest.approx(refitted, rel=2e-3, abs=0.01 * u[j] / np.deg2rad(1.0))


def test_shifts_are_those_of_angles() -> None:
    theta_i, theta_o, phi = np.array([0.3, 0.9, 0.5]), np.array([0.4, 1.1, 0.7]), np.array([np.pi, 2.0, 0.0])
    pair = np.concatenate([
        directions.vector_from_spherical(theta_i, 0.0).T, directions.vector_from_spherical(theta_o, phi).T
    ])  # fmt: skip
    for k, steps in enumerate(np.eye(3) * 0.01):
        wi = directions.vector_from_spherical(theta_i + steps[0], 0.0)
        wo = directions.vector_from_spherical(theta_o + steps[1], phi + steps[2])
        moved = _shifted(pair, k, 0.01, signed=False)
        np.testing.assert_allclose(moved, np.concatenate([wi.T, wo.T]), atol=1e-14)
    # On an arm in the plane the angle on the side of the light gets smaller.
    signed = _shifted(pair, 1, 0.01, signed=True)
    after, _ = directions.spherical_from_vector(signed[3:].T)
    np.testing.assert_allclose(after[[0, 2]] - theta_o[[0, 2]], [0.01, -0.01], atol=1e-12)


def test_the_scale_is_that_of_a_scaled_table(found: Any) -> None:
    table, _, _, fitted, budgeted = found
    scaled = _table(table, factor=1.0 + SCALE)
    after = Fitted.of(scaled, fitter.fit(scaled, "ward")).estimates
    for row in budgeted.section["rows"]:
        moved = after[row["label"]] - fitted.estimates[row["label"]]
        u = row["components"]["scale"]["standard_uncertainty"]
        assert u == pytest.approx(abs(moved), rel=1e-3, abs=1e-7)


def test_a_row_adds_up(found: Any) -> None:
    table, fit, offsets, _, budgeted = found
    robust_u = robust(table, fit).standard_uncertainty
    for k, row in enumerate(budgeted.section["rows"]):
        parts = {name: one["standard_uncertainty"] for name, one in row["components"].items()}
        noise = math.sqrt(fit.covariance[k, k])
        assert parts["noise"] == pytest.approx(noise)
        for j, name in enumerate(OFFSETS):
            assert parts[name] == pytest.approx(abs(offsets[row["label"]][j]) * ANGLE)
        rest = math.sqrt(max(0.0, robust_u[row["label"]] ** 2 - noise**2))
        assert parts["discrepancy"] == pytest.approx(rest, abs=1e-12)
        u = math.sqrt(sum(v * v for v in parts.values()))
        assert row["combined"] == pytest.approx(u)
        scans = robust(table, fit).degrees_of_freedom
        # Welch and Satterthwaite; what is stated has no end of degrees of freedom.
        terms = noise**4 / (len(table) - len(fit.labels)) + rest**4 / scans
        assert row["effective_degrees_of_freedom"] == max(1, math.floor(u**4 / terms))
        k95 = stats.t.ppf(0.5 + 0.5 * LEVEL, row["effective_degrees_of_freedom"])
        assert row["expanded"] == pytest.approx(k95 * u)


def test_what_is_not_stated_is_in_no_number_and_has_its_sensitivity(found: Any) -> None:
    table, fit, offsets, _, _ = found
    bare = fitter.Table(wi=table.wi, wo=table.wo, value=table.value, sigma=table.sigma, negatives="keep")
    section = budget(Fitted.of(bare, fit), None, offsets).section
    assert [one["source"] for one in section["sources"] if one["stated"]] == ["noise"]
    for k, row in enumerate(section["rows"]):
        assert row["combined"] == pytest.approx(math.sqrt(fit.covariance[k, k]))
        assert row["components"]["theta_i"]["text"] == "not stated"
        per_degree = np.deg2rad(offsets[row["label"]][ANGLES.index("theta_i")])
        assert row["components"]["theta_i"]["sensitivity"] == pytest.approx(per_degree)


def test_the_ellipse_holds_its_share_of_the_draws(found: Any) -> None:
    joint = found[4].section["joint"]
    u, r = np.array(joint["u"]), joint["correlation"]
    covariance = np.outer(u, u) * np.array([[1, r], [r, 1]])
    draws = np.random.default_rng(0).multivariate_normal(joint["centre"], covariance, 20_000)
    ring = np.array(joint["ellipse"]).T
    from matplotlib.path import Path

    assert Path(ring).contains_points(draws).mean() == pytest.approx(0.95, abs=0.01)


def test_linear_propagation_is_that_of_finite_differences_and_monte_carlo_agrees(found: Any) -> None:
    _, fit, _, fitted, budgeted = found
    document = section(fitted, budgeted, None, seed=1)
    values, vectors = np.linalg.eigh(budgeted.covariance)
    steps = vectors * np.sqrt(np.maximum(values, 0))
    kd, ks, alpha = (fitted.estimates[label] for label in fit.labels)

    def model(step: np.ndarray) -> models.ReflectanceModel:
        a, b, c = step
        return models.create("ward", kd=kd + a, ks=ks + b, alpha=alpha + c)

    sides = [(model(0.01 * s), model(-0.01 * s)) for s in steps.T]
    for row in [*document["reflectance"], *document["brdf"][::4]]:
        wi = directions.vector_from_spherical(np.deg2rad(row["theta_i_deg"]), 0.0)
        if "theta_o_deg" in row:
            wo = directions.vector_from_spherical(np.deg2rad(row["theta_o_deg"]), np.pi)
            ends = [(a.evaluate(wi, wo), b.evaluate(wi, wo)) for a, b in sides]
        else:
            ends = [(a.albedo(wi), b.albedo(wi)) for a, b in sides]
        u = np.sqrt(sum(float((a - b)[0]) ** 2 for a, b in ends)) / 0.02
        assert row["linear"] == pytest.approx(u, rel=0.01)
        # What the two have in common cancels: 400 draws give u to better than 5 %.
        assert row["monte_carlo"] == pytest.approx(row["linear"], rel=0.1)
        away = np.abs(np.subtract(row["monte_carlo_interval"], row["linear_interval"])).max()
        assert row["validated"] == (away <= row["delta"] * (1 + 1e-9))


def test_tolerance_is_half_of_the_last_digit() -> None:
    # JCGM 101, 7.9.2, example 1: u = 0.000 35 to one digit is 4e-4, its tolerance 5e-5.
    assert tolerance(0.00035) == pytest.approx(0.00005)
    assert tolerance(2.0) == pytest.approx(0.5)
    assert math.isnan(tolerance(0.0))
