"""Every model the suite runs over: a covering design made from the options the specification knows.

Not the full product: each family's default, each value of each option, each allowed pair of the options that
meet in one expression (PAIRS), and composites of each kind.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from functools import cache

from fitter import SpecError
from fitter.spec import OPTIONS, ModelSpec, model_spec

#: Options whose interplay has code of its own: each allowed pair of values occurs in some model.
PAIRS = (("ndf", "masking"), ("fresnel", "diffuse"), ("anisotropic", "ndf"))

#: Composites beyond a composite's options over Lambertian parts: deltas, transmission, anisotropic parts.
COMPOSITES = (
    "sum(ward:no_diffuse, lambert)",
    "sum(specular:schlick, lambert)",
    "sum(rough_dielectric, ward)",
    "sum(torrance_sparrow:ggx:smith:anisotropic:no_diffuse, phong:no_diffuse, oren_nayar)",
    "layered(ward:anisotropic)",
    "rough_facets(oren_nayar:fujii)",
)


def _all(family: str) -> Iterator[ModelSpec]:
    """Every allowed specification of a family, options nearest to the defaults first."""
    options = OPTIONS[family]
    axes = dict(options.choices)
    axes["diffuse"] = options.diffuse or (None,)
    axes["anisotropic"] = (False, True) if options.anisotropic else (False,)
    axes["lobes"] = tuple(range(1, options.max_lobes + 1))
    count = len(options.parts) if options.fewest is None else options.fewest
    parts = tuple(ModelSpec(family="lambert") for _ in range(count))
    combinations = itertools.product(*(range(len(values)) for values in axes.values()))
    for chosen in sorted(combinations, key=lambda c: sum(k > 0 for k in c)):
        fields = {name: values[k] for (name, values), k in zip(axes.items(), chosen, strict=True)}
        try:
            yield model_spec({"family": family, "components": parts, **fields})
        except SpecError:
            continue  # options that exclude each other


def _covers(spec: ModelSpec, meeting: bool) -> set[tuple[tuple[str, object], ...]]:
    """The values, and if ``meeting`` the pairs of values, of options that a specification exercises."""
    options = OPTIONS[spec.family]
    names = [*options.choices, "anisotropic", "lobes", *(["diffuse"] if options.diffuse else [])]
    single = {((name, getattr(spec, name)),) for name in names}
    pairs = [(a, b) for a, b in PAIRS if a in names and b in names] if meeting else []
    if "coupled" not in options.diffuse:
        # An additive term meets nothing, and is Lambert's own model by itself.
        pairs = [pair for pair in pairs if "diffuse" not in pair]
        single = single if meeting else {one for one in single if one[0][0] != "diffuse"}
    return single | {((a, getattr(spec, a)), (b, getattr(spec, b))) for a, b in pairs}


def _greedy(every: Iterable[ModelSpec], meeting: bool) -> tuple[str, ...]:
    """Few of these models that exercise all that they do together, the first one among them."""
    found = [(spec, _covers(spec, meeting)) for spec in every]
    chosen, covered = [found[0][0]], set(found[0][1])
    # The first of those that add most, so that ties go to the nearest to the default.
    while (best := max(found, key=lambda one: len(one[1] - covered)))[1] - covered:
        chosen.append(best[0])
        covered |= best[1]
    return tuple(spec.name for spec in chosen)


@cache
def covering(family: str) -> tuple[str, ...]:
    """Few models of a family that exercise all there is to cover, its default first."""
    return _greedy(_all(family), meeting=True)


MODELS = tuple(
    dict.fromkeys([*(name for family in OPTIONS for name in covering(family)), *COMPOSITES])
)  # fmt: skip

#: Those of them that still show each value of each option but additive diffuse terms, and the sums: what the
#: suite draws from and differentiates, which takes longest to compile. The long study (tests/evidence) takes
#: them all.
FEWER = tuple(
    dict.fromkeys(
        [
            *(
                name
                for family in OPTIONS
                for name in _greedy([ModelSpec.parse(one) for one in covering(family)], meeting=False)
            ),
            *(name for name in COMPOSITES if name.startswith("sum")),
        ]
    )
)


def _drawing(name: str) -> tuple[object, ...]:
    """What tells the draws of two models apart. Distributions of normals are Torrance-Sparrow's: other
    families draw theirs by the same code."""
    spec = ModelSpec.parse(name)
    normals = spec.ndf if spec.family == "torrance_sparrow" else None
    return spec.family, spec.anisotropic, normals, spec.components


#: Those of them that are drawn from.
DRAWN = tuple({_drawing(name): name for name in reversed(FEWER)}.values())[::-1]
