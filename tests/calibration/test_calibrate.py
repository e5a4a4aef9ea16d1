"""Calibration: truths from the prior by the posterior's own names, ranks, verdicts, and what fails."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fitter
from fitter import FitSpec, SpecError, models
from fitter.calibration import Calibration, calibrate, load_calibration, run
from fitter.calibration.truths import Truths, truths
from fitter.fitting.result import Estimate
from fitter.fitting.usable import usable
from fitter.progress import Cancelled
from tests.fitting.conftest import scattered

QUICK = {"ensembles": 2, "rhat": 1.2, "ess": 50, "keep": 300, "budget_seconds": 60.0}


@pytest.fixture(scope="module")
def plain() -> tuple[fitter.Table, fitter.FitResult]:
    model = models.create("oren_nayar", rho=0.4, sigma=0.5)
    table = scattered(model, seed=1, n=200, noise=0.05, sigma=True)
    return table, fitter.fit(table, "oren_nayar")


def _truths(spec: str, ranges: dict[str, tuple[float, float]], values: dict[str, Any]) -> Truths:
    """The truths of a fit that was not made: its estimates are the values themselves."""
    model = models.create(spec, **values)
    table = scattered(model, seed=2, n=30, sigma=True, azimuths=True)
    estimates = {
        p.name: Estimate(
            np.asarray(model.values[p.name]), *(np.full(model.values[p.name].shape, np.nan),) * 2, p.unit, "",
            (None,) * max(1, model.values[p.name].size),
        )
        for p in model.table
    }  # fmt: skip
    labels = tuple(
        label for name, e in estimates.items()
        for label in ([f"{name}[{c}]" for c in model.channels] if e.value.ndim else [name])
    )  # fmt: skip
    fit: Any = SimpleNamespace(
        spec=FitSpec(model=model.spec), model=model, parameters=estimates, labels=labels,
        metrics={"relative_rmse": 0.05},
    )
    data = usable(table, "absolute", fit.spec.select, anisotropic=True)
    return truths(fit, data, inferred=True, around=None, ranges=ranges)


def test_ranges_of_linear_and_noise_parameters_are_the_prior_that_is_sampled():
    found = _truths("ward", {"ks": (0.0, 0.3), "alpha": (0.1, 0.2)}, {"kd": 0.1, "ks": 0.05, "alpha": 0.15})
    assert found.within.keys() == {"kd[value]", "ks[value]", "relative_noise[value]", "noise_floor[value]"}
    assert found.within["ks[value]"] == (0.0, 0.3)
    two = {"kd": 0.2, "ks_1": 0.3, "ks_2": 0.1, "gamma_1": -0.7, "n_1": 5.0, "n_2": 60.0}
    assert not _truths("lafortune:2", {}, two).within


@pytest.mark.parametrize(
    ("spec", "values"),
    [
        ("ward:anisotropic", {"kd": 0.1, "ks": 0.05, "alpha_x": 0.1, "alpha_y": 0.3, "psi": 0.4}),
        ("lafortune:2", {"kd": 0.2, "ks_1": 0.3, "ks_2": 0.1, "gamma_1": -0.7, "n_1": 5.0, "n_2": 60.0}),
    ],
)
def test_truths_go_by_the_names_of_the_posterior_and_stay_the_same_surface(
    spec: str, values: dict[str, Any]
) -> None:
    from_ = _truths(spec, {"kd": (0.0, 0.3)}, values)
    rng = np.random.default_rng(0)
    drawn = np.array([from_.draw(rng) for _ in range(200)])
    assert from_.inside(drawn).all()
    np.testing.assert_allclose(from_.named(drawn), drawn)
    natural = dict(zip(from_.labels, from_.natural(drawn).T, strict=True))
    assert (natural["kd[value]"] <= 0.3).all()
    if spec == "ward:anisotropic":
        assert (natural["alpha_x"] <= natural["alpha_y"]).all()
        # Half of the box has another name: what is left is not a corner of it.
        assert np.ptp(natural["psi"]) > 0.9 * np.pi
    # Any vector of the box, renamed, is the same surface.
    other = rng.uniform(from_.low, from_.high, (20, len(from_.low)))
    table = scattered(from_.model, seed=3, n=30, azimuths=True)
    for a, b in zip(other, from_.named(other), strict=True):
        f, g = (np.asarray(from_.model_of(y).evaluate(table.wi, table.wo)) for y in (a, b))
        np.testing.assert_allclose(f, g, rtol=1e-6, atol=1e-12)


def test_a_truth_is_uniform_in_search_coordinates() -> None:
    from_ = _truths("ward", {"alpha": (0.01, 1.0)}, {"kd": 0.1, "ks": 0.05, "alpha": 0.1})
    k = from_.labels.index("alpha")
    rng = np.random.default_rng(5)
    alpha = from_.natural(np.array([from_.draw(rng) for _ in range(2000)]))[:, k]
    assert (alpha < 0.1).mean() == pytest.approx(0.5, abs=0.04)


def test_a_run_tells_what_it_did_and_reads_back(plain: Any, tmp_path: Any) -> None:
    table, fit = plain
    told: list[tuple[float, str]] = []
    found = calibrate(
        table, fit, simulations=3, draws=19, posterior=QUICK, seed=7, progress=lambda *a: told.append(a)
    )
    assert (found.simulations, found.failed, found.status) == (3, 0, "too_few_simulations")
    assert set(found.labels) == {"rho[value]", "sigma", "log-likelihood"}
    assert all(one is not None and 0 <= rank <= 19 for one in found.ranks for rank in one.values())
    low, high = found.ranges["rho[value]"]
    assert low < float(fit.parameters["rho"].value[0]) < high
    shares = [share for share, _ in told]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    found.save(tmp_path)
    read = load_calibration(tmp_path / "calibration.json")
    assert read.to_dict() == found.to_dict()
    assert (tmp_path / "calibration.png").read_bytes().startswith(b"\x89PNG")
    # The same seed simulates the same tables; a limit of time ends between two of them.
    again = calibrate(
        table, fit, simulations=3, draws=19, posterior=QUICK, seed=7, time_limit_seconds=1e-6
    )
    assert again.simulations == 1
    assert again.ranks[0] == found.ranks[0]


@pytest.mark.parametrize(("times", "status"), [(1.0, "calibrated"), (0.5, "not_calibrated")])
def test_the_verdict_on_posteriors_of_known_width(
    plain: Any, monkeypatch: pytest.MonkeyPatch, times: float, status: str
) -> None:
    """Stub posteriors about a noisy estimate of the truth, as wide as its noise or half as wide."""
    table, fit = plain
    count = 0

    def sample(table: fitter.Table, fit: Any, asked: Any, **_: Any) -> Any:
        nonlocal count
        truth = state["truths"].draw(np.random.default_rng([3, count]))
        count += 1
        rng = np.random.default_rng(asked.seed)
        sd = 0.05 * (state["truths"].high - state["truths"].low)
        centre = truth + sd * rng.standard_normal(len(truth))
        y = centre + times * sd * rng.standard_normal((4000, len(truth)))
        good = SimpleNamespace(ess_bulk=4e3, ess_tail=4e3)
        return SimpleNamespace(
            status="converged", draws=state["truths"].natural(y), labels=state["truths"].labels,
            diagnostics={"rho[value]": good},
        )  # fmt: skip

    any_ = np.random.default_rng(9)
    state: dict[str, Truths] = {}
    of = run._Simulator.of

    def remember(*args: Any) -> Any:
        made = of(*args)
        state["truths"] = made.truths
        return made

    monkeypatch.setattr(run, "sample", sample)
    monkeypatch.setattr(run, "fitted", lambda *_, **__: None)
    monkeypatch.setattr(run._Simulator, "of", staticmethod(remember))
    monkeypatch.setattr(run._Simulator, "_log_likelihood", lambda *_: any_.standard_normal(100))
    # Wide ranges of what is hardly at an edge: a flat prior that the stub does not know of matters little.
    found = calibrate(table, fit, simulations=80, seed=3, around=20.0)
    rows = {row.label: row for row in found.rows()}
    assert rows["rho[value]"].uniform == (status == "calibrated")
    assert rows["rho[value]"].covers == (status == "calibrated")
    assert found.status == status


def test_what_fails_counts_against_it(plain: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    table, fit = plain
    monkeypatch.setattr(run, "sample", lambda *_, **__: SimpleNamespace(status="not_converged"))
    found = calibrate(table, fit, simulations=50, seed=1)
    assert found.failures == {"not_converged": 50}
    assert found.status == "not_calibrated"
    assert Calibration.from_dict(found.to_dict()).rows() == found.rows()


def test_progress_can_stop_it(plain: Any) -> None:
    def stop(share: float, what: str) -> None:
        if "finding the mode" in what:
            raise Cancelled

    with pytest.raises(Cancelled):
        calibrate(*plain, simulations=2, posterior=QUICK, progress=stop)


@pytest.mark.parametrize(
    ("settings", "code"),
    [
        ({"ranges": {"albedo": (0, 1)}}, "bad-ranges"), ({"ranges": {"sigma": (0.3, 0.2)}}, "bad-ranges"),
        ({"ranges": {"sigma": (0.0, 9.0)}}, "bad-ranges"), ({"simulations": 0}, "bad-spec"),
        ({"posterior": {"ensembles": 1}}, "bad-spec"),
    ],
)  # fmt: skip
def test_requests_that_make_no_sense(plain: Any, settings: dict[str, Any], code: str) -> None:
    with pytest.raises(SpecError) as error:
        calibrate(*plain, **settings)
    assert error.value.code == code


def test_noise_of_the_table_needs_it(plain: Any) -> None:
    table, fit = plain
    bare = fitter.Table(wi=table.wi, wo=table.wo, value=table.value)
    with pytest.raises(SpecError, match="states none"):
        calibrate(bare, fit, noise="table")
