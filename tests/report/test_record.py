"""The record of a report: what it says, and that nothing makes it fail."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fitter
from fitter import directions, models
from fitter.compression import compress
from fitter.errors import SpecError
from fitter.fitting.result import Estimate, FitResult
from fitter.posterior import Robust
from fitter.report import Report, build, load_report
from fitter.report.parameters import scale_sensitivity
from fitter.spec import FAMILIES, FitSpec, Select
from fitter.table import Table
from tests.report.conftest import MakeFit, MakePosterior, MakeTable, strict

SECTIONS = (
    "kind", "version", "created", "title", "fit", "parameters", "robust", "budget", "propagation",
    "correlation", "residuals", "slices", "reflectance", "posterior", "selection", "cost", "table", "quality",
    "comparison", "provenance", "warnings", "verdict",
)  # fmt: skip


def without(fit: FitResult, name: str, bound: str | None = None) -> FitResult:
    """The fit, with no uncertainty stated for a parameter."""
    old = fit.parameters[name]
    blank = np.full_like(old.standard_uncertainty, np.nan)
    entry = replace(old, standard_uncertainty=blank, at_bound=(bound,) * len(old.at_bound))
    covariance = fit.covariance.copy()
    for k, label in enumerate(fit.labels):
        if label.partition("[")[0] == name:
            covariance[k, :] = covariance[:, k] = np.nan
    return replace(fit, parameters={**fit.parameters, name: entry}, covariance=covariance)


def test_the_schema_is_stable(
    make_table: MakeTable, make_fit: MakeFit, make_posterior: MakePosterior
) -> None:
    table = make_table()
    fit = make_fit(table)
    record = strict(build(table, fit, make_posterior(fit)))
    assert tuple(record) == SECTIONS
    assert (record["kind"], record["version"]) == ("brdf-fitter/report", 2)
    assert set(record["parameters"]["rows"][0]) == {
        "name", "channel", "label", "display", "unit", "description", "linear", "lower", "upper", "prior",
        "estimate", "standard_uncertainty", "effective_degrees_of_freedom", "coverage_factor",
        "expanded_uncertainty", "components", "scale_sensitivity",
        "at_bound", "state", "barely_determined", "text", "posterior",
    }  # fmt: skip
    assert set(record["verdict"]) == {
        "level", "headline", "sentences", "reasons", "limits", "thresholds",
    }  # fmt: skip
    assert len(record["verdict"]["sentences"]) == 3
    assert set(record["residuals"]["angles"]) == {"theta_h", "theta_i", "theta_o", "theta_d"}


def test_a_good_fit_is_said_to_be_usable(
    make_table: MakeTable, make_fit: MakeFit, make_posterior: MakePosterior
) -> None:
    table = make_table()
    fit = make_fit(table)
    verdict = strict(build(table, fit, make_posterior(fit)))["verdict"]
    assert verdict["level"] == "good"
    assert verdict["reasons"] == []
    assert "5.0 %" in verdict["sentences"][0]
    assert "U = k u" in verdict["sentences"][1]
    assert "1.0030" in verdict["sentences"][2]


def test_failures_are_said_first(
    make_table: MakeTable, make_fit: MakeFit, make_posterior: MakePosterior
) -> None:
    table = make_table()
    fit = replace(make_fit(table), status="not_converged", message="the last pass still moved")
    posterior = replace(make_posterior(fit), status="not_converged", message="R-hat is 1.4")
    verdict = strict(build(table, fit, posterior))["verdict"]
    assert verdict["level"] == "bad"
    assert "the last pass still moved." in verdict["reasons"][0]
    assert any("R-hat is 1.4." in reason for reason in verdict["reasons"])


@pytest.mark.long
def test_the_choice_of_a_model_is_shown_and_its_verdict_counts(
    make_table: MakeTable, make_fit: MakeFit
) -> None:
    table = make_table()
    ratio = {"ratio": 1.2, "log_standard_error": 0.1, "lower_95": 1.1, "upper_95": 1.3}
    ranked = {
        "model": "ward", "parameters": 7, "error": 0.1, "relative_error": 0.2, "held_out": True,
        "errors_by_fold": [0.1], "against_best": ratio, "as_good": True, "information_criterion": 0.0,
        "status": "converged", "seconds": 1.0,
    }  # fmt: skip
    found = {
        "chosen": "ward", "verdict": "raw_table", "method": "cross_validation", "folds": {},
        "raw_table": None,
        "sentences": ["Of 2 models, ward is chosen.", "No model is good enough, use the raw table."],
        "raw_table_reason": None, "noise_ratio": None, "cost": {"seconds": 1.0},
        "ranking": [ranked, {**ranked, "model": "lambert", "held_out": False, "against_best": None}],
        "not_candidates": [{"model": m, "reason": "no azimuths"} for m in ("a:<b>", "lafortune:2")],
    }  # fmt: skip
    fit = make_fit(table)
    fit = replace(fit, evidence={**fit.evidence, "selection": found})
    report = build(table, fit)
    record = strict(report, drawn=True)
    assert found["sentences"][1] in record["verdict"]["reasons"]
    assert record["selection"]["not_candidates"] == [
        {"models": ["a:<b>", "lafortune:2"], "reason": "no azimuths"}
    ]
    assert "selection" not in record["cost"]["evidence"]
    page = report.html()
    for text in ("How the model was chosen", "1.100 to 1.300", "0.1000 (fitted)", "a:&lt;b&gt;, lafortune:2"):
        assert text in page
    other = replace(fit, evidence={"selection": {**found, "chosen": "lambert"}})
    assert any("chose lambert, not ward" in one for one in build(table, other).record["verdict"]["reasons"])
    assert strict(build(table, make_fit(table)))["selection"] is None


def test_bounds_and_unidentified_parameters_are_put_into_words(
    make_table: MakeTable, make_fit: MakeFit
) -> None:
    table = make_table()
    fit = without(without(make_fit(table), "alpha"), "ks", "lower")
    record = strict(build(table, replace(fit, status="not_identified", message="alpha is open")))
    states = {row["label"]: row["state"] for row in record["parameters"]["rows"]}
    assert states["alpha"] == "not identified"
    assert states["ks[G]"] == "on its lower bound"
    stated = {row["name"] for row in record["parameters"]["rows"] if row["standard_uncertainty"] is not None}
    assert stated == {"kd"}
    text = " ".join([*record["verdict"]["sentences"], *record["verdict"]["reasons"]])
    assert "ks[R], ks[G] and ks[B] lie on a bound" in text
    assert "alpha is not identified by this table" in text
    assert "3 of 7 free parameters" in text


def test_no_uncertainty_at_all(make_table: MakeTable, make_fit: MakeFit) -> None:
    table = make_table()
    fit = make_fit(table)
    for name in fit.parameters:
        fit = without(fit, name)
    record = strict(build(table, replace(fit, status="not_identified")), drawn=True)
    assert record["correlation"]["labels"] == []
    assert record["verdict"]["level"] == "bad"


def test_a_scale_uncertainty_is_a_component_of_the_linear_parameters(
    make_table: MakeTable, make_fit: MakeFit
) -> None:
    table = make_table(scale_uncertainty=0.03, angle_uncertainty=1e-3)
    record = strict(build(table, make_fit(table, u=0.04)))
    rows = {row["label"]: row for row in record["parameters"]["rows"]}
    kd, alpha = rows["kd[R]"], rows["alpha"]
    assert kd["components"]["fit"] == pytest.approx(0.04 * 0.2)
    assert kd["components"]["scale"] == pytest.approx(0.03 * 0.2)
    assert kd["standard_uncertainty"] == pytest.approx(0.05 * 0.2)
    assert kd["expanded_uncertainty"] == pytest.approx(0.1 * 0.2, rel=1e-5)
    assert (kd["effective_degrees_of_freedom"], kd["text"]["factor"]) == (None, "2.00")
    assert kd["text"]["scale"] == "0.0060"
    assert alpha["components"]["scale"] == 0
    assert alpha["standard_uncertainty"] == pytest.approx(0.04 * 0.15)


@pytest.mark.parametrize("family", FAMILIES)
def test_scale_sensitivity_is_that_of_a_table_in_other_units(family: str) -> None:
    model = models.create(family, **({"ks": 0.3, "f0": 0.2} if family == "torrance_sparrow" else {}))
    kind = type(model)
    coefficients = kind.coefficients(model.spec, model.linear, model.nonlinear)
    scaled = kind.linear_from(model.spec, tuple(1.01 * c for c in coefficients), model.nonlinear)
    for name, slope in scale_sensitivity(model).items():
        change = (np.asarray(scaled[name]) - np.asarray(model.linear[name])) / 0.01
        np.testing.assert_allclose(slope, change, rtol=1e-9, atol=1e-12)
        assert name != "f0" or slope == 0


@pytest.mark.parametrize("name", ["oren_nayar:full", "oren_nayar:eon"])
def test_scale_sensitivity_where_the_albedo_enters_twice(name: str) -> None:
    """rho and rho^2 together: a brighter table moves rho by a little less than its share."""
    model = models.create(name, rho=[0.001, 0.5, 0.9], sigma=0.5)
    share = scale_sensitivity(model)["rho"] / np.asarray(model.values["rho"])
    assert share[0] == pytest.approx(1.0, abs=1e-3)
    assert 0.8 < share[2] < share[1] < share[0]


def test_residuals_of_a_known_misfit(make_table: MakeTable, make_fit: MakeFit) -> None:
    table = make_table(("value",), sigma=True)
    fit = make_fit(table)
    twice = models.create("ward", channels=("value",), kd=0.2, ks=0.1, alpha=0.15)
    half = replace(fit, model=models.create("ward", channels=("value",), kd=0.1, ks=0.05, alpha=0.15))
    right = strict(build(table, half))["residuals"]["per_channel"][0]
    wrong = strict(build(table, replace(fit, model=twice)))["residuals"]["per_channel"][0]
    assert right["relative_rmse"] == pytest.approx(0.03, rel=0.1)
    assert right["birge_ratio"] == pytest.approx(1.0, abs=0.1)
    assert right["systematic_share"] < 0.1
    assert wrong["relative_bias"] == pytest.approx(-1.0, abs=0.05)
    assert wrong["birge_ratio"] > 20


def test_a_systematic_misfit_is_said_to_make_u_too_small(make_table: MakeTable, make_fit: MakeFit) -> None:
    table = make_table(("value",), sigma=True)
    wide = models.create("ward", channels=("value",), kd=0.1, ks=0.05, alpha=0.3)
    fit = make_fit(table)
    verdict = strict(build(table, replace(fit, model=wide, uncertainty="curvature")))["verdict"]
    assert any("too small, typically several times" in text for text in verdict["limits"])
    assert any("part of u, which trusts it, is too small" in text for text in verdict["reasons"])
    right = models.create("ward", channels=("value",), kd=0.1, ks=0.05, alpha=0.15)
    limits = strict(build(table, replace(fit, model=right)))["verdict"]["limits"]
    assert not any("several times" in text for text in limits)


@pytest.mark.long
def test_robust_uncertainties_stand_beside_those_of_independent_residuals(
    make_table: MakeTable, make_fit: MakeFit
) -> None:
    table = make_table(("R", "G"))
    fit = make_fit(table, u=0.01)
    labels = fit.labels
    found = Robust(
        labels=labels, standard_uncertainty={label: 0.03 * (k + 1) for k, label in enumerate(labels)},
        covariance=np.eye(len(labels)), degrees_of_freedom=4.0, coverage_factor=2.776, method="larger",
        scans=5, words="5 incident polar angles", effective_samples=(7.5, 3.25), rests_on={"alpha": (2, 0.9)},
    )  # fmt: skip
    report = build(table, fit, without_scans=found)
    record = strict(report, drawn=True)["robust"]
    assert record["effective_samples"] == {"R": 7.5, "G": 3.25}
    assert record["resting"] == ["alpha"]
    row = next(row for row in record["rows"] if row["label"] == "alpha")
    u = found.standard_uncertainty["alpha"]
    assert (row["fit"], row["standard_uncertainty"]) == (pytest.approx(0.0015), u)
    assert (row["lower"], row["upper"]) == pytest.approx((0.15 - 2.776 * u, 0.15 + 2.776 * u))
    sentence = report.to_dict()["verdict"]["sentences"][2]
    assert "worth about 3.3 independent ones" in sentence or "worth about 3.2 independent ones" in sentence
    assert "by leaving out 5 incident polar angles; alpha rests on one scan." in sentence
    assert build(table, fit).to_dict()["robust"] is None


def test_slices_hold_the_samples_of_their_plane(make_table: MakeTable, make_fit: MakeFit) -> None:
    table = make_table()
    record = strict(build(table, make_fit(table)))["slices"]
    assert [round(cut["theta_i_deg"]) for cut in record["slices"]] == [0, 15, 30, 45, 60]
    cut = record["slices"][2]
    x, fit = np.array(cut["curve"]["theta_o_deg"]), np.array(cut["curve"]["fit"]["R"])
    assert cut["samples"] == 21
    assert x[np.argmax(fit)] == pytest.approx(30.0, abs=3)  # the lobe leans a little towards grazing
    peak = int(np.argmax(cut["points"]["measured"]["R"]))
    assert cut["points"]["theta_o_deg"][peak] == pytest.approx(30.0, abs=7.6)


@pytest.mark.long
def test_posterior_bands_contain_the_curve(
    make_table: MakeTable, make_fit: MakeFit, make_posterior: MakePosterior
) -> None:
    names = tuple(f"{400 + 10 * k} nm" for k in range(31))
    table = make_table(names, in_plane=True)
    fit = make_fit(table)
    record = strict(build(table, fit, make_posterior(fit, draws=100)), drawn=True)
    assert record["slices"]["channels"] == [names[0], names[10], names[20], names[30]]
    assert record["slices"]["level"] == 0.95
    curve = record["slices"]["slices"][0]["curve"]
    inside = np.array(curve["lower"][names[30]]) < np.array(curve["fit"][names[30]])
    assert inside.all()
    assert len(record["parameters"]["rows"]) == 63
    assert len(record["posterior"]["corner"]["labels"]) <= 6
    assert len(json.dumps(record)) < 1_000_000


def test_reflectance_above_one_is_flagged(make_table: MakeTable, make_fit: MakeFit) -> None:
    table = make_table(("value",))
    bright = models.create("ward", channels=("value",), kd=1.2, ks=0.0, alpha=0.15)
    record = strict(build(table, replace(make_fit(table), model=bright)))
    rows = record["reflectance"]["rows"]
    assert all(row["above_one"] for row in rows)
    assert [row["theta_i_deg"] for row in rows if row["extrapolated"]] == [75.0, 85.0]
    assert any("more than arrives" in reason for reason in record["verdict"]["reasons"])


def test_correlated_parameters_are_named(make_table: MakeTable, make_fit: MakeFit) -> None:
    table = make_table(("value",))
    fit = make_fit(table, u=0.3)
    u = np.sqrt(np.diag(fit.covariance))
    r = np.array([[1.0, -0.995, 0.1], [-0.995, 1.0, 0.1], [0.1, 0.1, 1.0]])
    record = strict(build(table, replace(fit, covariance=r * np.outer(u, u))))
    assert "kd and ks are hardly separable" in record["correlation"]["not_separable"][0]
    assert record["correlation"]["not_separable"][0] in record["verdict"]["reasons"]


def test_metrics_that_are_not_finite(make_table: MakeTable, make_fit: MakeFit) -> None:
    table = make_table()
    nan = dict.fromkeys(("objective", "rmse", "relative_rmse", "r2"), float("nan"))
    assert strict(build(table, make_fit(table, metrics=nan)), drawn=True)["verdict"]["level"] == "bad"


def test_selection_fixed_parameters_and_comparison(make_table: MakeTable, make_fit: MakeFit) -> None:
    table = make_table()
    fit = make_fit(table)
    spec = FitSpec(
        model=fit.spec.model, fixed={"alpha": 0.15}, seed=3,
        select=Select(theta_i_max_deg=30.0, theta_o_max_deg=60.0),
    )  # fmt: skip
    keep = [k for k, label in enumerate(fit.labels) if label != "alpha"]
    alpha = replace(fit.parameters["alpha"], standard_uncertainty=np.asarray(np.nan))
    held = replace(
        fit, spec=spec, parameters={**fit.parameters, "alpha": alpha},
        labels=tuple(fit.labels[k] for k in keep), covariance=fit.covariance[np.ix_(keep, keep)],
    )  # fmt: skip
    record = strict(build(table, held, others=(fit, make_fit(table, "lafortune:2"))), drawn=True)
    assert record["residuals"]["of"] < int(table.mask.sum())
    assert [row["model"] for row in record["comparison"]] == ["ward", "ward", "lafortune:2"]
    assert [row["state"] for row in record["parameters"]["rows"]][-1] == "fixed"
    command = record["provenance"]["commands"][0]
    assert "--fixed alpha=0.15" in command
    assert "--theta-i-max 30.0 --theta-o-max 60.0" in command


def test_a_subsample_is_said_and_seeded(make_fit: MakeFit, monkeypatch: pytest.MonkeyPatch) -> None:
    from fitter.report import residuals

    monkeypatch.setattr(residuals, "MOST_SAMPLES", 500)
    rng = np.random.default_rng(5)
    theta, phi = np.arccos(rng.uniform(0.1, 1, (2, 2000))), 2 * np.pi * rng.random(2000)
    wi = directions.vector_from_spherical(theta[0], 0.0)
    table = Table(wi=wi, wo=directions.vector_from_spherical(theta[1], phi), value=rng.random(2000))
    report = build(table, make_fit(table))
    again = build(table, make_fit(table))
    assert report.record["residuals"] == again.record["residuals"]
    assert (report.record["residuals"]["samples"], report.record["residuals"]["of"]) == (500, 2000)
    assert "random subsample of 500 of 2,000" in re.sub(r"\s+", " ", report.html())


def test_mismatches(make_table: MakeTable, make_fit: MakeFit, make_posterior: MakePosterior) -> None:
    table, other = make_table(), make_table(("value",))
    fit = make_fit(table)
    with pytest.raises(SpecError) as channels:
        build(other, fit)
    assert channels.value.code == "table-mismatch"
    with pytest.raises(SpecError) as posterior:
        build(table, fit, make_posterior(make_fit(other)))
    assert posterior.value.code == "posterior-mismatch"
    verdict = strict(build(make_table(in_plane=True), fit))["verdict"]
    assert verdict["level"] == "bad"
    assert "not the one that was fitted" in verdict["reasons"][0]


def test_a_compressed_table(make_table: MakeTable, make_fit: MakeFit) -> None:
    table = make_table()
    small = compress(table, 0.01)
    fit = make_fit(small.decompress())
    assert strict(build(small, fit))["table"]["mismatch"] is None


def test_saved_and_read_again(tmp_path: Path, make_table: MakeTable, make_fit: MakeFit) -> None:
    table = make_table()
    report = build(table, make_fit(table))
    report.save(tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["report.html", "report.json"]
    assert load_report(tmp_path / "out" / "report.json").to_dict() == report.to_dict()
    with pytest.raises(SpecError) as error:
        Report.from_dict({"kind": "brdf-fitter/fit"})
    assert error.value.code == "not-a-report"


def test_what_the_engine_returns(make_table: MakeTable) -> None:
    """Labels, evidence and cost of a real fit: the contract between the rooms."""
    table = make_table(sigma=True, scale_uncertainty=0.01)
    fit = fitter.fit(table, "ward")
    record = strict(build(table, fit), drawn=True)
    assert record["verdict"]["level"] == "good"
    rows = {row["label"]: row for row in record["parameters"]["rows"]}
    assert set(rows) == set(fit.labels)
    for label, true in (("kd[R]", 0.1), ("kd[B]", 0.3), ("ks[G]", 0.05), ("alpha", 0.15)):
        assert abs(rows[label]["estimate"] - true) < 5 * rows[label]["standard_uncertainty"]
    assert record["residuals"]["per_channel"][0]["birge_ratio"] == pytest.approx(1.0, abs=0.15)


def test_estimates_of_other_shapes(make_table: MakeTable, make_fit: MakeFit) -> None:
    """A nonlinear parameter per channel is a row per channel."""
    table = make_table()
    fit = make_fit(table)
    alpha = Estimate(np.full(3, 0.15), np.full(3, 0.01), np.full(3, np.inf), "1", "roughness", (None,) * 3)
    model = models.create("ward", channels=("R", "G", "B"), kd=0.2, ks=0.05, alpha=[0.15] * 3)
    labels = (*fit.labels[:-1], "alpha[R]", "alpha[G]", "alpha[B]")
    wide = replace(
        fit, model=model, parameters={**fit.parameters, "alpha": alpha}, labels=labels,
        covariance=np.diag(np.full(9, 1e-4)),
    )  # fmt: skip
    rows = strict(build(table, wide))["parameters"]["rows"]
    assert [row["label"] for row in rows][-3:] == ["alpha[R]", "alpha[G]", "alpha[B]"]


def test_maps_of_every_pair_of_angles_hold_the_residuals(
    make_table: MakeTable, make_fit: MakeFit
) -> None:
    for in_plane, pairs in ((True, 2), (False, 3)):
        table = make_table(in_plane=in_plane)
        section = strict(build(table, make_fit(table)))["residuals"]
        maps = [section["map"], *section["further_maps"]]
        assert len({(one["x"], one["y"]) for one in maps}) == pairs
        for one in maps:
            rows = np.array(one["median"]["G"], float)
            assert rows.shape == (len(one["y_edges"]) - 1, len(one["x_edges"]) - 1)
            assert np.isfinite(rows).any()
    # Azimuths 100, 140 and 180 degrees from the light: 80, 40 and 0 from the mirror direction.
    phi = maps[2]
    assert (phi["x"], phi["y"]) == ("phi", "theta_o")
    seen = np.isfinite(np.array(phi["median"]["G"], float)).any(axis=0)
    middle = 0.5 * (np.array(phi["x_edges"])[1:] + np.array(phi["x_edges"])[:-1])
    wide = np.diff(phi["x_edges"]).max()
    for at in (0.0, 40.0, 80.0):
        assert np.abs(middle[seen] - at).min() <= wide


def test_what_more_time_would_buy(
    make_table: MakeTable, make_fit: MakeFit, make_posterior: MakePosterior
) -> None:
    table = make_table()
    fit = make_fit(table)
    half, now, ten = strict(build(table, fit, make_posterior(fit)))["posterior"]["time"]
    assert (half["ess"], now["ess"], ten["ess"]) == (700.0, 1400.0, 14_000.0)
    # Against simulated normal draws: the spread of estimated standard deviations and of 2.5 % quantiles.
    draws = np.random.default_rng(0).standard_normal((2000, 1400))
    assert now["error_of_deviation"] == pytest.approx(draws.std(axis=1).std(), rel=0.1)
    assert now["error_of_end"] == pytest.approx(np.quantile(draws, 0.025, axis=1).std(), rel=0.1)
