"""``tradeoff``, and the budgets of ``fit``."""

from __future__ import annotations

from pathlib import Path

import pytest

import fitter
from fitter.fitting import calibration, cost_model
from fitter.fitting.cost_model import Calibration, Line
from fitter.fitting.effort import PHASES
from tests.cli.conftest import Run

BARE = (
    "--metrics", "", "--solvers", "", "--subsets", "", "--starts", "", "--tolerances", "", "--no-posterior",
    "--repeats", "1",
)  # fmt: skip


#: Of a made-up machine.
CALIBRATION = Calibration(
    lines=dict.fromkeys(PHASES, Line(fixed=1e-3, each=1e-8)), compile_search=2.0, compile_rest=1.0, seconds=5
)


@pytest.mark.long
def test_tradeoff(run: Run, plaster: Path, tmp_path: Path) -> None:
    words = ["tradeoff", plaster, "--model", "oren_nayar", *BARE, "--time-limit", "2min", "--out", tmp_path]
    document = run(*words, "--json").document
    assert document["kind"] == "brdf-fitter/tradeoff"
    read = fitter.load_tradeoff(tmp_path / "tradeoff.json")
    assert [p.axis for p in read.points] == ["default", "reference", "precision", "precision"]
    assert read.spec.time_limit_seconds == 120.0
    text = run(*words).out
    assert "Pareto front" in text
    assert "Reference of oren_nayar" in text
    assert "tradeoff.png" in text


def test_bad_tradeoffs(run: Run, plaster: Path, tmp_path: Path) -> None:
    for words in (
        ["--model", "glass"], ["--subsets", "few"], ["--time-limit", "soon"], ["--metrics", "best"],
        ["--model", "he_torrance"],
    ):  # fmt: skip
        ran = run("tradeoff", plaster, *words, "--out", tmp_path / "out", "--json")
        assert (ran.status, "error" in ran.document) == (2, True), words
    assert not any((tmp_path / "out").glob("*"))


def test_fit_says_what_it_cost(run: Run, plaster: Path) -> None:
    text = run("fit", plaster, "--model", "oren_nayar").out
    assert "cost: load" in text
    assert "passes over" in text
    assert "at the peak" in text


def test_a_target_below_what_can_be_had(run: Run, plaster: Path) -> None:
    ran = run("fit", plaster, "--model", "oren_nayar", "--target-error", "1e-13%", "--json")
    assert (ran.status, ran.document["error"]["code"]) == (1, "unattainable")


def test_a_target_that_can_be_had(
    run: Run, plaster: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cost_model, "path", lambda: tmp_path / "cost-model.json")
    monkeypatch.setattr(calibration, "calibrate", lambda fit, report: CALIBRATION)
    words = ["fit", plaster, "--model", "oren_nayar", "--target-error", "1%"]
    document = run(*words, "--json").document
    told = document["cost"]["budget"]
    assert told["kept"] is True
    assert told["measured"]["search_error"] <= 0.01
    assert "budget: ten times the time" in run(*words).out


def test_a_subset_only(run: Run, plaster: Path) -> None:
    words = ["fit", plaster, "--model", "oren_nayar", "--polish", "subset", "--subset", "256"]
    document = run(*words, "--json").document
    assert document["table"]["subset"] <= 256
    assert document["cost"]["passes"] == 0


def test_bad_budgets(run: Run, plaster: Path) -> None:
    for words in (["--budget", "now"], ["--budget", "-1s"], ["--target-error", "200%"]):
        assert run("fit", plaster, *words, "--json").status == 2
