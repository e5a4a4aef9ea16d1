"""fit: global search on a subset, polish on the full table, uncertainties, and a frank account of it all."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitter import models, progress, spec
from fitter._version import __version__
from fitter.compression import CompressedTable
from fitter.errors import FitError
from fitter.fitting import nlopt_solver, search
from fitter.fitting.covariance import Natural, natural
from fitter.fitting.layout import Layout, layout, order_lobes, per_channel
from fitter.fitting.metrics import linearised_weight
from fitter.fitting.polish import Polished, polish
from fitter.fitting.result import Estimate, FitResult
from fitter.fitting.samples import BLOCK, Usable, usable
from fitter.spec import FitSpec, Metric, ModelSpec, Select
from fitter.table import Table

FloatArray = NDArray[np.float64]
#: Basins of the subset that are polished there, and within what share of the best one's objective they
#: go on to the full table: a subset can't tell near-equals apart.
BASINS, NEAR = 5, 1.1


@dataclass
class _Clock:
    """Seconds by phase, monotonic."""

    phases: dict[str, float]
    last: float

    def lap(self, phase: str) -> None:
        now = time.perf_counter()
        self.phases[phase] = self.phases.get(phase, 0.0) + now - self.last
        self.last = now


@dataclass(frozen=True)
class _Group:
    """The solution of one group of channels that share their nonlinear parameters."""

    polished: Polished
    estimates: Natural
    evidence: dict[str, Any]
    subset: int
    passes: int


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
    seed: int = 0,
    progress: progress.Progress = progress.ignore,
) -> FitResult:
    """Fit one model to a table by separable least squares.

    Parameters
    ----------
    table : a Table, or a CompressedTable (then the result says with what tolerance).
    model : a short name ("ward", "lafortune:2"), a ModelSpec, or a whole FitSpec, which then rules alone.
    metric : see :mod:`fitter.fitting.metrics`; None takes "measurement" where sigma is stated, else "cosine".
    progress : called with (share, text); may raise to stop the fit.

    Raises
    ------
    SpecError : the request makes no sense for this model or table.
    FitError : nothing usable to fit, fewer values than parameters, or the solver failed.
    """
    clock = _Clock({}, time.perf_counter())
    if isinstance(model, FitSpec):
        request = model
    else:
        request = spec.fit_spec(
            {
                "model": spec.model_spec(model), "metric": metric, "solver": solver, "fixed": dict(fixed or {}),
                "bounds": dict(bounds or {}), "select": select or Select(), "starts": starts,
                "subset": subset, "seed": seed,
            }
        )  # fmt: skip
    reduction: dict[str, Any] = {"compressed": None}
    if isinstance(table, CompressedTable):
        reduction["compressed"] = {"tolerance": table.tolerance, "bytes": table.nbytes}
        table = table.decompress()
    chosen: Metric = request.metric or ("measurement" if table.sigma is not None else "cosine")
    places = layout(request)
    separate = per_channel(request.model)
    progress(0.0, "preparing samples")
    data = usable(table, chosen, request.select)
    _enough(data, places, separate)
    clock.lap("prepare")

    channels = range(len(data.channels))
    groups = [[c] for c in channels] if separate else [list(channels)]
    solved: list[_Group] = []
    for k, group in enumerate(groups):
        progress((k + 0.1) / (len(groups) + 1), f"searching {request.model.name}")
        solved.append(_solve(places, chosen, request, data, group, clock))
    progress(0.95, "writing up")
    result = _result(table, request, chosen, places, data, groups, solved, reduction, clock)
    progress(1.0, "done")
    return result


def _solve(
    places: Layout, metric: Metric, request: FitSpec, data: Usable, group: Sequence[int], clock: _Clock
) -> _Group:
    floor = data.floor[list(group)]
    index, scale = data.subset(request.subset, request.seed)
    # A power of two, so that few lengths are compiled for.
    size = max(1024, 1 << (len(index) - 1).bit_length())
    part = data.part(group, index, size, scale)
    weight = np.asarray(linearised_weight(metric, part.y, part.weight, floor))
    finder = search.search if request.solver == "optimistix" else nlopt_solver.search
    basins, evidence = finder(places, part.pair, part.y, weight, request.starts, request.seed)
    clock.lap("search")

    # The subset's own objective ranks the basins: for log and cbrt the search saw only its tangent.
    blocks = [data.part(group, index, max(BLOCK, size), scale)]
    ends = [
        polish(places, metric, floor, np.concatenate([b.u, b.coefficients.reshape(-1)]), blocks, 20)
        for b in basins[:BASINS]
    ]
    best = min(end.normal.objective for end in ends)
    near = [order_lobes(places, end.p) for end in ends if end.normal.objective <= NEAR * best]
    clock.lap("subset polish")
    full = data.blocks(group) if len(index) < len(data) else blocks
    passes = 0
    if len(near) > 1:
        rivals = [polish(places, metric, floor, p, full, 10) for p in near]
        near = [min(rivals, key=lambda end: end.normal.objective).p]
        passes = sum(end.passes for end in rivals)
    finish = polish if request.solver == "optimistix" else nlopt_solver.polish
    end = finish(places, metric, floor, near[0], full)
    clock.lap("polish")
    if not np.isfinite(end.normal.objective):
        raise FitError(
            f"the objective of {request.model.name} is not finite", code="not-finite",
            cause="values near the limits of floating point", remedy="rescale the table's values",
        )  # fmt: skip
    positions = [data.channels[c] for c in group]
    estimates = natural(places, end.p, end.normal, positions, len(data), metric == "measurement")
    clock.lap("uncertainty")
    return _Group(end, estimates, evidence, len(index), passes + end.passes)


def _enough(data: Usable, places: Layout, separate: bool) -> None:
    per_group = 1 if separate else len(data.channels)
    linear = sum(p.linear for p in models.parameter_table(places.spec))
    parameters = len(places.free) + linear * per_group
    values = len(data) * per_group
    if values < parameters:
        raise FitError(
            f"{values} usable values can't determine the {parameters} parameters of {places.spec.name}",
            code="too-few-samples", cause="a very small table, or most of its samples are masked",
            remedy="measure more geometries, fix parameters, or fit a simpler model",
        )  # fmt: skip


def _result(
    table: Table, request: FitSpec, metric: Metric, places: Layout, data: Usable, groups: list[list[int]],
    solved: list[_Group], reduction: dict[str, Any], clock: _Clock,
) -> FitResult:  # fmt: skip
    names = tuple(table.channels[c].name for c in data.channels)
    shared = len(groups) == 1 and len(names) > 1
    table_rows = models.parameter_table(request.model)
    slots: dict[tuple[str, int | None], tuple[int, int]] = {}
    for g, group in enumerate(solved):
        for k, label in enumerate(group.estimates.labels):
            slots[label] = (g, k)

    parameters: dict[str, Estimate] = {}
    labels: list[str] = []
    rows: list[tuple[int, int]] = []
    for p in table_rows:
        if p.name in request.fixed:
            value = np.asarray(request.fixed[p.name])
            parameters[p.name] = Estimate(value, np.asarray(np.nan), p.unit, p.description, (None,))
            continue
        keys = [(p.name, None)] if (shared and not p.linear) else [(p.name, c) for c in data.channels]
        found = [slots[key] for key in keys]
        value = np.array([solved[g].estimates.values[k] for g, k in found])
        u = np.sqrt(np.array([solved[g].estimates.covariance[k, k] for g, k in found]))
        ends = tuple(solved[g].estimates.at_bound[k] for g, k in found)
        scalar = len(keys) == 1 and (not p.linear) and (shared or len(names) == 1)
        parameters[p.name] = Estimate(
            value[0] if scalar else value, u[0] if scalar else u, p.unit, p.description, ends
        )
        labels += [p.name if scalar else f"{p.name}[{table.channels[c].name}]" for _, c in keys]
        rows += found
    covariance = np.zeros((len(rows), len(rows)))
    for i, (g, k) in enumerate(rows):
        for j, (other, m) in enumerate(rows):
            if g == other:
                covariance[i, j] = solved[g].estimates.covariance[k, m]

    kind = models.family_of(request.model)
    values = {name: jnp.asarray(e.value) for name, e in parameters.items()}
    model = kind(spec=request.model, channels=names, values=values)
    status, message, warnings = _verdict(request, names, groups, solved, data, table)
    used = dataclasses.asdict(reduction_of(data, solved)) | reduction
    clock.lap("write up")
    return FitResult(
        spec=request,
        model=model,
        parameters=parameters,
        labels=tuple(labels),
        covariance=covariance,
        uncertainty="curvature" if metric == "measurement" else "sandwich",
        metrics=_metrics(metric, data, groups, solved),
        status=status,
        message=message,
        evidence={
            "solver": request.solver,
            "groups": [
                {"channels": [names[c] for c in group], **s.evidence}
                for group, s in zip(groups, solved, strict=True)
            ],
        },
        cost={
            "seconds": float(sum(clock.phases.values())),
            "phases": {name: float(s) for name, s in clock.phases.items()},
            "passes": sum(s.passes for s in solved),
            "samples": len(data),
        },
        table={
            "name": table.metadata.name, "hash": table.hash, "samples": len(table),
            "usable": int(table.mask.sum()), "metric": metric, "domain": table.domain.to_dict(), **used,
        },
        warnings=warnings,
        versions={"brdf-fitter": __version__}
        | {name: importlib.metadata.version(name) for name in ("numpy", "jax", "optimistix", "nlopt")},
    )  # fmt: skip


@dataclass(frozen=True)
class Reduction:
    """What of the table the fit looked at."""

    fitted: int
    subset: int
    left_out: Mapping[str, int]


def reduction_of(data: Usable, solved: Sequence[_Group]) -> Reduction:
    return Reduction(len(data), max(s.subset for s in solved), data.left_out)


def _metrics(metric: Metric, data: Usable, groups: list[list[int]], solved: list[_Group]) -> dict[str, float]:
    values = data.value.size
    objective = sum(s.polished.normal.objective for s in solved)
    squared = sum(s.polished.normal.squared_error for s in solved)
    spread = float(np.square(data.value - data.value.mean(axis=0)).sum())
    free = sum(len(s.polished.p) for s in solved)
    found = {
        "objective": objective / values,
        "rmse": float(np.sqrt(squared / values)),
        "relative_rmse": float(np.sqrt(sum(s.polished.normal.relative_error for s in solved) / values)),
        "r2": 1.0 - squared / spread if spread > 0 else float("nan"),
    }
    if metric == "measurement" and values > free:
        # Birge ratio: 1 where the stated noise explains the residuals.
        found["chi2_per_dof"] = objective / (values - free)
    return found


def _verdict(
    request: FitSpec, names: Sequence[str], groups: list[list[int]], solved: list[_Group], data: Usable, table: Table
) -> tuple[str, str, tuple[str, ...]]:
    warnings: list[str] = []
    open_labels: list[str] = []
    for s in solved:
        for k, (name, c) in enumerate(s.estimates.labels):
            label = name if c is None or len(names) == 1 else f"{name}[{table.channels[c].name}]"
            if k in s.estimates.unidentified and s.estimates.at_bound[k] is None:
                open_labels.append(label)
            elif s.estimates.at_bound[k] is not None:
                warnings.append(
                    f"{label} is on its {s.estimates.at_bound[k]} bound: it has no symmetric uncertainty"
                )
        starts = s.evidence["starts"]
        if starts > 1 and s.evidence["agree"] == 1:
            warnings.append(f"only 1 of {starts} starts reached the best optimum: try more starts")
    for why, count in data.left_out.items():
        warnings.append(f"{count} usable samples left out: {why}")
    if table.domain.incidences == 1:
        warnings.append("one incidence only: the model's dependence on it is an extrapolation")
    stuck = [k for k, s in enumerate(solved) if not s.polished.converged]
    if stuck:
        where = ", ".join(names[c] for k in stuck for c in groups[k])
        return (
            "not_converged",
            f"the last pass still moved ({where}): the parameters are not at the optimum",
            tuple(warnings),
        )
    if open_labels:
        return (
            "not_identified",
            f"this table does not determine {', '.join(open_labels)}: other values fit it as well",
            tuple(warnings),
        )
    passes = sum(s.passes for s in solved)
    return "converged", f"converged in {passes} passes over {len(data)} samples", tuple(warnings)


