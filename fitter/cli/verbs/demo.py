"""``brdf-fitter demo``: the whole job on a bundled table, from the file to the report."""

from __future__ import annotations

import argparse
import time
from typing import Any

from fitter.cli import reading
from fitter.cli.screen import Screen, number
from fitter.cli.values import output_folder
from fitter.cli.verb import Outcome, Verb
from fitter.errors import FitError

TABLE = "glossy_paint"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "table", nargs="?", metavar="NAME", default=TABLE, help=f"a sample table (default: {TABLE})"
    )
    parser.add_argument("--out", default="demo", metavar="DIR", help="where the results go (default: demo)")
    parser.add_argument(
        "--budget-seconds", type=float, default=60.0, metavar="X", help="for the posterior (default: 60)"
    )


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter import datasets
    from fitter.cli.numerics import start_numerics
    from fitter.formats import ReadOptions, describe
    from fitter.spec import FAMILIES, FitSpec, ModelSpec, posterior_spec

    settings = posterior_spec({"budget_seconds": given.budget_seconds})
    path = datasets.sample(given.table)
    out = output_folder(given.out)
    seconds: dict[str, float] = {}
    began = last = time.perf_counter()

    def lap(step: str) -> None:
        nonlocal last
        now = time.perf_counter()
        seconds[step] = now - last
        last = now

    opened = reading.open_table(path, ReadOptions())
    described = describe(opened.table)
    screen.note(f"{path.name}: {described['usable']:,} usable samples of {described['samples']:,}")
    lap("load")
    start_numerics(screen)
    from fitter.cli.verbs.fit import fit_all
    from fitter.posterior import sample
    from fitter.report import complete

    lap("start the numerics")
    specs = [FitSpec(model=ModelSpec(family=family)) for family in FAMILIES]
    results, failures = fit_all(opened.table, opened.source, specs, out, screen)
    for result in results:
        screen.note(
            f"{result.spec.model.name}: {result.status.replace('_', ' ')}, relative rmse "
            f"{number(result.metrics['relative_rmse'], 3)}"
        )
    if failures or not results:
        raise FitError("a model could not be fitted to a bundled table", code="demo-failed")
    lap("fit four models")
    from fitter.fitting.result import best

    chosen = best(results)
    with screen.progress(f"posterior of {chosen.spec.model.name}") as progress:
        posterior = sample(opened.table, chosen, settings, progress=progress)
    posterior.save(out / "posterior.json")
    screen.note(f"posterior of {chosen.spec.model.name}: {posterior.status.replace('_', ' ')}")
    lap("sample the posterior")
    others = [result for result in results if result is not chosen]
    complete(opened.table, chosen, posterior, others=others).save(out)
    lap("write the report")
    page = (out / "report.html").resolve()
    document: dict[str, Any] = {
        "kind": "brdf-fitter/demo",
        "table": str(path),
        "best": chosen.spec.model.name,
        "models": {
            result.spec.model.name: {"status": result.status, "metrics": dict(result.metrics)}
            for result in results
        },
        "posterior": posterior.status,
        "html": str(page),
        "seconds": {**seconds, "total": time.perf_counter() - began},
    }

    def show(screen: Screen) -> None:
        screen.fields({step: f"{spent:6.2f} s" for step, spent in document["seconds"].items()})
        screen.line(f"report: {page}")

    return Outcome(document, show)


VERB = Verb("do the whole job on a bundled table: fit, posterior, report", configure, run)
