"""``brdf-fitter report``: one self-contained HTML page about a fit, and its record as JSON."""

from __future__ import annotations

import argparse

from fitter.cli import reading
from fitter.cli.screen import Screen
from fitter.cli.values import output_folder
from fitter.cli.verb import Outcome, Verb
from fitter.errors import SpecError


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "result", nargs="+", metavar="RESULT.json", help="fits of one table that `fit` wrote or printed"
    )
    parser.add_argument(
        "--model", metavar="NAME",
        help="which fit the report is about; the others are compared with it (default: the posterior's, "
        "else the one with the smallest objective)",
    )  # fmt: skip
    parser.add_argument(
        "--table", metavar="TABLE", help="the table, where it is not where it was when fitted"
    )
    parser.add_argument("--posterior", metavar="FILE", help="a posterior that `posterior --out` wrote")
    parser.add_argument(
        "--out", required=True, metavar="DIR", help="write DIR/report.html and DIR/report.json"
    )
    parser.add_argument("--pdf", action="store_true", help="write DIR/report.pdf, too")
    reading.add_reading_options(parser)


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.cli.numerics import start_numerics
    from fitter.spec import ModelSpec

    out = output_folder(given.out)
    start_numerics(screen)
    from fitter.fitting.result import best, load_fits
    from fitter.posterior import load_posterior
    from fitter.report import complete

    found = [(path, result) for path in given.result for result in load_fits(path)]
    results = [result for _, result in found]
    for path, result in found:
        if result.table.get("hash") != results[0].table.get("hash"):
            raise SpecError(
                f"{path} is a fit of another table than {found[0][0]}", code="table-differs", file=path,
                parameter="result", remedy="report on the fits of one table at a time",
            )  # fmt: skip
    posterior = None if given.posterior is None else load_posterior(given.posterior)
    wanted = posterior.fit_spec.model.name if posterior is not None else None
    if given.model is not None:
        wanted = ModelSpec.parse(given.model).name
    matching = [result for result in results if wanted in (None, result.spec.model.name)]
    if not matching:
        raise SpecError(
            f"there is no fit of {wanted}", code="which-fit", parameter="model",
            remedy=f"give its file too; these are fits of {', '.join(r.spec.model.name for r in results)}",
        )  # fmt: skip
    chosen = best(matching)
    path = next(path for path, result in found if result is chosen)
    opened = reading.table_of(chosen.table, given.table, reading.reading_options(given), result=path)
    others = [result for result in results if result is not chosen]
    complete(opened.table, chosen, posterior, others=others).save(out, pdf=given.pdf)
    page, record = out / "report.html", out / "report.json"
    paper = out / "report.pdf" if given.pdf else None
    document = {
        "kind": "brdf-fitter/report-written", "model": chosen.spec.model.name, "html": str(page),
        "json": str(record), "pdf": None if paper is None else str(paper),
    }  # fmt: skip
    written = ", ".join(str(path) for path in (page, record, paper) if path is not None)
    return Outcome(document, lambda screen: screen.line(f"written: {written}"))


VERB = Verb("write a report about a fit, as one HTML page and as JSON", configure, run)
