"""Results: one JSON document a fit, posterior, calibration or tradeoff, in files named by the row's id."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fitter.documents import read_document, write_bytes, write_document


class Results:
    """A folder of result documents and of the reports made from them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder / "results"
        self._folder.mkdir(parents=True, exist_ok=True)

    def write(self, id: str, document: Mapping[str, Any]) -> None:
        """Write aside and rename."""
        write_document(document, self._path(id))

    def read(self, id: str) -> dict[str, Any]:
        return dict(read_document(self._path(id), "result-missing"))

    def drop(self, id: str) -> None:
        """Delete a document that no row came to name, and what was drawn of it."""
        self._path(id).unlink(missing_ok=True)
        for report in self._folder.glob(f"{id}.report.*"):
            report.unlink(missing_ok=True)

    def report(self, id: str, kind: str) -> bytes | None:
        """A report made before, None if there is none."""
        path = self._folder / f"{id}.report.{kind}"
        return path.read_bytes() if path.exists() else None

    def write_report(self, id: str, kind: str, content: bytes) -> None:
        write_bytes(content, self._folder / f"{id}.report.{kind}")

    def checkpoint(self, job: str) -> Path:
        """The folder in which a job keeps what it has done, for the attempt after this one."""
        return self._folder.parent / "checkpoints" / job

    def drop_checkpoint(self, job: str) -> None:
        shutil.rmtree(self.checkpoint(job), ignore_errors=True)

    def checkpoints(self) -> list[str]:
        """The jobs that left one."""
        return [path.name for path in self.checkpoint("").glob("*")]

    def _path(self, id: str) -> Path:
        return self._folder / f"{id}.json"
