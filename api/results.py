"""Results: one JSON document a fit, posterior, calibration, tradeoff or scene, named by the row's id."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import orjson

from api.storage import Storage
from fitter.documents import dumps
from fitter.errors import SpecError

#: What is drawn of a result.
KINDS = ("json", "html", "pdf", "png", "exr")


class Results:
    """Result documents and reports made from them, in a storage; checkpoints of running jobs in a folder."""

    def __init__(self, storage: Storage, folder: Path) -> None:
        self._storage = storage
        self._checkpoints = folder / "checkpoints"

    def write(self, id: str, document: Mapping[str, Any]) -> None:
        """Whole or not at all."""
        self._storage.write(_name(id), dumps(document))

    def read(self, id: str) -> dict[str, Any]:
        """Raises SpecError where the document is gone."""
        try:
            return dict(orjson.loads(self._storage.read(_name(id))))
        except FileNotFoundError as error:
            raise SpecError("this result is not there", code="result-missing", file=_name(id)) from error

    def drop(self, id: str) -> None:
        """Delete a document that no row came to name, and what was drawn of it."""
        for name in (_name(id), *(_report(id, kind) for kind in KINDS)):
            self._storage.drop(name)

    def report(self, id: str, kind: str) -> bytes | None:
        """A report made before, None if there is none."""
        try:
            return self._storage.read(_report(id, kind))
        except FileNotFoundError:
            return None

    def write_report(self, id: str, kind: str, content: bytes) -> None:
        self._storage.write(_report(id, kind), content)

    def checkpoint(self, job: str) -> Path:
        """The folder in which a job keeps what it has done, for the attempt after this one."""
        return self._checkpoints / job

    def drop_checkpoint(self, job: str) -> None:
        shutil.rmtree(self.checkpoint(job), ignore_errors=True)

    def checkpoints(self) -> list[str]:
        """The jobs that left one."""
        return [path.name for path in self._checkpoints.glob("*")]


def _name(id: str) -> str:
    return f"results/{id}.json"


def _report(id: str, kind: str) -> str:
    return f"results/{id}.report.{kind}"
