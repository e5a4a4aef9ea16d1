"""The effects of one material that are left out: the cheapest set whose joint bound is small enough."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.scene import effects, operations, wording
from fitter.scene.boxes import Angles
from fitter.scene.constants import constants_of
from fitter.scene.criteria import Criteria
from fitter.scene.effects import Off
from fitter.scene.materials import Material, ModelMaterial
from fitter.scene.search import hull

FloatArray = NDArray[np.float64]
#: Effects of a material that all sets are tried of.
_MOST = 12


def select(
    criteria: Criteria, m: int, one: Material, left: float
) -> tuple[Material, float, list[dict[str, Any]]]:  # fmt: skip
    """``one``, in place of material m, without what the tolerance ``left`` allows, the bound, decisions."""
    name = criteria.scene.names[m]
    if not isinstance(one, ModelMaterial):
        return one, 0.0, [wording.kept(name, "all", f"{name}: a raw table has no effects to leave out")]
    why = effects.unbounded(one.model)
    if why is not None:
        return one, 0.0, [wording.kept(name, "all", f"{name}: {why}")]
    constants = constants_of(criteria.scene, m, one, criteria.surfaces)
    full = operations.of_material(one)
    names = effects.effects(one.model)[:_MOST]
    alone = [frozenset({effect}) for effect in names]
    saved = {
        effect: full - operations.of_material(replace(one, off=off, constants=constants))
        for effect, off in zip(names, alone, strict=True)
    }
    single = dict(zip(names, criteria.decide(m, one, alone, constants, left), strict=True))
    free = [effect for effect, found in single.items() if found.state == "bounded" and saved[effect] > 0]
    chosen, bound = frozenset[str](), 0.0
    sets = _sets(free, one, constants)
    known = dict(zip(alone, single.values(), strict=True))
    for off, found in zip(sets, criteria.first(m, one, sets, constants, left, known), strict=False):
        if found.state == "bounded":
            chosen, bound = off, found.bound
    degrees = _lengths(criteria, m)
    decisions = [
        wording.judged(name, effect, found, effect in chosen, saved[effect], full, degrees, free)
        for effect, found in single.items()
    ]
    return (replace(one, off=chosen, constants=constants) if chosen else one), bound, decisions


def _sets(free: Sequence[str], one: ModelMaterial, constants: Mapping[str, Any]) -> list[Off]:
    """All compatible sets of effects, the cheapest program first."""
    every = [frozenset(some) for n in range(1, len(free) + 1) for some in itertools.combinations(free, n)]
    cost = {
        off: operations.of_material(replace(one, off=off, constants=constants))
        for off in every if effects.compatible(off)
    }  # fmt: skip
    return sorted(cost, key=lambda off: (cost[off], sorted(off)))


def _lengths(criteria: Criteria, m: int) -> float:
    """The largest angle from the normal, degrees, that light or viewer make where something is seen."""

    def cosines(angles: Angles) -> tuple[FloatArray, FloatArray]:
        return np.minimum(angles.lz.lo, angles.vz.lo), np.maximum(angles.lz.hi, angles.vz.hi)

    low, _ = hull(criteria.surfaces, criteria.surfaces.start(m, criteria.lamps), cosines)
    return float(np.rad2deg(np.arccos(min(max(low, 0.0), 1.0))))
