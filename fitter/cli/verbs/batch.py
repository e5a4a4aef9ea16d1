"""``brdf-fitter batch``: many tables, several models each, on all cores or a cluster."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitter.cli import reading
from fitter.cli.screen import Screen, file_size
from fitter.cli.values import duration, output_folder
from fitter.cli.verb import DONE, WORK_FAILED, Outcome, Verb
from fitter.errors import SpecError

if TYPE_CHECKING:
    from fitter.batch import BatchSpec, Fetched, Plan

    #: Gets the tables ``server:ID`` of a specification into a folder: by these names, what has come.
    Fetch = Callable[[BatchSpec, Path], Mapping[str, Fetched]]

_SPECS = (".yaml", ".yml", ".toml")


def configure(parser: argparse.ArgumentParser) -> None:
    from typing import get_args

    from fitter.spec import Metric

    parser.add_argument(
        "tables", nargs="*", metavar="TABLE",
        help="files, folders, archives, patterns and, with --server, server:ID; or one specification (.yaml, "
        ".toml), which says it all",
    )  # fmt: skip
    parser.add_argument(
        "--manifest", metavar="FILE", help="a CSV file with a column path, and a row for each table"
    )
    parser.add_argument(
        "--model", action="append", metavar="NAME",
        help="a model's short name, or auto (repeatable; default: the four families)",
    )  # fmt: skip
    parser.add_argument("--metric", choices=get_args(Metric), help="what is minimised")
    parser.add_argument("--budget", type=duration, metavar="TIME", help="for each fit, as 2s or 500ms")
    parser.add_argument(
        "--posterior", action="store_true", help="sample the posterior of each table's best fit"
    )
    parser.add_argument("--no-report", action="store_true", help="write no report about the best fit")
    parser.add_argument(
        "--export", action="append", metavar="NAME", help="write the best fit for this program (repeatable)"
    )
    parser.add_argument("--seed", type=int, metavar="N", help="for everything random (default: 0)")
    parser.add_argument(
        "--out", metavar="DIR", help="where everything is written; the same command goes on from there"
    )
    parser.add_argument(
        "--workers", type=int, metavar="N", help="processes (default: one a core; 1 needs no Dask)"
    )
    parser.add_argument(
        "--scheduler", metavar="tcp://...", help="a running Dask scheduler, instead of own processes"
    )
    parser.add_argument(
        "--dry-run", action="store_true", help="show what would be done, and estimate it by doing a part"
    )
    reading.add_reading_options(parser)


def run(given: argparse.Namespace, screen: Screen, fetch: Fetch | None = None) -> Outcome:
    """Do the batch; ``fetch`` gets a service's tables."""
    from fitter import batch

    if given.workers is not None and given.workers < 1:
        raise SpecError(
            "a batch needs a worker", code="bad-call", parameter="workers", remedy="give 1 or more"
        )
    spec = _spec(given)
    if not given.dry_run and given.out is None:
        raise SpecError(
            "there is no folder to write to", code="bad-call", parameter="out", remedy="name one with --out"
        )
    with tempfile.TemporaryDirectory() as aside:  # of a dry run, which leaves nothing
        place = Path(aside if given.dry_run else given.out) / "fetched"
        return _planned(batch.plan(spec, None if fetch is None else fetch(spec, place)), given, screen)


def _planned(plan: Plan, given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter import batch
    from fitter.cli.numerics import start_numerics

    for one in plan.refused:
        screen.note(f"{one['table']}: {one['error']['message']}")
    if given.dry_run:
        start_numerics(screen)
        return _dry(plan, given.workers, screen)
    out = output_folder(given.out)
    if given.workers == 1 and given.scheduler is None:
        start_numerics(screen)
    with screen.progress(f"{len(plan.units)} tables") as progress:
        done = batch.run(plan, out, workers=given.workers, scheduler=given.scheduler, progress=progress)

    def show(screen: Screen) -> None:
        kept = f", {done.kept} were done before" if done.kept else ""
        failed = f", {done.failed} with a failure" if done.failed else ""
        screen.line(f"{done.done} done in {done.seconds:.1f} s{kept}{failed}")
        screen.line(f"written: {out / 'index.html'}, summary.csv, summary.parquet, tables/")

    return Outcome(done.to_dict(), show, WORK_FAILED if done.failed else DONE)


def _dry(plan: Plan, workers: int | None, screen: Screen) -> Outcome:
    from fitter import batch

    with screen.progress("estimating") as progress:
        found = batch.estimate(plan, workers=workers, progress=progress)
    document: dict[str, Any] = {
        "kind": "brdf-fitter/batch-plan", **plan.to_dict(), "estimate": found.to_dict(),
    }  # fmt: skip

    def show(screen: Screen) -> None:
        screen.table(
            ("table", "format", "size", "file"),
            [
                [unit.name, unit.format, file_size(unit.size), unit.member or Path(unit.paths[0]).name]
                for unit in plan.units
            ],
        )
        fits = "fits of the models that each supports" if found.fits is None else f"{found.fits} fits"
        screen.line(
            f"{found.tables} files, {fits}, {len(plan.refused)} files that can't be read: about "
            f"{found.seconds:.0f} s on {found.workers} workers of up to {file_size(found.memory)} each"
        )
        screen.line(f"measured on {', '.join(found.tried)}; files that hold several tables count as one")

    return Outcome(document, show)


def _spec(given: argparse.Namespace) -> BatchSpec:
    """What is asked, from a specification's file or from the options."""
    from fitter import batch

    files = [one for one in given.tables if Path(one).suffix.lower() in _SPECS]
    options = {
        "models": given.model, "metric": given.metric, "budget_seconds": given.budget,
        "posterior": {} if given.posterior else None, "report": False if given.no_report else None,
        "exports": given.export, "seed": given.seed, "manifest": given.manifest,
        "reading": reading.reading_options(given).to_dict() or None,
    }  # fmt: skip
    named = {name: value for name, value in options.items() if value is not None}
    if files:
        if len(given.tables) > 1 or named:
            others = ", ".join([*named, *(one for one in given.tables if one not in files)])
            raise SpecError(
                "a specification says it all: it stands alone", code="bad-call", parameter="TABLE",
                remedy=f"write what you want of {others or files[1]} into {files[0]}",
            )  # fmt: skip
        return batch.read_spec(files[0])
    if not given.tables and given.manifest is None:
        raise SpecError(
            "no table is named", code="bad-call", parameter="TABLE",
            remedy="name files, folders or patterns, or a manifest, or a specification",
        )  # fmt: skip
    if named.get("models") == ["auto"]:
        named["models"] = "auto"
    return batch.batch_spec({"tables": given.tables, **named})


VERB = Verb("fit models to many tables", configure, run)
