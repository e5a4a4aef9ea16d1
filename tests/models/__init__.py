"""Every model the suite runs over, from the options the specification knows."""

from __future__ import annotations

import itertools

from fitter.spec import FAMILIES, MAX_LOBES, OPTIONS, ModelSpec


def _every() -> tuple[str, ...]:
    names: list[str] = []
    for family in FAMILIES:
        options = OPTIONS[family]
        for chosen in itertools.product(*options.values()):
            names += [
                ModelSpec(family=family, lobes=lobes, **dict(zip(options, chosen, strict=True))).name
                for lobes in range(1, MAX_LOBES.get(family, 1) + 1)
            ]
        if family != "oren_nayar":
            names.append(f"{family}:no_diffuse")
    return tuple(names)


MODELS = _every()
