"""``brdf-fitter posterior``: sample the posterior of a fit's parameters."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitter.cli import reading
from fitter.cli.screen import Screen, number
from fitter.cli.values import output_file
from fitter.cli.verb import Outcome, Verb

if TYPE_CHECKING:
    from fitter.posterior import Posterior
    from fitter.spec import PosteriorSpec

#: Settings that are one of a few words.
CHOICES = ("noise", "likelihood", "angles", "draws")
#: What each setting of a PosteriorSpec is, for --help. Its name, type, default and limits are the spec's.
SETTINGS = {
    "degrees_of_freedom": "of student_t, whose scale is sigma; they are given, not inferred",
    "angle_uncertainty_deg": "standard uncertainty of the instrument's angles: their offsets are sampled",
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
    from typing import get_args

    from fitter.spec import Angles, Draws, Likelihood, NoiseModel, PosteriorSpec

    parser.add_argument("result", metavar="RESULT.json", help="a fit that `fit` wrote or printed")
    parser.add_argument("--model", metavar="NAME", help="which fit, where the file holds several")
    parser.add_argument(
        "--table", metavar="TABLE", help="the table, where it is not where it was when fitted"
    )
    for name, kind, what in (
        (
            "noise", NoiseModel, "take the table's sigma as it is, or infer a relative noise and a floor "
            "(default: table where it states sigma, else inferred)",
        ),
        ("likelihood", Likelihood, "distribution of the noise (default: gaussian)"),
        (
            "angles", Angles, "take the angles as they are, or sample offsets of them, as uncertain as the "
            "table states (default: exact)",
        ),
        (
            "draws", Draws, "draws of the posterior, or these rescaled to the uncertainty that holds where "
            "the residuals of a scan belong together (default: posterior)",
        ),
    ):  # fmt: skip
        parser.add_argument(
            f"--{name}", choices=get_args(kind), default=PosteriorSpec.model_fields[name].default, help=what
        )
    for name, what in SETTINGS.items():
        default = PosteriorSpec.model_fields[name].default
        parser.add_argument(
            f"--{name.replace('_', '-')}", type=float if _is_real(name) else int, default=default,
            metavar="X" if _is_real(name) else "N",
            help=what + ("" if default is None else f" (default: {default:g})"),
        )  # fmt: skip
    parser.add_argument("--out", metavar="FILE", help="write the posterior, draws and all")
    parser.add_argument(
        "--checkpoint", metavar="DIR",
        help="keep the run here as it goes on, and go on from here after a kill; deleted at the end, unless "
        "the budget came before the targets (default: FILE.checkpoint where there is an --out FILE)",
    )  # fmt: skip
    reading.add_reading_options(parser)


def _is_real(name: str) -> bool:
    from fitter.spec import PosteriorSpec

    return "float" in str(PosteriorSpec.model_fields[name].annotation)


def posterior_asked(given: argparse.Namespace) -> PosteriorSpec:
    """The settings that were given. Raises SpecError."""
    from fitter.spec import posterior_spec

    return posterior_spec({name: getattr(given, name) for name in (*CHOICES, *SETTINGS)})


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.cli.numerics import start_numerics
    from fitter.cli.results import load_result

    out = None if given.out is None else output_file(given.out)
    kept = None if given.checkpoint is None else Path(given.checkpoint)
    if kept is None and out is not None:
        kept = out.with_name(f"{out.name}.checkpoint")
    spec = posterior_asked(given)
    start_numerics(screen)
    from fitter.posterior import sample

    fit = load_result(given.result, given.model)
    opened = reading.table_of(fit.table, given.table, reading.reading_options(given), result=given.result)
    with screen.progress(f"posterior of {fit.spec.model.name}") as progress:
        posterior = sample(opened.table, fit, spec, checkpoint=kept, progress=progress)
    if out is not None:
        posterior.save(out)
    if posterior.status != "converged":
        screen.note(f"{posterior.status.replace('_', ' ')}: {posterior.message}")
    if kept is not None and posterior.status != "not_converged":
        shutil.rmtree(kept)
    elif kept is not None:
        screen.note(f"the same command with a larger --budget-seconds goes on from {kept}")

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
    beside = [name for name in ("naive", "robust") if posterior.uncertainties[name] is not None]
    rows: list[list[str]] = []
    for label, interval in posterior.intervals().items():
        row = [
            label,
            *(number(interval[key]) for key in ("median", "lower", "upper")),
            number(interval["sd"], 2),
        ]
        for name in beside:
            u = posterior.uncertainties[name]["u"].get(label)
            row.append("-" if u is None else number(u, 2))
        diagnostic = posterior.diagnostics.get(label)
        row += ["-", "-"] if diagnostic is None else [f"{diagnostic.rhat:.4f}", f"{diagnostic.ess_bulk:,.0f}"]
        rows.append(row)
    names = [f"{name} u" for name in beside]
    screen.table(("parameter", "median", "95 % from", "to", "sd", *names, "R-hat", "ESS"), rows)
    if posterior.spec.draws == "robust":
        screen.line("  draws and sd are rescaled to the robust uncertainty, whose tails are Student's t")
    for name in ("posterior", *beside):
        words = posterior.uncertainties[name]["words"]
        screen.line(f"  {'sd, of the posterior' if name == 'posterior' else f'{name} u'}: {words}")
    screen.line(f"  u belongs to {posterior.uncertainties['refers_to']}")
    for warning in posterior.warnings:
        screen.line(f"  warning: {warning}")


VERB = Verb("sample the posterior of a fit's parameters", configure, run)
