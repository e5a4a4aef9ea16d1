"""The command as a whole: help, exit statuses, and what goes to which stream."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from argparse import Namespace
from pathlib import Path

import pytest

from fitter.cli import app
from fitter.cli.screen import Screen
from fitter.cli.verb import Outcome, Verb
from tests.cli.conftest import Run, process


def test_help_names_every_verb() -> None:
    out, _ = (running := process("--help")).communicate()
    assert running.returncode == 0
    assert re.findall(r"^  (\w+)  ", out, re.MULTILINE) == list(app.VERBS)


def test_help_imports_neither_numpy_nor_jax() -> None:
    code = (
        "import sys; from fitter.cli import main; main(['--help']); "
        "print([m for m in ('numpy', 'jax', 'pydantic', 'rich') if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


@pytest.mark.parametrize("verb", app.VERBS)
def test_every_verb_explains_itself(run: Run, verb: str) -> None:
    ran = run(verb, "--help")
    assert ran.status == 0
    assert "--json" in ran.out
    assert ran.err == ""


def test_help_of_fit_names_the_parameters_of_every_family(run: Run) -> None:
    from fitter.models import parameter_table
    from fitter.spec import FAMILIES

    text = run("fit", "--help").out
    for family in FAMILIES:
        for parameter in parameter_table(family):
            if not parameter.linear:
                assert parameter.description in text


def test_version(run: Run) -> None:
    from fitter import __version__

    assert run("--version").out == f"brdf-fitter {__version__}\n"


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["nonsense"],
        ["info"],
        ["info", "a.csv", "--nonsense"],
        ["fit", "a.csv", "--fixed", "alpha"],
        ["fit", "a.csv", "--fixed", "alpha=wide"],
        ["fit", "a.csv", "--bounds", "alpha=0.1"],
        ["fit", "a.csv", "--metric", "nonsense"],
        ["fit", "a.csv", "--starts", "many"],
        ["sample", "a.csv"],
        ["report", "a.json"],
        ["--nonsense"],
    ],
)
def test_a_wrong_call_is_status_2_and_one_sentence(run: Run, words: list[str]) -> None:
    ran = run(*words)
    assert ran.status == 2
    assert ran.out == ""
    assert ran.err.startswith("brdf-fitter: error: ")
    assert "Traceback" not in ran.err
    assert run(*words, "--json").document["error"]["code"] == "bad-call"


def _with(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    def fail(given: Namespace, screen: Screen) -> Outcome:
        raise error

    broken = Verb("fail", lambda parser: None, fail)
    monkeypatch.setattr(app, "verb", lambda name: broken)


def test_interrupted(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    _with(monkeypatch, KeyboardInterrupt())
    ran = run("models")
    assert (ran.status, ran.out, ran.err) == (130, "", "brdf-fitter: interrupted\n")


def test_a_mistake_of_ours_is_reported_as_such(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    _with(monkeypatch, ZeroDivisionError("by zero"))
    ran = run("models", "--json")
    assert ran.status == 1
    assert ran.document["error"]["code"] == "internal-error"
    assert "Traceback" in ran.err


def test_a_full_disk_is_no_traceback(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    _with(monkeypatch, OSError(28, "No space left on device", "out.json"))
    ran = run("models", "--json")
    assert ran.status == 1
    error = ran.document["error"]
    assert (error["code"], error["file"]) == ("system-error", "out.json")
    assert "Traceback" not in ran.err


def test_libraries_do_not_print_on_standard_output(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def chatty(given: Namespace, screen: Screen) -> Outcome:
        print("a library's remark")
        return Outcome({"kind": "test"}, lambda screen: screen.line("summary"))

    monkeypatch.setattr(app, "verb", lambda name: Verb("chat", lambda parser: None, chatty))
    ran = run("models", "--json")
    assert ran.document == {"kind": "test"}
    assert "a library's remark" in ran.err
    assert run("models").out == "summary\n"


def test_a_reader_that_goes_away_is_no_error() -> None:
    running = process("datasets", "--json")
    assert running.stdout is not None
    assert running.stderr is not None
    running.stdout.close()
    said = running.stderr.read()
    running.stderr.close()
    assert running.wait() == 141
    assert said == ""


def test_interrupting_a_fit_leaves_nothing_half_written(plaster: Path, tmp_path: Path) -> None:
    running = process("fit", plaster, "--out", tmp_path / "fits", "--progress", "always", "--json")
    assert running.stderr is not None
    # The first thing on standard error is the first bar: by then the work has begun.
    assert running.stderr.read(1)
    running.send_signal(signal.SIGINT)
    out, err = running.communicate(timeout=60)
    assert running.returncode == 130
    assert out == ""
    assert "interrupted" in err
    assert "Traceback" not in err
    for left in (tmp_path / "fits").iterdir():
        json.loads(left.read_text())


def test_bars_only_where_somebody_looks(capsys: pytest.CaptureFixture[str]) -> None:
    for when, expected in (("auto", False), ("always", True), ("never", False)):
        with Screen(progress=when).progress("counting") as progress:  # type: ignore[arg-type]
            progress(0.5, "half [R]")
        out, err = capsys.readouterr()
        assert out == ""
        assert ("counting" in err) is expected
