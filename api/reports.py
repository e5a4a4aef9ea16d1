"""Reports: made once for each fit and its latest posterior, then kept."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Literal

import orjson

from api.access import Mine
from api.problems import Problem
from api.rows import ModelRow, PosteriorRow, TableRow
from fitter.documents import dumps

if TYPE_CHECKING:
    from fitter.report import Report

Kind = Literal["json", "html", "pdf"]


def report(here: Mine, row: ModelRow, kind: Kind) -> bytes:
    """The report of a fit. Raises Problem (409) where it needs a table that was deleted."""
    latest, _ = here.page(PosteriorRow, 1, 0, PosteriorRow.fit_id == row.id)
    posterior_id = latest[0].id if latest else None
    # The latest finished posterior is part of the report, so its id names the file that keeps it.
    name = posterior_id or row.id
    with here.service.report_lock:
        kept = here.service.results.report(name, kind)
        if kept is None:
            # A PDF is drawn when somebody wants it: most are looked at in a browser.
            made = _kept(here, name) if kind == "pdf" else None
            made = made or _make(here, row, posterior_id, name)
            if kind == "pdf":
                here.service.results.write_report(name, "pdf", made.pdf())
            kept = here.service.results.report(name, kind)
    assert kept is not None
    return kept


def _kept(here: Mine, name: str) -> Report | None:
    """The report that was made before; None where there is none, or one that an earlier version made."""
    content = here.service.results.report(name, "json")
    record = None if content is None else orjson.loads(content)
    there = importlib.import_module("fitter.report.report")
    return there.Report(record) if record and record["version"] == there.VERSION else None


def _make(here: Mine, row: ModelRow, posterior_id: str | None, name: str) -> Report:
    table_row = here.find(TableRow, row.table_id or "")
    if table_row is None:
        raise Problem(
            409, "table-gone", "the table of this fit was deleted, and a report shows it",
            remedy="read the fit itself, or upload the table and fit again",
        )  # fmt: skip
    from fitter.fitting import FitResult
    from fitter.posterior import Posterior

    fit = FitResult.from_dict(here.service.results.read(row.id))
    posterior = None if posterior_id is None else Posterior.from_dict(here.service.results.read(posterior_id))
    table = here.service.tables.open(table_row).table
    made: Report = importlib.import_module("fitter.report").complete(table, fit, posterior)
    here.service.results.write_report(name, "json", dumps(made.to_dict()))
    here.service.results.write_report(name, "html", made.html().encode())
    return made
