"""``brdf-fitter fit``: fit models to a table."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitter.cli import reading
from fitter.cli.screen import Screen
from fitter.cli.values import duration, named_number, named_range, names, output_folder, share
from fitter.cli.verb import DONE, WORK_FAILED, Outcome, Verb
from fitter.errors import FitError, SpecError

if TYPE_CHECKING:
    from fitter.fitting import FitResult
    from fitter.spec import FitSpec


def configure(parser: argparse.ArgumentParser) -> None:
    add_fit_arguments(parser)
    reading.add_reading_options(parser)


def add_fit_arguments(parser: argparse.ArgumentParser) -> None:
    """TABLE, the models, and every setting of a FitSpec."""
    from typing import get_args

    from fitter.spec import FAMILIES, FitSpec, Metric, Polish, Solver

    default = {name: field.default for name, field in FitSpec.model_fields.items()}
    parser.add_argument("table", metavar="TABLE", help="a measured table, or one that `compress` wrote")
    parser.add_argument(
        "--model", action="append", metavar="NAME",
        help="a model's short name, as ward or lafortune:2 (repeatable; see `brdf-fitter models`; default: "
        f"{', '.join(FAMILIES)})",
    )  # fmt: skip
    parser.add_argument(
        "--metric", choices=get_args(Metric),
        help="what is minimised (default: measurement where the table states its uncertainty, else cosine)",
    )  # fmt: skip
    parser.add_argument(
        "--solver", choices=get_args(Solver), default=default["solver"],
        help=f"how it is minimised (default: {default['solver']})",
    )  # fmt: skip
    parser.add_argument(
        "--fixed", type=named_number, action="append", default=[], metavar="NAME=VALUE",
        help="hold a nonlinear parameter, in every model that has it (repeatable)",
    )  # fmt: skip
    parser.add_argument(
        "--bounds", type=named_range, action="append", default=[], metavar="NAME=LOW,HIGH",
        help="narrow a nonlinear parameter's range, in every model that has it (repeatable)",
    )  # fmt: skip
    parser.add_argument(
        "--theta-i-max", type=float, metavar="DEG", help="leave out samples lit from beyond this"
    )
    parser.add_argument(
        "--theta-o-max", type=float, metavar="DEG", help="leave out samples seen from beyond this"
    )
    parser.add_argument("--channels", type=names, metavar="NAME,...", help="fit these channels only")
    parser.add_argument("--starts", type=int, metavar="N", help="starting points of the global search")
    parser.add_argument(
        "--subset", type=int, default=default["subset"], metavar="N",
        help=f"samples that the global search looks at; the polish uses all (default: {default['subset']})",
    )  # fmt: skip
    parser.add_argument(
        "--polish", choices=get_args(Polish), default=default["polish"],
        help=f"subset: never look beyond the subset (default: {default['polish']})",
    )  # fmt: skip
    parser.add_argument(
        "--budget", type=duration, metavar="TIME",
        help="the best fit within this, as 2s, compiling included; chooses --subset, --polish and --starts",
    )  # fmt: skip
    parser.add_argument(
        "--target-error", type=share, metavar="E",
        help="the cheapest fit whose rms residual is within this, as 1%%, of the same model's best",
    )  # fmt: skip
    parser.add_argument(
        "--seed", type=int, default=default["seed"], metavar="S",
        help=f"the same seed gives the same fit (default: {default['seed']})",
    )  # fmt: skip
    parser.add_argument(
        "--compress", type=float, metavar="TOL", help="fit the table compressed to this relative error bound"
    )
    parser.add_argument(
        "--out", metavar="DIR", help="write one result a model, DIR/NAME.json (a : in the name becomes a -)"
    )


def specs(given: argparse.Namespace) -> list[FitSpec]:
    """One FitSpec a model. Raises SpecError, also for a parameter that none of the models has."""
    from fitter.models import parameter_table
    from fitter.spec import FAMILIES, ModelSpec, fit_spec

    models = [ModelSpec.parse(name) for name in given.model or FAMILIES]
    asked = [model.name for model in models]
    twice = sorted({name for name in asked if asked.count(name) > 1})
    if twice:
        raise SpecError(f"{', '.join(twice)} is asked for twice", code="bad-call", parameter="model")
    known = {model.name: {p.name for p in parameter_table(model) if not p.linear} for model in models}
    for option, pairs in (("fixed", given.fixed), ("bounds", given.bounds)):
        for name, _ in pairs:
            if not any(name in nonlinear for nonlinear in known.values()):
                have = "; ".join(f"{model}: {', '.join(sorted(n))}" for model, n in known.items())
                raise SpecError(
                    f"--{option} names {name!r}, which is no nonlinear parameter of {', '.join(known)}",
                    code="unknown-parameter", parameter=name, remedy=f"the nonlinear parameters are {have}",
                )  # fmt: skip
    common: dict[str, Any] = {
        "metric": given.metric, "solver": given.solver, "starts": given.starts, "subset": given.subset,
        "polish": given.polish, "budget_seconds": given.budget, "target_error": given.target_error,
        "seed": given.seed,
        "select": {
            "theta_i_max_deg": given.theta_i_max, "theta_o_max_deg": given.theta_o_max,
            "channels": given.channels,
        },
    }  # fmt: skip
    return [
        fit_spec(
            {
                **common,
                "model": model,
                "fixed": {n: v for n, v in given.fixed if n in known[model.name]},
                "bounds": {n: v for n, v in given.bounds if n in known[model.name]},
            }
        )
        for model in models
    ]


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.cli.numerics import start_numerics
    from fitter.cli.results import FITS, file_name, show_fit

    out = None if given.out is None else output_folder(given.out)
    opened = reading.open_table(given.table, reading.reading_options(given))
    if given.compress is not None:
        opened = opened.compressed_to(given.compress)
    start_numerics(screen)
    results, failures = fit_all(opened, specs(given), out, screen)

    def show(screen: Screen) -> None:
        for result in results:
            show_fit(result, screen)
            screen.line()
        if out is not None and results:
            screen.line(f"written: {', '.join(str(out / file_name(r.spec.model.name)) for r in results)}")

    if len(results) == 1 and not failures:
        document: dict[str, Any] = results[0].to_dict()
    elif len(failures) == 1 and not results:
        document = {"error": failures[0]["error"]}
    else:
        document = {"kind": FITS, "fits": [result.to_dict() for result in results], "failures": failures}
    return Outcome(document, show, WORK_FAILED if failures else DONE)


def fit_all(
    opened: reading.Opened, wanted: Sequence[FitSpec], out: Path | None, screen: Screen
) -> tuple[list[FitResult], list[dict[str, Any]]]:
    """The fits that worked, each written to ``out`` as soon as it is there, and the others' failures."""
    from fitter.cli.results import file_name, remember
    from fitter.fitting import fit

    results: list[FitResult] = []
    failures: list[dict[str, Any]] = []
    for spec in wanted:
        name = spec.model.name
        try:
            with screen.progress(name) as progress:
                result = remember(fit(opened.small or opened.table, spec, progress=progress), opened.source)
        except FitError as error:
            # The other models may well fit: this one's failure is a result of its own.
            screen.note(f"error: {name}: {error}")
            failures.append({"model": name, "error": error.to_dict()})
            continue
        results.append(result)
        if out is not None:
            result.save(out / file_name(name))
    return results, failures


def epilog() -> str:
    """The nonlinear parameters that --fixed and --bounds may name, from the parameter tables."""
    from fitter.models import parameter_table
    from fitter.spec import FAMILIES

    lines = ["nonlinear parameters (for --fixed and --bounds):"]
    for family in FAMILIES:
        lines += [
            f"  {family:<17} {p.name:<7} [{p.lower:g}, {p.upper:g}]  {p.description}"
            for p in parameter_table(family)
            if not p.linear
        ]
    return "\n".join(lines)


VERB = Verb("fit reflectance models to a table", configure, run, epilog)
