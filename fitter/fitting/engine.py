"""fit: global search on a subset, polish on the full table, uncertainties, and a frank account of it all."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import progress, spec
from fitter.compression import CompressedTable
from fitter.errors import FitError, SpecError
from fitter.fitting import budget, clock, metrics
from fitter.fitting.layout import Layout, channel_groups, layout
from fitter.fitting.result import FitResult
from fitter.fitting.samples import Usable
from fitter.fitting.solving import solve
from fitter.fitting.streamed import from_file
from fitter.fitting.usable import usable
from fitter.fitting.writeup import Group, write_up
from fitter.large import LargeTable
from fitter.spec import FitSpec, Metric, ModelSpec, Select
from fitter.table import Table

FloatArray = NDArray[np.float64]


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
    polish: spec.Polish = "full",
    budget_seconds: float | None = None,
    target_error: float | None = None,
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
    budget_seconds, target_error : choose the effort instead, see :mod:`fitter.fitting.budget`.
    progress : called with (share, text); may raise to stop the fit.

    Raises
    ------
    SpecError : the request makes no sense for this model or table.
    FitError : nothing usable to fit, fewer values than parameters, the solver failed, or "unattainable": no
        effort keeps the budget or reaches the target.
    """
    if model == spec.AUTO:
        # Selection is built of fits: it can't be imported before this function is there.
        from fitter.selection import select as compare

        in_memory = _in_memory(table, "auto compares models", "model")
        for name, given in (
            ("fixed", fixed), ("bounds", bounds), ("weighting", weighting),
            ("budget_seconds", budget_seconds), ("target_error", target_error),
        ):  # fmt: skip
            if given:
                raise SpecError(
                    f"{name} is for the fit of one model, and auto compares several", code="bad-spec",
                    parameter=name, remedy="name the model, or compare without it",
                )  # fmt: skip
        return compare(
            in_memory, metric=metric, solver=solver, select=select or Select(), starts=starts, subset=subset,
            seed=seed, progress=progress,
        ).chosen  # fmt: skip
    if isinstance(model, FitSpec):
        request = model
    else:
        request = spec.fit_spec(
            {
                "model": spec.model_spec(model), "metric": metric, "weighting": weighting, "solver": solver,
                "fixed": dict(fixed or {}), "bounds": dict(bounds or {}), "select": select or Select(),
                "starts": starts, "subset": subset, "polish": polish,
                "budget_seconds": budget_seconds, "target_error": target_error, "seed": seed,
            }
        )  # fmt: skip
    if request.budget_seconds is not None or request.target_error is not None:
        held = _in_memory(table, "a budget chooses the effort for a table", "budget_seconds")
        return budget.fit_within(held, request, _fit, progress)
    return _fit(table, request, progress)


def _in_memory(
    table: Table | CompressedTable | LargeTable, what: str, parameter: str
) -> Table | CompressedTable:
    if isinstance(table, LargeTable):
        raise SpecError(
            f"{what} in memory", code="bad-spec", parameter=parameter,
            remedy="state model and effort, or load a part of the table",
        )  # fmt: skip
    return table


def _fit(
    table: Table | CompressedTable | LargeTable, request: FitSpec, progress: progress.Progress
) -> FitResult:
    """The fit itself, with the effort that the request states."""
    with clock.running() as running:
        return _timed(table, request, progress, running)


def _timed(
    table: Table | CompressedTable | LargeTable, request: FitSpec, progress: progress.Progress,
    clock: clock.Clock,
) -> FitResult:  # fmt: skip
    reduction: dict[str, Any] = {"compressed": None}
    if isinstance(table, CompressedTable):
        reduction["compressed"] = {"tolerance": table.tolerance, "bytes": table.nbytes}
        table = table.decompress()
    metric = request.metric or metrics.default(table.sigma is not None)
    places = layout(request)
    progress(0.0, "preparing samples")
    turned = not places.family.isotropic(request.model)
    if isinstance(table, LargeTable):
        if request.weighting == "solid_angle":
            raise SpecError(
                "samples that stay in their file can't be weighted by solid angle", code="bad-spec",
                parameter="weighting", cause="what each stands for depends on all others",
                remedy="use weighting 'samples'",
            )  # fmt: skip
        reduction["out_of_core"] = {"sample": len(table.sample), "rows": table.rows}
        data = from_file(table, metric, request.select, anisotropic=turned)
    else:
        data = usable(
            table, metric, request.select, anisotropic=turned,
            weighting=metrics.weighting(metric, request.weighting, table.grid is not None),
        )  # fmt: skip
    groups = channel_groups(request, len(data.channels))
    places = layout(request, len(data.channels))
    _enough(data, places, len(groups[0]))
    clock.lap("prepare")

    solved: list[Group] = []
    draw = functools.cache(lambda size: data.subset(size, request.seed))
    for k, group in enumerate(groups):
        progress((k + 0.1) / (len(groups) + 1), f"searching {request.model.name}")
        solved.append(solve(places, request, data, group, draw, clock))
    progress(0.95, "writing up")
    result = write_up(table, request, metric, data, groups, solved, reduction, clock)
    budget.remember_compiled(request, places, data, len(groups[0]))
    progress(1.0, "done")
    return result


def _enough(data: Usable, places: Layout, per_group: int) -> None:
    parameters = len(places.entries) + len(places.linear) * per_group
    values = len(data) * per_group
    if values < parameters:
        raise FitError(
            f"{values} usable values can't determine the {parameters} parameters of {places.spec.name}",
            code="too-few-samples", cause="a very small table, or most of its samples are masked",
            remedy="measure more geometries, fix parameters, or fit a simpler model",
        )  # fmt: skip
