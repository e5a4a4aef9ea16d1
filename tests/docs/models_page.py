"""Makes docs/models.md: ``python -m tests.docs.models_page [--measure]``.

Names, options, parameters and descriptions come from the code, figures from docs/models.json, which --measure
writes anew (the self-test of ``brdf-fitter models --check`` over the models below, about five minutes).
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from fitter.models import check
from fitter.models.describe import default, describe, documentation
from fitter.spec import OPTIONS, ModelSpec

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE, FIGURES = DOCS / "models.md", DOCS / "models.json"

HEAD = """# Models

Made by `python -m tests.docs.models_page` from what the models say of themselves, and from the figures of
`brdf-fitter models --check` in [models.json](models.json).

- **Reciprocal**: f(wi, wo) = f(wo, wi).
- **Largest albedo**: the most light a model sends back (with what it transmits), over incidences down to a
  cosine of 0.01 and both ends of the range of its nonlinear parameters. One scale (kd, ks, rho, ...) is 1 and
  the others are 0, since scales add up. Up to 1 it conserves energy there. A model that integrates at every
  pair is estimated from draws.
- **ns**: one RGB pair in float64 and in float32, on the machine below.
- **bold** parameters enter linearly, one value per channel; a parameter in (brackets) is one per channel too.
"""


def specs() -> Iterator[ModelSpec]:
    """Every family in its default form, and in each of its variants."""
    for family in OPTIONS:
        yield default(family)
        for variant in OPTIONS[family].choices.get("variant", ())[1:]:
            yield ModelSpec(family=family, variant=variant)
        if family == "torrance_sparrow":
            yield ModelSpec.parse("torrance_sparrow:ggx:smith")


def measured_again(document: dict[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """The document with the self-test of these models only, each with the commit that it was measured at."""
    from tests.bench import machine

    wanted = {spec.name: spec for spec in specs()}
    if unknown := [name for name in names if name not in wanted]:
        raise SystemExit(f"not on the page: {', '.join(unknown)}; it has {', '.join(wanted)}")
    commit = machine.describe()["commit"]
    by_name = {model["name"]: model for model in document["models"]}
    by_name |= {name: {**check.check(wanted[name]), "commit": commit} for name in names}
    return {**document, "models": [by_name[name] for name in wanted if name in by_name]}


def measured() -> dict[str, Any]:
    """The self-test of every model on the page, and the machine."""
    from tests.bench import machine

    models = []
    for spec in specs():
        print(spec.name, file=sys.stderr)
        models.append(check.check(spec))
    return {**machine.describe(), "models": models, "distributions": check.check_distributions()}


def page(document: Mapping[str, Any]) -> str:
    """docs/models.md for a document of figures."""
    by_name = {model["name"]: model for model in document["models"]}
    if missing := [spec.name for spec in specs() if spec.name not in by_name]:
        raise SystemExit(f"no figures of {', '.join(missing)}: run with --measure {' '.join(missing)}")
    machine = document["machine"]
    lines = [
        HEAD,
        "| model | reciprocal | largest albedo | parameters | ns float64 | ns float32 |",
        "|---|---|---|---|---|---|",
        *(_row(spec, by_name[spec.name]) for spec in specs()),
        "",
        f"Measured on {machine['cpu']}, {machine['cores']} cores, {machine['system']}, commit "
        f"{str(document['commit'] or 'unknown')[:12]}.",
        "",
        *_distributions(document["distributions"]["figures"]),
    ]
    for family in OPTIONS:
        lines += ["", *_section(default(family))]
    return "\n".join(lines) + "\n"


def _row(spec: ModelSpec, figures: Mapping[str, Any]) -> str:
    found = {figure["name"]: figure for figure in figures["figures"]}
    model = describe(spec)
    costs = [f"{found[f'cost {dtype}']['value']:,.0f}" for dtype in ("float64", "float32")]
    cells = [f"`{spec.name}`", "yes" if model["reciprocal"] else "no", _energy(found["largest albedo"])]
    return "| " + " | ".join([*cells, _parameters(model["parameters"]), *costs]) + " |"


def _energy(figure: Mapping[str, Any]) -> str:
    """The largest albedo; where it is, if that is above 1."""
    value, where = figure["value"], figure["where"].replace("|", " ")
    if value < 1 + 1e-5:
        return f"{min(value, 1):.4g}"
    return f"{value:.4g} ({where})"


def _parameters(table: Sequence[Mapping[str, Any]]) -> str:
    shown = {(True, True): "**{}**", (False, True): "({})", (False, False): "{}"}
    return ", ".join(shown[p["linear"], p["per_channel"]].format(_name(p["name"])) for p in table)


def _name(name: str) -> str:
    return name.replace("_", "\\_")


def _distributions(figures: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield "Distributions of microfacets: how far the visible area of the facets is from the cosine, at worst,"
    yield "with each masking form (Smith's and V-grooves are exact, the others approximate Smith's):"
    yield ""
    yield "| distribution, masking | off by | at |"
    yield "|---|---|---|"
    for figure in figures:
        name, _, what = figure["name"].partition(": ")
        if what == "visible area":
            yield f"| {name.replace('_', ' ')} | {figure['value']:.1e} | {figure['where']} |"


def _section(spec: ModelSpec) -> Iterator[str]:
    """One family: its own words, then its options and parameters."""
    model = describe(spec)
    yield f"## {spec.family}"
    yield ""
    yield re.sub(r":\w+:`([^`]*)`", r"`\1`", documentation(spec))
    yield ""
    for option, allowed in model["options"].items():
        yield f"- {option}: {', '.join(f'`{value}`' for value in allowed)} (the first by default)"
    if model["anisotropic"]:
        yield "- has an anisotropic form"
    if model["max_lobes"] > 1:
        yield f"- 1 to {model['max_lobes']} lobes"
    if model["parts"]:
        yield f"- built of other models, as `{spec.name}`; their parameters begin with " + ", ".join(
            f"`{prefix}`" for prefix in model["parts"]
        )
    yield ""
    yield "| parameter | unit | default | range | what it is |"
    yield "|---|---|---|---|---|"
    for p in model["parameters"]:
        end = "up" if p["upper"] is None else f"to {p['upper']:.4g}"
        what = p["description"].replace("|", "\\|")
        yield f"| {_name(p['name'])} | {p['unit']} | {p['default']:.4g} | {p['lower']:.4g} {end} | {what} |"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.docs.models_page", description=__doc__)
    parser.add_argument(
        "--measure", nargs="*", metavar="NAME",
        help="measure the figures of these models anew, or of all: on a machine that does nothing else",
    )  # fmt: skip
    names = parser.parse_args().measure
    if names is not None:
        found = measured_again(json.loads(FIGURES.read_text()), names) if names else measured()
        FIGURES.write_text(json.dumps(found, indent=1) + "\n")
    PAGE.write_text(page(json.loads(FIGURES.read_text())))


if __name__ == "__main__":
    main()
