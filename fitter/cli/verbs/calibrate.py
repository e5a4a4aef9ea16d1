"""``brdf-fitter calibrate``: are posteriors of this model on these directions right as often as they say?"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from fitter.cli import reading
from fitter.cli.screen import Screen
from fitter.cli.values import duration, named_range, output_folder
from fitter.cli.verb import Outcome, Verb

if TYPE_CHECKING:
    from fitter.calibration import Calibration

#: Settings of each simulation's posterior.
OF_POSTERIOR = {
    "ensembles": "independent ensembles of walkers",
    "rhat": "a posterior has converged when R-hat is below this",
    "ess": "and the smallest effective sample size is above this",
    "budget_seconds": "of one posterior; one that has not converged by then counts as a failure",
    "max_samples": "use at most this many of the table's directions",
}


def configure(parser: argparse.ArgumentParser) -> None:
    from fitter.spec import CalibrationSpec

    default = {name: field.default for name, field in CalibrationSpec.model_fields.items()}
    parser.add_argument("result", metavar="RESULT.json", help="a fit that `fit` wrote or printed")
    parser.add_argument("--model", metavar="NAME", help="which fit, where the file holds several")
    parser.add_argument(
        "--table", metavar="TABLE", help="the table, where it is not where it was when fitted"
    )
    parser.add_argument(
        "--simulations", type=int, default=default["simulations"], metavar="N",
        help=f"tables to simulate (default: {default['simulations']})",
    )  # fmt: skip
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--around", type=float, default=default["around"], metavar="K",
        help="draw the truths within K standard uncertainties of the fit "
        f"(default: {default['around']:g})",
    )  # fmt: skip
    where.add_argument("--whole-prior", action="store_true", help="draw them from the whole prior")
    parser.add_argument(
        "--range", type=named_range, action="append", default=[], metavar="NAME=LOW,HIGH",
        help="draw this parameter from here (repeatable)",
    )  # fmt: skip
    parser.add_argument(
        "--noise", choices=("table", "inferred"),
        help="simulate the table's sigma, or a relative noise and a floor that are inferred (default: table "
        "where it states sigma, else inferred)",
    )  # fmt: skip
    for name, what in OF_POSTERIOR.items():
        usual = getattr(default["posterior"], name)
        parser.add_argument(
            f"--{name.replace('_', '-')}", type=type(usual), default=usual,
            metavar="X" if isinstance(usual, float) else "N", help=f"{what} (default: {usual:g})",
        )  # fmt: skip
    parser.add_argument(
        "--time-limit", type=duration, metavar="TIME", help="end after this, as 30s or 5min (default: never)"
    )
    parser.add_argument(
        "--seed", type=int, default=default["seed"], metavar="S", help="the same seed gives the same tables"
    )
    parser.add_argument("--out", metavar="DIR", help="write DIR/calibration.json and DIR/calibration.png")
    reading.add_reading_options(parser)


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.cli.numerics import start_numerics
    from fitter.cli.results import load_result
    from fitter.spec import calibration_spec

    out = None if given.out is None else output_folder(given.out)
    spec = calibration_spec(
        {
            "simulations": given.simulations, "around": None if given.whole_prior else given.around,
            "ranges": dict(given.range), "noise": given.noise, "time_limit_seconds": given.time_limit,
            "seed": given.seed, "posterior": {name: getattr(given, name) for name in OF_POSTERIOR},
        }
    )  # fmt: skip
    start_numerics(screen)
    from fitter.calibration import calibrate

    fit = load_result(given.result, given.model)
    opened = reading.table_of(fit.table, given.table, reading.reading_options(given), result=given.result)
    with screen.progress(f"calibration of {fit.spec.model.name}") as progress:
        found = calibrate(opened.table, fit, spec, progress=progress)
    if out is not None:
        found.save(out)

    def show(screen: Screen) -> None:
        show_calibration(found, screen)
        if out is not None:
            screen.line(f"written: {out / 'calibration.json'}, {out / 'calibration.png'}")

    document: dict[str, Any] = found.to_dict()
    return Outcome(document, show)


def show_calibration(found: Calibration, screen: Screen) -> None:
    """The verdict, and one line a parameter."""
    screen.line(f"{found.fit_spec.model.name}: {found.status.replace('_', ' ')}: {found.message}")
    low, high = found.coverage_band
    rows: list[list[str]] = []
    for row in found.rows():
        a, b = found.ranges.get(row.label, (None, None))
        rows.append(
            [
                row.label, "" if a is None or b is None else f"{a:.4g} to {b:.4g}", f"{row.p:.3g}",
                "yes" if row.uniform else "NO", "" if row.covered is None else f"{row.covered}",
                "" if row.covered is None else f"{low} to {high}",
                "" if row.covers is None else "yes" if row.covers else "NO",
            ]
        )  # fmt: skip
    screen.table(("parameter", "truths", "p of ranks", "uniform", "covered", "by chance", "covers"), rows)
    for reason, count in found.failures.items():
        screen.line(f"failed: {count}, {reason.replace('_', ' ')}")
    screen.line(f"{found.seconds:.1f} s, {found.seconds / max(1, found.simulations):.2f} s a simulation")


VERB = Verb("judge a model's posteriors by simulations on a table's directions", configure, run)
