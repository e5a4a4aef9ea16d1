"""``brdf-fitter models``: the reflectance models, their options and their parameters."""

from __future__ import annotations

import argparse
from typing import Any

from fitter.cli.screen import Screen, number
from fitter.cli.verb import Outcome, Verb


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "model",
        nargs="*",
        metavar="MODEL",
        help="short names, as ward:bounded or lafortune:2 (default: all families)",
    )


def run(given: argparse.Namespace, screen: Screen) -> Outcome:
    from fitter.models import parameter_table
    from fitter.spec import FAMILIES, MAX_LOBES, OPTIONS, ModelSpec

    described: list[dict[str, Any]] = []
    for spec in (ModelSpec.parse(name) for name in given.model or FAMILIES):
        described.append(
            {
                "name": spec.name,
                "family": spec.family,
                "spec": spec.model_dump(mode="json"),
                "options": {name: list(allowed) for name, allowed in OPTIONS[spec.family].items()},
                "max_lobes": MAX_LOBES.get(spec.family, 1),
                "parameters": [parameter.to_dict() for parameter in parameter_table(spec)],
            }
        )

    def show(screen: Screen) -> None:
        for model in described:
            screen.line(model["name"])
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

    return Outcome({"kind": "brdf-fitter/models", "models": described}, show)


VERB = Verb("list the reflectance models, their options and their parameters", configure, run)
