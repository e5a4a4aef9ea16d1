"""Budgets: what is chosen, what is unattainable, and a cost model that is never trusted blindly."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

import fitter
from fitter import FitError, SpecError, models, progress
from fitter.cli.values import duration, share
from fitter.fitting import budget, calibration, cost_model
from fitter.fitting.cost_model import Book, Calibration, Line
from fitter.fitting.effort import PHASES, Case, Effort
from fitter.spec import fit_spec
from tests.fitting.conftest import scattered

LINE = Line(fixed=1e-3, each=1e-8)
CALIBRATION = Calibration(
    lines=dict.fromkeys(PHASES, LINE), compile_search=2.0, compile_rest=1.0, seconds=5.0
)


@pytest.fixture
def book(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Book:
    """A cost model of a made-up machine, stored where a fit looks for it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    found = Book(machine=cost_model.machine(), calibration=CALIBRATION)
    assert cost_model.save(found, cost_model.path()) == []
    return found


@pytest.fixture(scope="module")
def table() -> fitter.Table:
    return scattered(models.create("oren_nayar", rho=[0.3, 0.5, 0.7], sigma=0.5), seed=5, n=3000)


def case_of(samples: int, name: str = "ward") -> Case:
    request = fit_spec({"model": name, "metric": "cosine"})
    small = scattered(models.create("oren_nayar", rho=[0.3, 0.5, 0.7], sigma=0.5), seed=5, n=50)
    return Case.of(small, request).sized(samples, 3)


def test_more_time_never_buys_a_worse_fit(book):
    case = case_of(1_000_000)
    scores = []
    for seconds in (3.2, 3.5, 4.0, 6.0, 12.0, 60.0):
        request = fit_spec({"model": "ward", "budget_seconds": seconds})
        choice = budget.choose(book, case, request)
        assert choice.prediction.seconds <= seconds
        scores.append(case.score(choice.effort, choice.prediction.error))
    assert scores == sorted(scores, reverse=True)
    assert scores[-1] < scores[0]


def test_a_target_gets_the_cheapest_that_reaches_it(book):
    case = case_of(1_000_000)
    efforts = []
    for target in (0.1, 0.01, 1e-3, 1e-4, 1e-8):
        choice = budget.choose(book, case, fit_spec({"model": "ward", "target_error": target}))
        assert choice.prediction.error <= target
        assert choice.effort.starts >= case.usual_starts
        efforts.append(choice.prediction.seconds)
    assert efforts == sorted(efforts)
    assert choice.effort.polish == "full"


@pytest.mark.parametrize(
    ("asked", "parameter"),
    [
        ({"budget_seconds": 1e-3}, "budget_seconds"),
        ({"target_error": 1e-14}, "target_error"),
        ({"target_error": 1e-6, "budget_seconds": 1e-4}, "budget_seconds"),
    ],
)
def test_what_cannot_be_had_is_said_at_once(book, table, asked, parameter):
    with pytest.raises(FitError, match="unattainable") as caught:
        fitter.fit(table, "ward", **asked)
    assert caught.value.code == "unattainable"
    assert caught.value.parameter == parameter
    assert caught.value.remedy


@pytest.mark.parametrize("asked", [{"budget_seconds": 0}, {"target_error": -1}, {"target_error": 1.0}])
def test_nonsense_is_a_spec_error(table, asked):
    with pytest.raises(SpecError):
        fitter.fit(table, "ward", **asked)


def test_a_fit_within_a_budget_gives_an_account(book, table):
    fit = fitter.fit(table, "oren_nayar", budget_seconds=120)
    told = fit.cost["budget"]
    assert told["asked"] == {"budget_seconds": 120.0, "target_error": None}
    assert told["kept"] is True
    assert told["measured"]["seconds"] >= fit.cost["seconds"]
    assert told["calibration_seconds"] == 0.0
    assert {"seconds", "compile_seconds", "within_a_factor", "search_error"} <= set(told["predicted"])
    assert "which no search mends" in told["sentence"]
    assert told["ten_times"]["sentence"].startswith("ten times the time")
    # The specification is the one that was chosen: it makes the same fit again, on any machine.
    assert fit.spec.budget_seconds is None
    again = fitter.fit(table, fit.spec)
    assert again.parameters["rho"].value.tolist() == fit.parameters["rho"].value.tolist()
    assert fitter.FitResult.from_dict(json.loads(json.dumps(fit.to_dict()))).cost["budget"] == told
    # And the machine's model knows more than before.
    after, notes = cost_model.load(cost_model.path())
    assert notes == []
    assert after is not None
    assert len(after.runs) == 1
    assert after.runs[0].key.startswith("oren_nayar|")
    assert len(after.compiled) == 2


def test_a_target_is_kept_by_polishing_on_where_the_subset_fell_short(book, table, monkeypatch):
    # A model that knows no better, and nothing else to choose.
    monkeypatch.setattr(Case, "independent", lambda self, subset: 1e-9)
    monkeypatch.setattr(Case, "efforts", lambda self, starts: [Effort(512, self.usual_starts, "subset")])
    fit = fitter.fit(table, "oren_nayar", target_error=1e-5)
    assert fit.evidence["search_error"] <= 1e-5
    assert fit.spec.polish == "full"
    assert any("polished on" in note for note in fit.cost["budget"]["notes"])


@pytest.mark.parametrize(
    "content",
    [
        b"", b"{", b"[]", b'{"kind": "brdf-fitter/fit"}', b"\xff\xfe", b'{"kind": "brdf-fitter/cost-model"}'
    ],
)  # fmt: skip
def test_a_damaged_file_is_calibrated_anew_with_a_note(book, table, monkeypatch, content):
    cost_model.path().write_bytes(content)
    monkeypatch.setattr(calibration, "calibrate", lambda fit, report: CALIBRATION)
    told = fitter.fit(table, "oren_nayar", target_error=0.01).cost["budget"]
    assert "damaged" in told["notes"][0]
    assert cost_model.load(cost_model.path())[0] is not None


@pytest.mark.parametrize(
    ("where", "what"),
    [
        (("calibration", "compile_search"), -1.0), (("calibration", "compile_search"), "fast"),
        (("calibration", "lines"), {}), (("version",), 2), (("surplus",), 1),
    ],
)  # fmt: skip
def test_a_file_with_nonsense_in_it_is_not_trusted(book, where, what):
    document = json.loads(cost_model.path().read_bytes())
    inside = document
    for key in where[:-1]:
        inside = inside[key]
    inside[where[-1]] = what
    cost_model.path().write_text(json.dumps(document))
    found, notes = cost_model.load(cost_model.path())
    assert found is None
    assert "damaged" in notes[0]


def test_another_machines_file_is_not_used(book):
    document = json.loads(cost_model.path().read_bytes())
    document["machine"]["cpu"] = "an abacus"
    cost_model.path().write_text(json.dumps(document))
    found, notes = cost_model.load(cost_model.path())
    assert found is None
    assert "another machine" in notes[0]


def test_a_cache_that_cannot_be_written_costs_a_note(book, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    assert "can't be kept" in cost_model.save(book, blocked / "cost-model.json")[0]


def run(case: Case, effort: Effort, seconds: float) -> cost_model.Run:
    return cost_model.Run(
        key=case.key, samples=case.samples, channels=case.channels, subset=effort.subset,
        starts=effort.starts, full=effort.polish == "full", passes=4, seconds=dict.fromkeys(PHASES, seconds),
        compile_search=None, compile_rest=None, cached=False, spread=None,
    )  # fmt: skip


@given(seconds=st.floats(1e-4, 1e3), count=st.integers(1, 60))
def test_runs_correct_the_prediction_and_the_file_stays_small(seconds, count):
    case, effort = case_of(100_000), Effort(4096, 3, "full")
    book = Book(machine={}, calibration=CALIBRATION)
    assert cost_model.predictions(book, case, [effort])[0].factor == cost_model.UNSEEN
    for _ in range(count):
        book = cost_model.with_run(book, run(case, effort, seconds), [("a", effort)])
    found = cost_model.predictions(book, case, [effort])[0]
    assert found.running == pytest.approx(4 * seconds, rel=0.3)
    assert len(book.runs) <= cost_model.EACH
    assert len(book.compiled) == 1


def test_a_calibration_is_a_line_through_two_sizes():
    """On a machine whose seconds are known."""
    made: list[int] = []

    def fit(table: fitter.Table, request, report) -> SimpleNamespace:
        made.append(len(table))
        case = Case.of(table, request)
        work = case.work(Effort(4096, case.usual_starts, "full"), 4)
        laps = {phase: 0.01 + 1e-7 * work[phase] for phase in PHASES}
        cost = {"phases": {"load": 9.0, "compile": 3.0, **laps}, "passes": 4}
        return SimpleNamespace(cost={**cost, "compiled_in": {"search": 2.0, "check": 1.0}})

    found = calibration.calibrate(fit, progress.ignore)
    assert (found.compile_search, found.compile_rest) == (2.0, 1.0)
    assert set(made) == {calibration.SMALL, calibration.LARGE}
    for phase in PHASES:
        assert found.lines[phase].fixed == pytest.approx(0.01, rel=1e-6)
        assert found.lines[phase].each == pytest.approx(1e-7, rel=1e-6)


@pytest.mark.parametrize(("text", "value"), [("2s", 2), ("500ms", 0.5), ("1.5min", 90), ("3", 3), ("2 s", 2)])
def test_durations(text, value):
    assert duration(text) == pytest.approx(value)


@pytest.mark.parametrize(("text", "value"), [("1%", 0.01), ("0.01", 0.01), ("2.5 %", 0.025)])
def test_shares(text, value):
    assert share(text) == pytest.approx(value)
