"""``brdf-fitter fit``: fit models to a table."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitter.cli import reading
from fitter.cli.screen import Screen, number
from fitter.cli.values import duration, named_number, named_range, names, output_folder, share
from fitter.cli.verb import DONE, WORK_FAILED, Outcome, Verb
from fitter.errors import FitError, SpecError

if TYPE_CHECKING:
    from fitter.compression import CompressedTable
    from fitter.fitting import FitResult
    from fitter.large import LargeTable
    from fitter.selection import Selection
    from fitter.spec import FitSpec, SelectionSpec
    from fitter.table import Table


def configure(parser: argparse.ArgumentParser) -> None:
    add_fit_arguments(parser)
    reading.add_out_of_core(parser)
    reading.add_reading_options(parser)


def add_fit_arguments(parser: argparse.ArgumentParser) -> None:
    """TABLE, the models, and every setting of a FitSpec."""
    from typing import get_args

    from fitter.spec import FAMILIES, FitSpec, Metric, Polish, SelectionSpec, Solver, Weighting

    default = {name: field.default for name, field in FitSpec.model_fields.items()}
    parser.add_argument("table", metavar="TABLE", help="a measured table, or one that `compress` wrote")
    parser.add_argument(
        "--model", action="append", metavar="NAME",
        help="a model's short name, as ward or lafortune:2 (repeatable; see `brdf-fitter models`), or auto: "
        f"compare models and take the one that the table supports (default: {', '.join(FAMILIES)})",
    )  # fmt: skip
    parser.add_argument(
        "--candidates", type=names, metavar="NAME,...",
        help="with --model auto: compare these models only",
    )  # fmt: skip
    parser.add_argument(
        "--folds", type=int, metavar="K",
        help="with --model auto: how many parts the scans are dealt into, each held out once (default: "
        f"{SelectionSpec.model_fields['folds'].default})",
    )  # fmt: skip
    parser.add_argument(
        "--metric", choices=get_args(Metric),
        help="what is minimised (default: measurement where the table states its uncertainty, else cbrt)",
    )  # fmt: skip
    parser.add_argument(
        "--weighting", choices=get_args(Weighting),
        help="whether every sample counts alike, or by the solid angles that it stands for (default: "
        "solid_angle for tables on a grid, but for the metrics measurement and absolute)",
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
    return [
        fit_spec(
            {
                **_common(given),
                "weighting": given.weighting, "polish": given.polish,
                "budget_seconds": given.budget, "target_error": given.target_error,
                "model": model,
                "fixed": {n: v for n, v in given.fixed if n in known[model.name]},
                "bounds": {n: v for n, v in given.bounds if n in known[model.name]},
            }
        )
        for model in models
    ]


def selection(given: argparse.Namespace) -> SelectionSpec | None:
    """What --model auto asks for, None where models are named. Raises SpecError."""
    from fitter.spec import AUTO, selection_spec

    if AUTO not in (given.model or ()):
        for option in ("candidates", "folds"):
            if getattr(given, option) is not None:
                raise SpecError(
                    f"--{option} belongs to --model auto", code="bad-call", parameter=option,
                    remedy="add --model auto, or leave it out",
                )  # fmt: skip
        return None
    if len(given.model) > 1:
        raise SpecError(
            "--model auto stands alone", code="bad-call", parameter="model",
            remedy="name the models to compare with --candidates",
        )  # fmt: skip
    for option in ("fixed", "bounds", "weighting", "target_error"):
        if getattr(given, option):
            raise SpecError(
                f"--{option.replace('_', '-')} can't go with --model auto", code="bad-call",
                parameter=option, cause="it is for the fit of one model", remedy="name the model",
            )  # fmt: skip
    folds = {} if given.folds is None else {"folds": given.folds}
    return selection_spec(
        {**_common(given), **folds, "candidates": given.candidates, "budget_seconds": given.budget}
    )  # fmt: skip


def _common(given: argparse.Namespace) -> dict[str, Any]:
    """The settings that a fit and a comparison have in common."""
    return {
        "metric": given.metric, "solver": given.solver, "starts": given.starts, "subset": given.subset,
        "seed": given.seed,
        "select": {
            "theta_i_max_deg": given.theta_i_max, "theta_o_max_deg": given.theta_o_max,
            "channels": given.channels,
        },
    }  # fmt: skip


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.cli.numerics import start_numerics
    from fitter.cli.results import fits_document, show_fit

    chosen_by = selection(given)
    out = None if given.out is None else output_folder(given.out)
    if given.out_of_core and given.compress is not None:
        raise SpecError(
            "--compress needs the table in memory", code="bad-call", parameter="compress",
            remedy="leave out --compress or --out-of-core",
        )  # fmt: skip
    if given.out_of_core and chosen_by is not None:
        raise SpecError(
            "auto compares models on a table in memory", code="bad-call", parameter="model",
            remedy="name the model, or leave out --out-of-core",
        )  # fmt: skip
    if given.out_of_core:
        options = reading.reading_options(given).to_dict()
        source = {"path": str(Path(given.table).resolve()), "options": options, "out_of_core": True}
        table, small = reading.open_large(given, given.seed, screen), None
    else:
        opened = reading.open_table(given.table, reading.reading_options(given))
        if given.compress is not None:
            opened = opened.compressed_to(given.compress)
        table, small, source = opened.table, opened.small, opened.source
    start_numerics(screen)
    if chosen_by is not None:
        return _compared(small or table, source, chosen_by, out, screen)
    results, failures = fit_all(small or table, source, specs(given), out, screen)

    def show(screen: Screen) -> None:
        for result in results:
            show_fit(result, screen)
            screen.line()
        if out is not None and results:
            screen.line(f"written: {', '.join(str(out / r.spec.model.file_name) for r in results)}")

    document = fits_document([result.to_dict() for result in results], failures)
    return Outcome(document, show, WORK_FAILED if failures else DONE)


def _compared(
    table: Table | CompressedTable | LargeTable, source: Mapping[str, Any], wanted: SelectionSpec,
    out: Path | None, screen: Screen,
) -> Outcome:
    """Models compared; the best few are written like named ones, and the comparison beside them."""
    from fitter.cli.results import show_fit
    from fitter.documents import FITS
    from fitter.large import LargeTable
    from fitter.selection import select

    with screen.progress("auto") as progress:
        assert not isinstance(table, LargeTable)  # refused when the command was read
        found = select(table, wanted, progress=progress)
    results = [result.with_source(source) for result in found.fits]
    if out is not None:
        for result in results:
            result.save(out / result.spec.model.file_name)
        found.save(out / "selection.json")

    def show(screen: Screen) -> None:
        show_selection(found, screen)
        show_fit(results[0], screen)
        if out is not None:
            files = [result.spec.model.file_name for result in results]
            screen.line()
            screen.line(f"written: {', '.join(str(out / name) for name in [*files, 'selection.json'])}")

    document = {
        "kind": FITS, "fits": [result.to_dict() for result in results], "failures": [],
        "selection": found.summary(),
    }  # fmt: skip
    return Outcome(document, show)


def show_selection(found: Selection, screen: Screen) -> None:
    """The ranking, the models that were no candidates, and what follows from it all."""
    rows: list[list[str]] = []
    for one in found.ranking:
        against = one.against_best
        rows.append(
            [
                ("* " if one.model == found.chosen.spec.model.name else "  ") + one.model,
                str(one.parameters),
                number(one.error, 4) + ("" if one.held_out else " (fitted)"),
                f"{100 * one.relative_error:.2g} %",
                "-" if against is None else f"{against.ratio:.3f} [{against.lower:.3f}, {against.upper:.3f}]",
                f"{one.information_criterion:.3g}",
            ]
        )
    screen.table(("  model", "parameters", "error", "relative", "to the best [95 %]", "BIC"), rows)
    by_reason: dict[str, list[str]] = {}
    for one in found.not_candidates:
        by_reason.setdefault(one.reason, []).append(one.model)
    for reason, left_out in by_reason.items():
        screen.line(f"  not compared: {', '.join(left_out)}: {reason}")
    for sentence in found.sentences:
        screen.line(sentence)
    screen.line(f"{found.cost['fits']} fits in {found.cost['seconds']:.1f} s")
    screen.line()


def fit_all(
    table: Table | CompressedTable | LargeTable, source: Mapping[str, Any], wanted: Sequence[FitSpec],
    out: Path | None, screen: Screen,
) -> tuple[list[FitResult], list[dict[str, Any]]]:
    """The fits that worked, each written to ``out`` as soon as it is there, and the others' failures."""
    from fitter.fitting import fit

    results: list[FitResult] = []
    failures: list[dict[str, Any]] = []
    for spec in wanted:
        name = spec.model.name
        try:
            with screen.progress(name) as progress:
                result = fit(table, spec, progress=progress).with_source(source)
        except FitError as error:
            # The other models may well fit: this one's failure is a result of its own.
            screen.note(f"error: {name}: {error}")
            failures.append({"model": name, "error": error.to_dict()})
            continue
        results.append(result)
        if out is not None:
            result.save(out / spec.model.file_name)
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
