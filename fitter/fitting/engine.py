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
from fitter.errors import FitError
from fitter.fitting import metrics, nlopt_solver, search
from fitter.fitting.covariance import natural
from fitter.fitting.layout import Layout, channel_groups, layout
from fitter.fitting.order import in_order, order_axes
from fitter.fitting.polish import polish, support
from fitter.fitting.result import FitResult
from fitter.fitting.samples import BLOCK, Usable, usable
from fitter.fitting.writeup import Clock, Group, write_up
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
    """Fit one model to a table by separable least squares.

    Parameters
    ----------
    table : a Table, or a CompressedTable (then the result says with what tolerance).
    model : a short name ("ward", "lafortune:2"), a ModelSpec, or a whole FitSpec, which then rules alone.
    metric : see :mod:`fitter.fitting.metrics`; None takes "measurement" where sigma is stated, else "cbrt".
    weighting : "samples", or "solid_angle" for samples to count by the solid angles that they stand for; None
        takes the latter for tables on a grid, but for the metrics "measurement" and "absolute".
    progress : called with (share, text); may raise to stop the fit.

    Raises
    ------
    SpecError : the request makes no sense for this model or table.
    FitError : nothing usable to fit, fewer values than parameters, or the solver failed.
    """
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
    chosen: Metric = request.metric or ("measurement" if table.sigma is not None else "cbrt")
    places = layout(request)
    progress(0.0, "preparing samples")
    data = usable(
        table, chosen, request.select, anisotropic=not places.family.isotropic(request.model),
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
    # A power of two, so that few lengths are compiled for.
    size = max(1024, 1 << (len(index) - 1).bit_length())
    part = data.part(group, index, size, scale)
    weight = np.asarray(metrics.linearised_weight(metric, part.y, part.weight, floor))
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
    full = data.blocks(group) if len(index) < len(data) else blocks
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
    estimates = natural(places, end.p, end.normal, lives_on, positions, len(data), data.likelihood)
    clock.lap("uncertainty")
    return Group(end, estimates, evidence, len(index), passes + end.passes)


def _enough(data: Usable, places: Layout, per_group: int) -> None:
    parameters = len(places.entries) + len(places.linear) * per_group
    values = len(data) * per_group
    if values < parameters:
        raise FitError(
            f"{values} usable values can't determine the {parameters} parameters of {places.spec.name}",
            code="too-few-samples", cause="a very small table, or most of its samples are masked",
            remedy="measure more geometries, fix parameters, or fit a simpler model",
        )  # fmt: skip
