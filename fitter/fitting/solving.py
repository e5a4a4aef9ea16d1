"""solve: one group of channels, from the samples to the estimates and their uncertainties."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitter.errors import FitError
from fitter.fitting import exchange, metrics, nlopt_solver, reduction, search, separable
from fitter.fitting.blocks import BLOCK, Block, Blocks, count, padded
from fitter.fitting.chunks import CHUNK
from fitter.fitting.clock import Clock
from fitter.fitting.covariance import curvature, natural
from fitter.fitting.effort import searched
from fitter.fitting.layout import Layout
from fitter.fitting.least_squares import countable
from fitter.fitting.order import in_order, order_axes
from fitter.fitting.polish import Polished, polish
from fitter.fitting.samples import IntArray, Usable
from fitter.fitting.search_error import search_error
from fitter.fitting.selection_error import selection_error
from fitter.fitting.sums import Errors, errors, scores
from fitter.fitting.writeup import Group
from fitter.spec import FitSpec, Metric

FloatArray = NDArray[np.float64]
#: Basins of the subset that are polished there, and within what share of the best one's objective they
#: go on to the full table: a subset can't tell near-equals apart.
BASINS, NEAR = 6, 1.1
#: Samples that stand between the subset and a table of ``FEW`` times as many.
MIDDLE, FEW = 32_768, 4


def solve(
    places: Layout, request: FitSpec, data: Usable, group: Sequence[int],
    draw: Callable[[int], tuple[IntArray, FloatArray]], clock: Clock,
) -> Group:  # fmt: skip
    """The optimum for the channels ``group`` (positions among the selected).

    draw : makes a subset of that size, the same for all groups.

    Raises FitError where the objective is not finite.
    """
    metric, floor = data.metric, data.floor[list(group)]
    subset = searched(places, request, len(data), len(group))
    small = data.fits_in(subset)
    complete = request.polish == "full" or small
    part = reduced = None if small or not complete else reduction.reduce(places, data, group)
    # Drawing a subset of a large table takes longer than searching its pseudo-samples.
    none = (data.index[:0], np.ones(0))
    index, scale = draw(subset) if reduced is None else none
    if part is None:
        part = data.part(group, index, padded(len(index)), scale)
    y, weight = tangent(metric, part, floor)
    clock.lap("reduce")
    finder = search.search if request.solver == "optimistix" else nlopt_solver.search
    seen = slice(padded(part.count))
    basins, evidence = finder(
        places, part.pair[:, seen], y[seen], weight[seen], request.starts, request.seed
    )
    clock.lap("search")

    # The subset's own objective ranks the basins: for log and cbrt the search saw only its tangent.
    whole = part.y.shape[1] % CHUNK == 0
    blocks: Sequence[Block] = [part if whole else data.part(group, index, BLOCK, scale)]
    ends = [
        polish(places, metric, floor, np.concatenate([b.u, b.inner.reshape(-1)]), blocks, 20)
        for b in basins[:BASINS]
    ]
    ends = _distinct(ends, count(blocks))
    best = ends[0]
    # On a table of few blocks all of them go on: that costs nothing.
    limit = math.inf if len(data) <= BLOCK else NEAR * _objective(best)
    near = [in_order(places, end.p) for end in ends if _objective(end) <= limit]
    evidence["exchange_gain"] = None
    if exchange.wanted(places, request, len(data), len(group)):
        p, evidence["exchange_gain"] = _exchanged(places, data, group, part if small else None, ends)
        near.append(in_order(places, p))
    clock.lap("subset polish")
    full: Blocks = data.blocks(group) if complete and not small else blocks
    own = request.solver == "optimistix"
    finish = polish if own else nlopt_solver.polish
    if reduced is not None:
        # The pseudo-samples are the table: one pass made them, and their optimum is its optimum.
        end, passes = finish(places, metric, floor, in_order(places, best.p), blocks), 1
    else:
        passes, rest = 0, None
        if own and complete and len(data) > FEW * MIDDLE:
            near, rest = _halfway(places, data, group, near, draw(MIDDLE))
        if len(near) > 1:
            rivals = [polish(places, metric, floor, p, full, 10) for p in near]
            near = [min(rivals, key=_objective).p]
            passes = sum(end.passes for end in rivals)
        if rest is None:
            end = finish(places, metric, floor, near[0], full)
        else:
            end = polish(places, metric, floor, near[0], full, rest=rest)
        passes = passes + end.passes if complete else 0
    p, normal = order_axes(places, end.p, end.normal)
    end = replace(end, p=p, normal=normal)
    clock.lap("polish")
    if not np.isfinite(end.normal.objective):
        raise FitError(
            f"the objective of {request.model.name} is not finite", code="not-finite",
            cause="values near the limits of floating point", remedy="rescale the table's values",
        )  # fmt: skip

    positions = [data.channels[c] for c in group]
    if complete:
        # Pseudo-samples know the objective alone.
        found = (
            Errors(normal.objective, normal.squared, normal.relative)
            if reduced is None
            else errors(places, metric, floor, end.p, full)
        )
        some, step = data.blocks_of_some(group)
    else:
        found = _stand_in(places, end, part, scale, len(index), floor)
        some, step = blocks, 1
    curve = curvature(places, end.p, end.normal, len(group))
    told = scores(places, metric, floor, end.p, some, curve.inverse, curve.jacobian, step)
    # Of a subset's optimum the curvature knows the measurements' noise, the sandwich the choice of samples
    # too.
    estimates = natural(places, curve, told, positions, data.likelihood and complete)
    error = search_error(places, end, told.outer, None if complete else 1.0 - count(full) / len(data))
    chosen = None
    if not complete:
        root = data.part(group, index, blocks[0].y.shape[1], np.sqrt(scale))
        # What choosing them does knows no leverage: the samples left out have residuals as large as theirs.
        plain = np.zeros_like(curve.inverse)
        weighted, alone = (
            scores(places, metric, floor, end.p, of, plain, curve.jacobian) for of in (blocks, [root])
        )
        chosen = selection_error(places, curve, weighted, alone, positions, data.likelihood)
    clock.lap("check")
    evidence["reduced"] = reduced is not None
    examined = len(index) if reduced is None else len(data)
    return Group(end, found, estimates, evidence, examined, passes, error, chosen)


def _halfway(
    places: Layout, data: Usable, group: Sequence[int], near: Sequence[FloatArray],
    drawn: tuple[IntArray, FloatArray],
) -> tuple[list[FloatArray], FloatArray | None]:  # fmt: skip
    """The vectors p that are still near-equals on the ``MIDDLE`` samples ``drawn``, and the second-order
    part of the objective there where one is left.

    A model that fits badly takes dozens of passes. From there, with what those have learned of the curvature,
    the full table needs a few.
    """
    index, scale = drawn
    part = data.part(group, index, BLOCK, scale)  # of the length that all blocks have: one program
    ends = [polish(places, data.metric, data.floor[list(group)], p, [part]) for p in near]
    least = min(map(_objective, ends))
    # Objectives of as many samples differ by chance, but those of the same samples by much less.
    limit = (1.0 + 3.0 / np.sqrt(MIDDLE)) * least
    rivals = [end for end in _distinct(ends, len(index)) if _objective(end) <= limit]
    return [end.p for end in rivals], rivals[0].rest if len(rivals) == 1 else None


def _objective(end: Polished) -> float:
    """Infinite where it is no number."""
    return end.normal.objective if np.isfinite(end.normal.objective) else math.inf


def _distinct(ends: Sequence[Polished], samples: int) -> list[Polished]:
    """One end of each optimum, the best first; of those whose sums are no numbers one where there is no
    other."""
    found: list[Polished] = []
    for end in sorted(ends, key=_objective):
        if found and not countable(end.normal):
            continue
        if not any(_same(end, other, samples) for other in found):
            found.append(end)
    return found


def _same(a: Polished, b: Polished, samples: int) -> bool:
    """Whether two ends are one optimum: every parameter within a tenth of a standard uncertainty, all others
    held; what the objective does not change with is of no weight."""
    away = np.sqrt(np.maximum(np.diagonal(b.normal.matrix), 0.0)) * np.abs(a.p - b.p)
    return bool(away.max() <= 0.1 * np.sqrt(b.normal.objective / samples))


def _exchanged(
    places: Layout, data: Usable, group: Sequence[int], part: Block | None, ends: Sequence[Polished]
) -> tuple[FloatArray, float]:
    """The vector p that exchanges of lobes lead to on all samples (``part`` where that has them), and by what
    share of itself the objective of the tangent problem fell by them."""
    if part is None:
        part = data.part(group, np.arange(len(data)), len(data))
    y, weight = tangent(data.metric, part, data.floor[list(group)])
    t = len(places.entries)
    return exchange.improved(places, part.pair, y, weight, [end.p[:t] for end in ends])


def tangent(metric: Metric, part: Block, floor: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, C) the values of a block and the weights of the quadratic objective at them."""
    y = np.ascontiguousarray(part.y.T)
    weight = np.asarray(metrics.linearised_weight(metric, y, part.weight.T, floor))
    return y, np.broadcast_to(weight, y.shape)


def _stand_in(
    places: Layout, end: Polished, part: Block, scale: FloatArray, samples: int, floor: FloatArray
) -> Errors:
    """The errors of a weighted subset, its plain ones weighted, too: they stand for the table's."""
    t = len(places.entries)
    inner = end.p[t:].reshape(-1, len(part.y))
    f = np.asarray(separable.values(places, jnp.asarray(end.p[:t]), jnp.asarray(inner), part.pair))[:samples]
    y = part.y[:, :samples].T
    plain = f - y
    relative = plain / (np.abs(y) + 10.0 * floor)
    squared, relative_squared = (float(scale @ np.square(error).sum(axis=1)) for error in (plain, relative))
    return Errors(end.normal.objective, squared, relative_squared)
