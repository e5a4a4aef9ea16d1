"""``brdf-fitter posterior``: sample the posterior of a fit's parameters."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from fitter.cli import reading
from fitter.cli.screen import Screen, number
from fitter.cli.values import output_file
from fitter.cli.verb import Outcome, Verb

if TYPE_CHECKING:
    from fitter.posterior import Posterior

#: What each setting of a PosteriorSpec is, for --help. Its name, type, default and limits are the spec's.
SETTINGS = {
    "ensembles": "independent ensembles of walkers",
    "walkers": "walkers in each ensemble (default: by the number of parameters)",
    "rhat": "converged when R-hat over all walkers of all ensembles is below this",
    "ess": "and the smallest effective sample size is above this",
    "budget_seconds": "stop after this time, converged or not (and say which)",
    "max_samples": "use at most this many of the table's samples",
    "keep": "draws to keep",
    "seed": "the same seed gives the same draws",
}


def configure(parser: argparse.ArgumentParser) -> None:
    from fitter.spec import PosteriorSpec

    parser.add_argument("result", metavar="RESULT.json", help="a fit that `fit` wrote or printed")
    parser.add_argument("--model", metavar="NAME", help="which fit, where the file holds several")
    parser.add_argument(
        "--table", metavar="TABLE", help="the table, where it is not where it was when fitted"
    )
    parser.add_argument(
        "--noise", choices=("table", "inferred"),
        help="take the table's sigma as it is, or infer a relative noise and a floor (default: table where "
        "it states sigma, else inferred)",
    )  # fmt: skip
    for name, what in SETTINGS.items():
        default = PosteriorSpec.model_fields[name].default
        parser.add_argument(
            f"--{name.replace('_', '-')}", type=float if isinstance(default, float) else int, default=default,
            metavar="X" if isinstance(default, float) else "N",
            help=what + ("" if default is None else f" (default: {default:g})"),
        )  # fmt: skip
    parser.add_argument("--out", metavar="FILE", help="write the posterior, draws and all")
    reading.add_reading_options(parser)


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.cli.numerics import start_numerics
    from fitter.cli.results import load_result
    from fitter.spec import posterior_spec

    out = None if given.out is None else output_file(given.out)
    spec = posterior_spec({"noise": given.noise, **{name: getattr(given, name) for name in SETTINGS}})
    start_numerics(screen)
    from fitter.posterior import sample

    fit = load_result(given.result, given.model)
    opened = reading.table_of(fit.table, given.table, reading.reading_options(given), result=given.result)
    with screen.progress(f"posterior of {fit.spec.model.name}") as progress:
        posterior = sample(opened.table, fit, spec, progress=progress)
    if posterior.status != "converged":
        screen.note(f"not converged: {posterior.message}")
    if out is not None:
        posterior.save(out)

    def show(screen: Screen) -> None:
        show_posterior(posterior, screen)
        if out is not None:
            screen.line(f"written: {out}")

    document: dict[str, Any] = posterior.to_dict()
    return Outcome(document, show)


def show_posterior(posterior: Posterior, screen: Screen) -> None:
    """Credible intervals and convergence, one line a parameter."""
    screen.line(
        f"{posterior.template.spec.name}: {posterior.status.replace('_', ' ')} in {posterior.seconds:.2f} s, "
        f"{len(posterior.draws):,} draws kept, acceptance {posterior.acceptance:.2f}"
    )
    rows: list[list[str]] = []
    for label, interval in posterior.intervals().items():
        row = [
            label,
            *(number(interval[key]) for key in ("median", "lower", "upper")),
            number(interval["sd"], 2),
        ]
        diagnostic = posterior.diagnostics.get(label)
        row += ["-", "-"] if diagnostic is None else [f"{diagnostic.rhat:.4f}", f"{diagnostic.ess_bulk:,.0f}"]
        rows.append(row)
    screen.table(("parameter", "median", "95 % from", "to", "sd", "R-hat", "ESS"), rows)
    for warning in posterior.warnings:
        screen.line(f"  warning: {warning}")


VERB = Verb("sample the posterior of a fit's parameters", configure, run)
