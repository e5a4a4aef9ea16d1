"""Branch and bound over boxes of surface and lamp points: is an error below a tolerance everywhere?

The error of a set of effects at a point is bounded by min(e, w g): e relative to the light that one point of
one lamp sends back (lamps, and shadows that hide them, cancel: a quotient of sums lies between the quotients
of its parts), g relative to 0.01 F. With one lamp without extent w = 1. Where light adds up from several
points, parts that are small beside the light and parts that are small beside the floor add, too: u = sup
min(e, w g) then bounds the error by u (1 + n/w), n the number of lamps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fitter.scene.surfaces import Angles, Boxes, Surfaces

FloatArray = NDArray[np.float64]
#: Upper bounds (B,) of the error over boxes.
Criterion = Callable[[Boxes, Angles], FloatArray]
#: The error (P,) at centres of boxes, NaN where the picture does not show them.
Sampler = Callable[[Boxes], FloatArray]

#: Boxes that a decision may take, and that a bound may be tightened by once it is made.
BUDGET, POLISH = 20_000, 4_096
_AT_ONCE = 256
_SAMPLES = 16
#: Points are tried where the bound at them is at least this share of the tolerance.
SHARE = 0.1
#: A bound this much above an error that was found is tight enough.
TIGHT = 1.5


@dataclass(frozen=True)
class Decision:
    """``bounded``: at most ``bound`` everywhere. ``needed``: ``found`` at a point, above the tolerance.
    ``open``: the boxes ran out, or the bound itself is above the tolerance at a point where no such error was
    met.
    ``found`` is the largest error met at a point."""

    state: Literal["bounded", "needed", "open"]
    bound: float
    found: float
    boxes: int


def decide(
    surfaces: Surfaces, start: Boxes, criterion: Criterion, sampler: Sampler, tolerance: float,
    *, tighten: bool = False, budget: int = BUDGET,
) -> Decision:  # fmt: skip
    """Whether the error stays below ``tolerance``; with ``tighten`` its bound as near as POLISH boxes bring
    it."""
    boxes, upper = _evaluated(surfaces, start, criterion)
    used, found, reached, closed = len(start), 0.0, 0.0, 0.0
    while True:
        bound = max(closed, float(upper.max(initial=0.0)))
        if len(boxes):
            middle = boxes.take(np.argsort(upper)[::-1][:_SAMPLES]).middle()
            _, least = _evaluated(surfaces, middle, criterion)
            reached = max(reached, float(least.max(initial=0.0)))
            if reached > SHARE * tolerance or (tighten and bound <= tolerance):
                found = max(found, float(sampler(middle).max(initial=0.0)))
        if found > tolerance:
            return Decision("needed", max(bound, found), found, used)
        if bound <= tolerance and (not tighten or bound <= TIGHT * reached or bound < 1e-9 or used >= POLISH):
            return Decision("bounded", bound, found, used)
        if reached > tolerance or used >= budget:
            return Decision("open", bound, found, used)
        goal = min(TIGHT * reached, tolerance) if tighten else tolerance
        keep = upper > goal
        closed = max(closed, float(upper[~keep].max(initial=0.0)))
        boxes, upper = boxes.take(keep), upper[keep]
        order = np.argsort(upper)[::-1]
        chosen, rest = order[:_AT_ONCE], order[_AT_ONCE:]
        halves, fresh = _evaluated(surfaces, surfaces.halves(boxes.take(chosen)), criterion)
        used += 2 * len(chosen)
        # A half can't exceed its whole.
        boxes, upper = boxes.take(rest).join(halves), np.concatenate([upper[rest], fresh])


def _evaluated(surfaces: Surfaces, boxes: Boxes, criterion: Criterion) -> tuple[Boxes, FloatArray]:
    """The boxes that may be seen, and their bounds."""
    if not len(boxes):
        return boxes, np.zeros(0)
    angles = surfaces.angles(boxes)
    boxes, angles = boxes.take(angles.seen), angles.take(angles.seen)
    found = criterion(boxes, angles) if len(boxes) else np.zeros(0)
    assert not np.isnan(found).any()
    return boxes, found


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
