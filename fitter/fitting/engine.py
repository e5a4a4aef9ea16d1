"""fit: global search on a subset, polish on the full table, uncertainties, and a frank account of it all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitter import progress, spec
from fitter.compression import CompressedTable
from fitter.errors import FitError
from fitter.fitting import budget, clock, nlopt_solver, search, separable
from fitter.fitting.covariance import natural
from fitter.fitting.layout import Layout, channel_groups, layout
from fitter.fitting.metrics import linearised_weight
from fitter.fitting.order import in_order, order_axes
from fitter.fitting.polish import Normal, Polished, polish, support
from fitter.fitting.result import FitResult
from fitter.fitting.samples import BLOCK, Block, Usable, padded, usable
from fitter.fitting.search_error import search_error
from fitter.fitting.writeup import Group, write_up
from fitter.spec import FitSpec, Metric, ModelSpec, Select
from fitter.table import Table

FloatArray = NDArray[np.float64]
#: Basins of the subset that are polished there, and within what share of the best one's objective they
#: go on to the full table: a subset can't tell near-equals apart.
BASINS, NEAR = 5, 1.1


def check(request: FitSpec) -> None:
    """Raise the SpecError that :func:`fit` would raise whatever the table: before a job is queued."""
    layout(request)


def fit(
    table: Table | CompressedTable,
    model: FitSpec | ModelSpec | str,
    *,
    metric: Metric | None = None,
    solver: spec.Solver = "optimistix",
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    select: Select | None = None,
    starts: int | None = None,
    subset: int = 4096,
    polish: spec.Polish = "full",
    budget_seconds: float | None = None,
    target_error: float | None = None,
    seed: int = 0,
    progress: progress.Progress = progress.ignore,
) -> FitResult:
    """Fit one model to a table by separable least squares.

    Parameters
    ----------
    table : a Table, or a CompressedTable (then the result says with what tolerance).
    model : a short name ("ward", "lafortune:2"), a ModelSpec, or a whole FitSpec, which then rules alone.
    metric : see :mod:`fitter.fitting.metrics`; None takes "measurement" where sigma is stated, else "cbrt".
    budget_seconds, target_error : choose the effort instead, see :mod:`fitter.fitting.budget`.
    progress : called with (share, text); may raise to stop the fit.

    Raises
    ------
    SpecError : the request makes no sense for this model or table.
    FitError : nothing usable to fit, fewer values than parameters, the solver failed, or "unattainable": no
        effort keeps the budget or reaches the target.
    """
    if isinstance(model, FitSpec):
        request = model
    else:
        request = spec.fit_spec(
            {
                "model": spec.model_spec(model), "metric": metric, "solver": solver,
                "fixed": dict(fixed or {}), "bounds": dict(bounds or {}), "select": select or Select(),
                "starts": starts, "subset": subset, "polish": polish,
                "budget_seconds": budget_seconds, "target_error": target_error, "seed": seed,
            }
        )  # fmt: skip
    if request.budget_seconds is not None or request.target_error is not None:
        return budget.fit_within(table, request, _fit, progress)
    return _fit(table, request, progress)


def _fit(table: Table | CompressedTable, request: FitSpec, progress: progress.Progress) -> FitResult:
    """The fit itself, with the effort that the request states."""
    with clock.running() as running:
        return _timed(table, request, progress, running)


def _timed(
    table: Table | CompressedTable, request: FitSpec, progress: progress.Progress, clock: clock.Clock
) -> FitResult:
    reduction: dict[str, Any] = {"compressed": None}
    if isinstance(table, CompressedTable):
        reduction["compressed"] = {"tolerance": table.tolerance, "bytes": table.nbytes}
        table = table.decompress()
    chosen: Metric = request.metric or ("measurement" if table.sigma is not None else "cbrt")
    places = layout(request)
    progress(0.0, "preparing samples")
    data = usable(table, chosen, request.select, anisotropic=not places.family.isotropic(request.model))
    groups = channel_groups(request, len(data.channels))
    places = layout(request, len(data.channels))
    _enough(data, places, len(groups[0]))
    clock.lap("prepare")

    solved: list[Group] = []
    for k, group in enumerate(groups):
        progress((k + 0.1) / (len(groups) + 1), f"searching {request.model.name}")
        solved.append(_solve(places, chosen, request, data, group, clock))
    progress(0.95, "writing up")
    result = write_up(table, request, chosen, data, groups, solved, reduction, clock)
    budget.remember_compiled(request, places, chosen, len(data), len(groups[0]))
    progress(1.0, "done")
    return result


def _solve(
    places: Layout, metric: Metric, request: FitSpec, data: Usable, group: Sequence[int], clock: clock.Clock
) -> Group:
    floor = data.floor[list(group)]
    index, scale = data.subset(request.subset, request.seed)
    size = padded(len(index))
    part = data.part(group, index, size, scale)
    weight = np.asarray(linearised_weight(metric, part.y, part.weight, floor))
    finder = search.search if request.solver == "optimistix" else nlopt_solver.search
    basins, evidence = finder(places, part.pair, part.y, weight, request.starts, request.seed)
    clock.lap("search")

    # The subset's own objective ranks the basins: for log and cbrt the search saw only its tangent.
    blocks = [data.part(group, index, max(BLOCK, size), scale)]
    ends = [
        polish(places, metric, floor, np.concatenate([b.u, b.inner.reshape(-1)]), blocks, 20)
        for b in basins[:BASINS]
    ]
    best = min(end.normal.objective for end in ends)
    near = [in_order(places, end.p) for end in ends if end.normal.objective <= NEAR * best]
    clock.lap("subset polish")
    complete = request.polish == "full" or len(index) == len(data)
    full = data.blocks(group) if complete and len(index) < len(data) else blocks
    passes = 0
    if len(near) > 1:
        rivals = [polish(places, metric, floor, p, full, 10) for p in near]
        near = [min(rivals, key=lambda end: end.normal.objective).p]
        passes = sum(end.passes for end in rivals)
    finish = polish if request.solver == "optimistix" else nlopt_solver.polish
    end = finish(places, metric, floor, near[0], full)
    p, normal = order_axes(places, end.p, end.normal)
    end = replace(end, p=p, normal=normal)
    clock.lap("polish")
    if not np.isfinite(end.normal.objective):
        raise FitError(
            f"the objective of {request.model.name} is not finite", code="not-finite",
            cause="values near the limits of floating point", remedy="rescale the table's values",
        )  # fmt: skip
    positions = [data.channels[c] for c in group]
    lives_on = support(places, metric, floor, end.p, full)
    # Of a subset's optimum the curvature knows the measurements' noise, the sandwich the choice of samples
    # too.
    likelihood = metric == "measurement" and complete
    used = sum(block.count for block in full)
    estimates = natural(places, end.p, end.normal, lives_on, positions, used, likelihood)
    if not complete:
        end = replace(end, normal=_stand_in(places, end, part, scale, len(index), floor))
    error = search_error(places, end, None if complete else 1.0 - used / len(data))
    clock.lap("check")
    return Group(end, estimates, evidence, len(index), passes + end.passes if complete else 0, error)


def _stand_in(
    places: Layout, end: Polished, part: Block, scale: FloatArray, count: int, floor: FloatArray
) -> Normal:
    """The sums of a weighted subset, its plain errors weighted, too: they stand for the table's."""
    t = len(places.entries)
    inner = end.p[t:].reshape(-1, part.y.shape[1])
    f = np.asarray(separable.values(places, jnp.asarray(end.p[:t]), jnp.asarray(inner), part.pair))[:count]
    plain = f - part.y[:count]
    relative = plain / (np.abs(part.y[:count]) + 10.0 * floor)
    squared, relative_squared = (float(scale @ np.square(error).sum(axis=1)) for error in (plain, relative))
    return end.normal._replace(squared_error=squared, relative_error=relative_squared)


def _enough(data: Usable, places: Layout, per_group: int) -> None:
    parameters = len(places.entries) + len(places.linear) * per_group
    values = len(data) * per_group
    if values < parameters:
        raise FitError(
            f"{values} usable values can't determine the {parameters} parameters of {places.spec.name}",
            code="too-few-samples", cause="a very small table, or most of its samples are masked",
            remedy="measure more geometries, fix parameters, or fit a simpler model",
        )  # fmt: skip
