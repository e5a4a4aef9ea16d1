"""``brdf-fitter tradeoff``: measure what accuracy costs, on this machine and this table."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from fitter.cli import reading
from fitter.cli.screen import Screen
from fitter.cli.values import duration, names, output_folder
from fitter.cli.verb import Outcome, Verb

if TYPE_CHECKING:
    from fitter.spec import TradeoffSpec
    from fitter.tradeoffs import Tradeoff


def configure(parser: argparse.ArgumentParser) -> None:
    from typing import get_args

    from fitter.spec import FAMILIES, Metric, TradeoffSpec

    default = {name: field.default for name, field in TradeoffSpec.model_fields.items()}
    parser.add_argument("table", metavar="TABLE", help="a measured table, or one that `compress` wrote")
    parser.add_argument(
        "--model", action="append", metavar="NAME",
        help="a model's short name (repeatable; the first is measured in full, the others in short; default: "
        f"{', '.join(FAMILIES)})",
    )  # fmt: skip
    parser.add_argument("--metric", choices=get_args(Metric), help="what is minimised (default: as `fit`)")
    parser.add_argument("--metrics", type=names, metavar="NAME,...", help="further metrics (default: all)")
    parser.add_argument("--solvers", type=names, metavar="NAME,...", help="further solvers (default: nlopt)")
    for option, what in (("subsets", "samples of the subsets"), ("starts", "numbers of starts")):
        parser.add_argument(f"--{option}", type=_whole, metavar="N,...", help=f"{what} (default: a ladder)")
    parser.add_argument(
        "--tolerances", type=_decimal, metavar="T,...", help="of compressed tables (default: a ladder)"
    )
    parser.add_argument("--channels", type=names, metavar="NAME,...", help="fit these channels only")
    parser.add_argument("--no-posterior", action="store_true", help="leave the posterior out")
    parser.add_argument(
        "--repeats", type=int, default=default["repeats"], metavar="N",
        help=f"warm runs of each fit, in turn, as far as the time allows (default: {default['repeats']})",
    )  # fmt: skip
    parser.add_argument(
        "--time-limit", type=duration, default=default["time_limit_seconds"], metavar="TIME",
        help="begin nothing more after this, as 30s or 5min; the fit that runs is finished "
        f"(default: {default['time_limit_seconds']:g}s)",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=default["seed"], metavar="S", help="of all that is drawn")
    parser.add_argument(
        "--out", metavar="DIR", help="write DIR/tradeoff.json, DIR/tradeoff.png and DIR/tradeoff.html"
    )
    reading.add_reading_options(parser)


def _whole(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in names(text))


def _decimal(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in names(text))


def _spec(given: argparse.Namespace) -> TradeoffSpec:
    from fitter.spec import FAMILIES, tradeoff_spec

    document: dict[str, Any] = {
        "models": tuple(given.model or FAMILIES), "metric": given.metric, "posterior": not given.no_posterior,
        "repeats": given.repeats, "time_limit_seconds": given.time_limit, "seed": given.seed,
        "select": {"channels": given.channels},
    }  # fmt: skip
    axes = ("metrics", "solvers", "subsets", "starts", "tolerances")
    return tradeoff_spec(document | {name: getattr(given, name) for name in axes})


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.cli.numerics import start_numerics

    out = None if given.out is None else output_folder(given.out)
    spec = _spec(given)
    opened = reading.open_table(given.table, reading.reading_options(given))
    start_numerics(screen)
    from fitter.tradeoffs import tradeoff

    with screen.progress("tradeoff") as progress:
        found = tradeoff(opened.table, spec, progress=progress)
    if out is not None:
        found.save(out)

    def show(screen: Screen) -> None:
        show_tradeoff(found, screen)
        if out is not None:
            screen.line(f"written: {out / 'tradeoff.json'}, {out / 'tradeoff.png'}, {out / 'tradeoff.html'}")

    return Outcome(found.to_dict(), show)


def show_tradeoff(found: Tradeoff, screen: Screen) -> None:
    """The numbers, the references they are judged by, and what was left out."""
    from fitter.tradeoffs import rows
    from fitter.tradeoffs.page import said_of_reference

    screen.table(rows.COLUMNS, rows.rows(found))
    screen.line("* on the Pareto front of this error and seconds (warm, fastest)")
    for one in found.references:
        screen.line(said_of_reference(one))
    if found.compression:
        screen.table(rows.COMPRESSION, rows.compression_rows(found), title="compression")
    if found.posterior is not None:
        screen.table(rows.POSTERIOR, rows.posterior_rows(found), title="posterior")
    if found.skipped:
        screen.line(f"left out by the time limit: {', '.join(found.skipped)}")
    for text in (*found.notes, str(found.noise["sentence"])):
        screen.line(f"note: {text}")


VERB = Verb("measure what accuracy costs: error against seconds and memory", configure, run)
