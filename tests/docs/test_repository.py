"""What stands beside the code for people and machines: citation, templates, hooks, targets."""

from __future__ import annotations

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml

import fitter

ROOT = Path(__file__).resolve().parents[2]


def test_the_citation_is_of_this_version() -> None:
    found = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    # What the schema of the Citation File Format 1.2.0 asks for.
    assert {"cff-version", "message", "title", "authors"} <= set(found)
    assert found["cff-version"] == "1.2.0"
    assert found["title"] == project["name"]
    assert found["version"] == fitter.__version__
    assert found["license"] == project["license"]
    assert [one["name"] for one in found["authors"]] == [one["name"] for one in project["authors"]]


def test_hooks_call_what_the_lock_holds() -> None:
    hooks = [
        hook
        for repo in yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
        for hook in repo["hooks"]
    ]
    assert len(hooks) == 3
    locked = (ROOT / "requirements.lock").read_text()
    for hook in hooks:
        program = hook["entry"].split()[0]
        assert program.startswith(".venv/bin/")
        name = Path(program).name
        assert name == "python" or f"\n{name}==" in locked
        assert hook["language"] == "system"
        for word in hook["entry"].split():
            assert not word.startswith("tests/") or (ROOT / word).exists()


@pytest.mark.parametrize("path", sorted((ROOT / ".github").rglob("*.md")), ids=lambda path: path.name)
def test_templates_ask_for_commands_that_exist(path: Path) -> None:
    from fitter.cli.app import VERBS

    text = path.read_text()
    if path.parent.name == "ISSUE_TEMPLATE":
        head = yaml.safe_load(text.split("---")[1])
        assert set(head) == {"name", "about"}
    assert set(re.findall(r"brdf-fitter (\w+)", text)) <= set(VERBS)
    assert set(re.findall(r"`make ([\w-]+)`", text)) <= _targets()


def test_what_integration_runs_are_targets_that_a_person_has() -> None:
    script = (ROOT / ".ci" / "run").read_text()
    called = re.findall(r"^make ([\w-]+)", script, re.MULTILINE)
    assert called == ["install", "lint", "test", "test-long", "docs", "evidence"]
    assert set(called) <= _targets()


@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
def test_help_lists_every_target() -> None:
    said = subprocess.run(
        ["make", "-C", str(ROOT), "--no-print-directory", "help"], capture_output=True, text=True, check=True
    ).stdout
    assert set(re.findall(r"^make ([\w-]+) ", said, re.MULTILINE)) == _targets()


def _targets() -> set[str]:
    makefile = (ROOT / "Makefile").read_text()
    return set(re.findall(r"^\.PHONY: (.+)$", makefile, re.MULTILINE)[0].split())
