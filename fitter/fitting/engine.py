"""fit: global search on a subset, polish on the full table, uncertainties, and a frank account of it all."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import progress, spec
from fitter.compression import CompressedTable
from fitter.errors import FitError, SpecError
from fitter.fitting import metrics, nlopt_solver, reduction, search
from fitter.fitting.covariance import natural
from fitter.fitting.layout import Layout, channel_groups, layout
from fitter.fitting.order import in_order, order_axes
from fitter.fitting.polish import CHUNK, errors, polish, scores
from fitter.fitting.result import FitResult
from fitter.fitting.samples import BLOCK, Block, Blocks, Usable, usable
from fitter.fitting.streamed import from_file
from fitter.fitting.writeup import Clock, Group, write_up
from fitter.large import LargeTable
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
    table: Table | CompressedTable | LargeTable,
    model: FitSpec | ModelSpec | str,
    *,
    metric: Metric | None = None,
    weighting: spec.Weighting | None = None,
    solver: spec.Solver = "optimistix",
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    select: Select | None = None,
    starts: int | None = None,
    subset: int = 4096,
    seed: int = 0,
    progress: progress.Progress = progress.ignore,
) -> FitResult:
    """Fit one model to a table by separable least squares, or ``"auto"``: the one that the table supports.

    Parameters
    ----------
    table : a Table, a CompressedTable (then the result says with what tolerance), or a LargeTable, whose
        file every pass reads anew.
    model : a short name ("ward", "lafortune:2"), a ModelSpec, or a whole FitSpec, which then rules alone.
        "auto" compares models (:func:`fitter.select`) and returns the chosen one's fit, with the ranking in
        ``evidence["selection"]``.
    metric : see :mod:`fitter.fitting.metrics`; None takes "measurement" where sigma is stated, else "cbrt".
    weighting : "samples", or "solid_angle" for samples to count by the solid angles that they stand for; None
        takes the latter for tables on a grid, but for the metrics "measurement" and "absolute".
    progress : called with (share, text); may raise to stop the fit.

    Raises
    ------
    SpecError : the request makes no sense for this model or table.
    FitError : nothing usable to fit, fewer values than parameters, or the solver failed.
    """
    if model == spec.AUTO:
        # Selection is built of fits: it can't be imported before this function is there.
        from fitter.selection import select as compare

        if isinstance(table, LargeTable):
            raise SpecError(
                "auto compares models on a table in memory", code="bad-spec", parameter="model",
                remedy="name the model, or compare on a part of the table",
            )  # fmt: skip
        if fixed or bounds:
            raise SpecError(
                "fixed and bounds name parameters of one model, and auto compares several",
                code="bad-spec", parameter="fixed" if fixed else "bounds",
                remedy="name the model, or compare without them",
            )  # fmt: skip
        return compare(
            table, metric=metric, solver=solver, select=select or Select(), starts=starts, subset=subset,
            seed=seed, progress=progress,
        ).chosen  # fmt: skip
    clock = Clock({}, time.perf_counter())
    if isinstance(model, FitSpec):
        request = model
    else:
        request = spec.fit_spec(
            {
                "model": spec.model_spec(model), "metric": metric, "weighting": weighting, "solver": solver,
                "fixed": dict(fixed or {}), "bounds": dict(bounds or {}), "select": select or Select(),
                "starts": starts, "subset": subset, "seed": seed,
            }
        )  # fmt: skip
    reduction: dict[str, Any] = {"compressed": None}
    if isinstance(table, CompressedTable):
        reduction["compressed"] = {"tolerance": table.tolerance, "bytes": table.nbytes}
        table = table.decompress()
    chosen = request.metric or metrics.default(table.sigma is not None)
    places = layout(request)
    progress(0.0, "preparing samples")
    turned = not places.family.isotropic(request.model)
    if isinstance(table, LargeTable):
        reduction["out_of_core"] = {"sample": len(table.sample), "rows": table.rows}
        data = from_file(table, chosen, request.select, anisotropic=turned)
    else:
        data = usable(
            table, chosen, request.select, anisotropic=turned,
            weighting=metrics.weighting(chosen, request.weighting, table.grid is not None),
        )  # fmt: skip
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
    progress(1.0, "done")
    return result


def _solve(
    places: Layout, metric: Metric, request: FitSpec, data: Usable, group: Sequence[int], clock: Clock
) -> Group:
    floor = data.floor[list(group)]
    index, scale = data.subset(request.subset, request.seed)
    reduced = reduction.reduce(places, data, group) if len(index) < len(data) else None
    if reduced is None:
        # A power of two, so that few lengths are compiled for.
        size = max(1024, 1 << (len(index) - 1).bit_length())
        part, examined = data.part(group, index, size, scale), len(index)
    else:
        part, examined = reduced, len(data)
    weight = np.broadcast_to(metrics.linearised_weight(metric, part.y, part.weight, floor), part.y.shape)
    clock.lap("reduce")
    finder = search.search if request.solver == "optimistix" else nlopt_solver.search
    seen = slice(max(1024, 1 << (part.count - 1).bit_length()))
    basins, evidence = finder(
        places, part.pair[:, seen], part.y[seen], weight[seen], request.starts, request.seed
    )
    clock.lap("search")

    # The subset's own objective ranks the basins: for log and cbrt the search saw only its tangent.
    fits = part.y.shape[0] % CHUNK == 0
    blocks: Sequence[Block] = [part if fits else data.part(group, index, BLOCK, scale)]
    ends = [
        polish(places, metric, floor, np.concatenate([b.u, b.inner.reshape(-1)]), blocks, 20)
        for b in basins[:BASINS]
    ]
    best = min(ends, key=lambda end: end.normal.objective)
    near = [in_order(places, end.p) for end in ends if end.normal.objective <= NEAR * best.normal.objective]
    clock.lap("subset polish")
    full: Blocks = data.blocks(group) if len(index) < len(data) else blocks
    passes = 0
    finish = polish if request.solver == "optimistix" else nlopt_solver.polish
    if reduced is not None:
        # The pseudo-samples are the table: their optimum is its optimum.
        end = finish(places, metric, floor, in_order(places, best.p), blocks)
    else:
        if len(near) > 1:
            rivals = [polish(places, metric, floor, p, full, 10) for p in near]
            near = [min(rivals, key=lambda end: end.normal.objective).p]
            passes = sum(end.passes for end in rivals)
        end = finish(places, metric, floor, near[0], full)
        passes += end.passes
    p, normal = order_axes(places, end.p, end.normal)
    end = replace(end, p=p, normal=normal)
    clock.lap("polish")
    if not np.isfinite(end.normal.objective):
        raise FitError(
            f"the objective of {request.model.name} is not finite", code="not-finite",
            cause="values near the limits of floating point", remedy="rescale the table's values",
        )  # fmt: skip
    positions = [data.channels[c] for c in group]
    found = errors(places, metric, floor, end.p, full)
    some, step = data.blocks_of_some(group)
    told = scores(places, metric, floor, end.p, some, step)
    estimates = natural(places, end.p, end.normal, told, positions, len(data), data.likelihood)
    clock.lap("uncertainty")
    return Group(end, found, estimates, evidence | {"reduced": reduced is not None}, examined, passes)


def _enough(data: Usable, places: Layout, per_group: int) -> None:
    parameters = len(places.entries) + len(places.linear) * per_group
    values = len(data) * per_group
    if values < parameters:
        raise FitError(
            f"{values} usable values can't determine the {parameters} parameters of {places.spec.name}",
            code="too-few-samples", cause="a very small table, or most of its samples are masked",
            remedy="measure more geometries, fix parameters, or fit a simpler model",
        )  # fmt: skip
