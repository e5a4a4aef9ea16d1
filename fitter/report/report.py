"""Report: the record of a fit (report.json) and what is drawn from it (report.html, report.pdf)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fitter.documents import read_document, write_bytes, write_document
from fitter.errors import SpecError

KIND = "brdf-fitter/report"
VERSION = 2


@dataclass(frozen=True)
class Report:
    """A report. ``record`` is strict JSON; the page shows nothing that is not in it."""

    record: Mapping[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """The record: what report.json holds."""
        return dict(self.record)

    @staticmethod
    def from_dict(document: Mapping[str, Any]) -> Report:
        """The report that :meth:`to_dict` wrote. Raises SpecError on anything else."""
        if document.get("kind") != KIND or document.get("version") != VERSION:
            raise SpecError(
                f"this is not a report of version {VERSION} (kind {document.get('kind')!r}, version "
                f"{document.get('version')!r})",
                code="not-a-report", remedy="give the report.json that this version of brdf-fitter wrote",
            )  # fmt: skip
        return Report(document)

    def html(self) -> str:
        """The page: one file with its style and figures inside, no script, nothing fetched."""
        from fitter.report.page import render

        return render(self.record)

    def pdf(self) -> bytes:
        """The same on A4 pages; the same record gives the same bytes."""
        from fitter.report.pdf import render

        return render(self.record)

    def save(self, folder: Path | str, *, pdf: bool = False) -> None:
        """Write report.json and report.html, and where asked report.pdf, into ``folder``, each aside and
        renamed."""
        folder = Path(folder)
        page = self.html().encode("utf-8")  # before the first file: no half report after an error
        paper = self.pdf() if pdf else None
        write_document(self.to_dict(), folder / "report.json")
        write_bytes(page, folder / "report.html")
        if paper is not None:
            write_bytes(paper, folder / "report.pdf")


def load_report(path: Path | str) -> Report:
    """Read the report.json that :meth:`Report.save` wrote."""
    return Report.from_dict(read_document(Path(path), "not-a-report"))
