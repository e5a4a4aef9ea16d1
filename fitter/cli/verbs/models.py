"""``brdf-fitter models``: the reflectance models, their options and their parameters."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from fitter.cli.screen import Screen, number
from fitter.cli.verb import DONE, WORK_FAILED, Outcome, Verb

if TYPE_CHECKING:
    from fitter.spec import ModelSpec


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "model",
        nargs="*",
        metavar="MODEL",
        help="short names, as ward:bounded or lafortune:2 (default: all families)",
    )
    parser.add_argument(
        "--check",
        action="store_true",
        help="test the models numerically on this machine and print the figures; exit status 1 if any breaks "
        "its bound",
    )


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.models.describe import default, describe
    from fitter.spec import OPTIONS, ModelSpec

    specs = [ModelSpec.parse(name) for name in given.model] or [default(family) for family in OPTIONS]
    if given.check:
        return _check(specs, screen, distributions=not given.model)
    described: list[dict[str, Any]] = []
    missing: list[str] = []
    for spec in specs:
        try:
            described.append(describe(spec))
        except ImportError as error:
            missing.append(spec.family)
            screen.note(f"MISSING: {spec.family}: {error}")

    def show(screen: Screen) -> None:
        for model in described:
            _show(screen, model)

    document = {"kind": "brdf-fitter/models", "models": described, "missing": missing}
    return Outcome(document, show, WORK_FAILED if missing else DONE)


def _check(specs: Sequence[ModelSpec], screen: Screen, *, distributions: bool) -> Outcome:
    from fitter.cli.numerics import start_numerics
    from fitter.models import check

    start_numerics(screen)
    models: list[dict[str, Any]] = []
    with screen.progress("check") as report:
        for k, spec in enumerate(specs):
            report(k / len(specs), spec.name)
            models.append(check.check(spec))
        ndfs = check.check_distributions() if distributions else None
    everything = [*models, *([ndfs] if ndfs else [])]
    ok = all(one["ok"] for one in everything)

    def show(screen: Screen) -> None:
        for one in everything:
            screen.line(f"{one['name']}: {'ok' if one['ok'] else 'FAILED'}, {one['seconds']:.1f} s")
            if one["error"]:
                screen.line(f"  {one['error']}")
            screen.table(
                ("figure", "value", "bound", "", "where"),
                [
                    [f["name"], number(f["value"], 3), _bound(f), "" if f["ok"] else "FAILED", f["where"]]
                    for f in one["figures"]
                ],
            )
            screen.line()

    document = {"kind": "brdf-fitter/models-check", "ok": ok, "models": models, "distributions": ndfs}
    return Outcome(document, show, DONE if ok else WORK_FAILED)


def _bound(figure: Mapping[str, Any]) -> str:
    for words, key in (("at most", "at_most"), ("at least", "at_least")):
        if figure.get(key) is not None:
            return f"{words} {number(figure[key], 3)}"
    return ""


def _show(screen: Screen, model: Mapping[str, Any]) -> None:
    screen.line(model["name"])
    screen.line(f"  {model['summary']}")
    screen.line(f"  {', '.join(_kind(model))}")
    for option, allowed in model["options"].items():
        screen.line(f"  {option}: {', '.join(allowed)} (default: {allowed[0]})")
    if model["max_lobes"] > 1:
        screen.line(f"  lobes: 1 to {model['max_lobes']}")
    screen.table(
        ("parameter", "unit", "default", "prior", "how many", "what it is"),
        [
            [
                p["name"], p["unit"], number(p["default"]), p["prior"],
                "one per channel" if p["per_channel"] else "one",
                p["description"] + (" (linear)" if p["linear"] else ""),
            ]
            for p in model["parameters"]
        ],
    )  # fmt: skip
    screen.line()


def _kind(model: Mapping[str, Any]) -> list[str]:
    """What kind of model it is, in words."""
    words = ["fitted by default" if model["fitted"] else "evaluated and sampled"]
    words.append("reciprocal" if model["reciprocal"] else "not reciprocal")
    words += ["transmits"] if model["transmits"] else []
    words += ["has an anisotropic form"] if model["anisotropic"] else []
    words += [f"built of other models (here {model['name']})"] if model["parts"] else []
    return words


VERB = Verb("list the reflectance models, their options and their parameters", configure, run)
