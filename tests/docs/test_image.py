"""Dockerfile and docs/compose.yaml as far as no engine is needed: linted, valid, and every command in them is
one that its program takes."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml
from compose_spec import PyCompose

from fitter.cli.app import parser
from tests.image.dockerfile import Copy, copied, stages, words

ROOT = Path(__file__).resolve().parents[2]


def services() -> dict[str, Any]:
    """As an engine sees them: what `<<` merges is merged."""
    found: dict[str, Any] = yaml.safe_load((ROOT / "docs" / "compose.yaml").read_text())
    return found


def taken(words: Sequence[str]) -> None:
    """The command line is one that its program takes. Raises SpecError, SystemExit or click's errors."""
    program, *rest = words
    if program == "brdf-fitter":
        parser(rest[0]).parse_args(rest)
    else:
        assert program == "dask"
        from distributed.cli import dask_scheduler, dask_worker

        verb = {"scheduler": dask_scheduler.main, "worker": dask_worker.main}[rest[0]]
        verb.make_context(rest[0], rest[1:])


@pytest.mark.skipif(sys.platform != "linux", reason="the linter's wheel is for Linux here")
def test_the_dockerfile_is_clean() -> None:
    linter = Path(sys.executable).with_name("hadolint")
    done = subprocess.run([linter, "--no-color", ROOT / "Dockerfile"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "")


def test_the_image_s_command_is_ours() -> None:
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    taken(json.loads(next(line for line in reversed(lines) if line.startswith("CMD ")).removeprefix("CMD ")))


def test_every_step_is_one_that_the_check_does() -> None:
    build, final = stages(ROOT / "Dockerfile")
    assert (build.name, final.base) == ("build", build.base)
    assert [step.instruction for step in build.steps].count("RUN") == 3
    assert "\\" not in "".join(step.text for step in build.steps)
    (one,) = [copied(step.text) for step in final.steps if step.instruction == "COPY"]
    assert one == Copy(("/opt/venv",), "/opt/venv", "build")
    assert words(final.last("CMD") or "")[:2] == ["brdf-fitter", "serve"]
    assert words(final.last("HEALTHCHECK") or "")[0] == "python"
    assert final.last("USER") == "10001"


@pytest.mark.parametrize(
    ("text", "says"), [("FROM a\nADD b c\n", "ADD b c"), ("FROM a b\n", "FROM"), ("RUN x\n", "RUN x")]
)
def test_a_step_that_the_check_does_not_know(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "Dockerfile").write_text(text)
    with pytest.raises(ValueError, match=says):
        stages(tmp_path / "Dockerfile")


def test_a_command_that_needs_a_shell_is_refused() -> None:
    assert words('--timeout=5s CMD ["a", "b c"]') == ["a", "b c"]
    with pytest.raises(ValueError, match="substring"):
        words("a b c")


def test_the_composition_is_valid() -> None:
    whole = PyCompose.from_json(json.dumps(services()))
    assert set(whole.to_dict()["services"]) == {"postgres", "upgrade", "scheduler", "worker", "server"}


@pytest.mark.filterwarnings("ignore:.*is deprecated")
def test_its_commands_are_taken_and_name_each_other() -> None:
    found = services()["services"]
    commands = {name: one["command"] for name, one in found.items() if "command" in one}
    assert set(commands) == {"upgrade", "scheduler", "worker", "server"}
    for command in commands.values():
        taken(command)
    address = commands["worker"][2]
    assert address in commands["server"]
    host, _, port = address.removeprefix("tcp://").partition(":")
    assert port in commands[host]
    # Nobody but the server is reached from outside, and that from this machine only.
    assert [name for name, one in found.items() if "ports" in one] == ["server"]
    assert found["server"]["ports"][0].startswith("127.0.0.1:")
    assert all(one["networks"] == ["inside"] for name, one in found.items() if name != "server")
    for one in found.values():
        assert set(one.get("depends_on", {})) <= set(found)
