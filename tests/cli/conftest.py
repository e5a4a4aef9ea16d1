"""Running the command inside the test process, and a result that several tests share."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from fitter import datasets
from fitter.cli import main


@dataclass(frozen=True)
class Ran:
    """What one run of the command left behind."""

    status: int
    out: str
    err: str

    @property
    def document(self) -> Any:
        """The one JSON document on standard output: anything more or less is an error."""
        assert self.out.endswith("\n")
        return json.loads(self.out)


Run = Callable[..., Ran]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run ``brdf-fitter`` with these words."""

    def call(*words: object) -> Ran:
        status = main([str(word) for word in words])
        out, err = capsys.readouterr()
        return Ran(status, out, err)

    return call


def process(*words: object, **keywords: Any) -> subprocess.Popen[str]:
    """The command as a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "fitter", *(str(word) for word in words)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **keywords,
    )  # fmt: skip


@pytest.fixture(scope="session")
def plaster() -> Path:
    """A bundled table: isotropic, RGB, no sigma."""
    return datasets.sample("diffuse_plaster")


@pytest.fixture(scope="session")
def fits(tmp_path_factory: pytest.TempPathFactory, plaster: Path) -> Path:
    """A folder with the fits of two models to that table."""
    folder = tmp_path_factory.mktemp("fits")
    words = ["fit", str(plaster), "--model", "oren_nayar", "--model", "ward", "--out", str(folder)]
    assert main(words) == 0
    return folder
