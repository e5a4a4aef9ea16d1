"""Branch and bound over cells of surfaces: are errors below a tolerance everywhere?

Points come first: on a grid, then zoomed into where each error is largest. One above the tolerance decides,
and the largest met says when a bound is tight. Then cells are halved, those with the largest bounds first,
for all errors that are not decided at once: directions and values are common to them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fitter.scene import cells as cells_of
from fitter.scene.boxes import Angles, Boxes
from fitter.scene.cells import Cells
from fitter.scene.surfaces import Surfaces

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
#: Upper bounds (N, B) over cells of some of the errors, and of how many boxes.
Bounds = Callable[[Cells, Sequence[int]], tuple[FloatArray, int]]
#: All errors (N, P) at points (P, 2) of primitives (P,), 0 where the picture does not show them.
Errors = Callable[[IntArray, FloatArray], FloatArray]

#: Boxes that a decision may take, and that bounds may be tightened by once they are below the tolerance.
BUDGET, POLISH = 20_000, 6_000
_AT_ONCE = 256
#: Cells whose middles are tried, every so many rounds.
_MIDDLES, _EVERY = 16, 4
#: A bound this much above an error that was found is tight enough, and one that is below this much.
TIGHT, LEAST = 1.4, 1e-5
#: Rounds of zooming, and points that each has around the largest of each error.
_ROUNDS, _NEAR = 6, 10


@dataclass(frozen=True)
class Decision:
    """``bounded``: at most ``bound`` everywhere. ``needed``: ``found`` at a point, above the tolerance.
    ``open``: the boxes ran out. ``found`` is the largest error met at a point."""

    state: Literal["bounded", "needed", "open"]
    bound: float
    found: float
    boxes: int


def decide(
    surfaces: Surfaces, start: Cells, bounds: Bounds, errors: Errors, tolerance: float, found: FloatArray,
    budget: int = BUDGET,
) -> list[Decision]:  # fmt: skip
    """Whether each error stays below ``tolerance``; ``found`` (N,) are the largest that points gave."""
    found = found.copy()
    decisions: dict[int, Decision] = {}
    active = [i for i, error in enumerate(found) if error <= tolerance]
    upper, used = bounds(start, active) if active else (np.zeros((0, len(start))), 0)
    cells, closed, rounds = start, np.zeros(len(found)), 0
    polish = min(POLISH, budget // 3)
    while active:
        goal = np.full(len(active), tolerance)
        if used < polish:
            goal = np.clip(TIGHT * found[active], min(LEAST, tolerance), tolerance)
        worst = np.maximum(closed[active], upper.max(axis=1, initial=0.0))
        for i, bound, enough in zip(active, worst.tolist(), goal.tolist(), strict=True):
            if found[i] > tolerance:
                decisions[i] = Decision("needed", max(bound, float(found[i])), float(found[i]), used)
            elif bound <= enough or (used >= budget and bound <= tolerance):
                decisions[i] = Decision("bounded", bound, float(found[i]), used)
            elif used >= budget:
                decisions[i] = Decision("open", bound, float(found[i]), used)
        rows = [j for j, i in enumerate(active) if i not in decisions]
        active, upper, goal = [active[j] for j in rows], upper[rows], goal[rows]
        if not active:
            break
        keep = np.asarray((upper > goal[:, None]).any(axis=0))
        closed[active] = np.maximum(closed[active], upper[:, ~keep].max(axis=1, initial=0.0))
        cells, upper = cells.take(keep), upper[:, keep]
        order = np.argsort(-(upper / goal[:, None]).max(axis=0), kind="stable")
        chosen, rest = order[:_AT_ONCE], order[_AT_ONCE:]
        if rounds % _EVERY == 0:
            middle = cells.take(order[:_MIDDLES])
            found = np.maximum(found, errors(middle.primitive, middle.middle()).max(axis=1, initial=0.0))
        halved = cells_of.halves(surfaces, cells.take(chosen))
        fresh, boxes = bounds(halved, active)
        cells, upper = cells.take(rest).join(halved), np.concatenate([upper[:, rest], fresh], axis=1)
        used, rounds = used + boxes, rounds + 1
    return [
        decisions.get(i, Decision("needed", np.inf, float(error), 0)) for i, error in enumerate(found)
    ]


def probe(
    surfaces: Surfaces, start: Cells, errors: Errors, enough: float, most: int
) -> FloatArray:
    """The largest errors (N,) met at points."""
    shapes = np.unique(start.primitive)
    shapes = shapes[:: -(-len(shapes) // most)]
    each = max(1, int(np.sqrt(most / len(shapes))))
    ends = np.linspace(0.0, 1.0, each) if each > 1 else np.array([1 / 3])
    grid = np.stack(np.meshgrid(ends, ends, indexing="ij"), axis=-1).reshape(-1, 2)
    primitive, at = np.repeat(shapes, len(grid)), np.tile(grid, (len(shapes), 1))
    met = errors(primitive, _coordinates(surfaces, primitive, at))
    rng = np.random.default_rng(0)
    for k in range(_ROUNDS):
        best = met.argmax(axis=1)
        best = np.unique(best[met.max(axis=1) <= enough])
        if not len(best):
            break
        around = np.repeat(at[best], _NEAR, axis=0)
        around = np.clip(around + (rng.random(around.shape) * 2 - 1) * (0.6 / each) * 0.4**k, 0.0, 1.0)
        where = np.repeat(primitive[best], _NEAR)
        met = np.concatenate([met, errors(where, _coordinates(surfaces, where, around))], axis=1)
        primitive, at = np.concatenate([primitive, where]), np.concatenate([at, around])
    return met.max(axis=1)


def _coordinates(surfaces: Surfaces, primitive: IntArray, u: FloatArray) -> FloatArray:
    """Points of the unit square as coordinates of primitives, dense at the rims of spheres."""
    u = u.copy()
    u[:, 0] = np.where(primitive < surfaces.spheres, u[:, 0] ** 3, u[:, 0])
    low, high = surfaces.low[primitive], surfaces.high[primitive]
    return low + u * (high - low)


def hull(
    surfaces: Surfaces, start: Boxes, of: Callable[[Angles], Sequence[FloatArray]], rounds: int = 5
) -> tuple[float, float]:
    """The range of a quantity over what is seen, after a few halvings. (inf, -inf) where nothing is."""
    boxes = start
    for _ in range(rounds):
        boxes = boxes.take(surfaces.angles(boxes).seen)
        if not len(boxes) or len(boxes) > 4_000:
            break
        boxes = surfaces.halves(boxes)
    if not len(boxes):
        return np.inf, -np.inf
    angles = surfaces.angles(boxes)
    angles = angles.take(angles.seen)
    low, high = of(angles)
    return float(low.min(initial=np.inf)), float(high.max(initial=-np.inf))
