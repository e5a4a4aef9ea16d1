"""The write-up of a fit: estimates, metrics, a verdict in words, and what it cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitter import models
from fitter._version import __version__
from fitter.fitting.clock import Clock
from fitter.fitting.covariance import Natural
from fitter.fitting.energy import LargestAlbedo, largest_albedo
from fitter.fitting.polish import Polished
from fitter.fitting.result import Estimate, FitResult
from fitter.fitting.samples import Usable
from fitter.fitting.sums import Errors
from fitter.large import LargeTable
from fitter.spec import FitSpec, Metric
from fitter.table import Table
from fitter.versions import installed

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Group:
    """The solution of one group of channels that share their nonlinear parameters."""

    polished: Polished
    errors: Errors
    estimates: Natural
    evidence: dict[str, Any]
    subset: int
    passes: int
    #: By what share of itself the rms residual is above that of the optimum, at most (95 %).
    search_error: float
    #: What the choice of a subset does to each estimate, see :mod:`fitter.fitting.selection_error`; None
    #: where the whole table was looked at.
    selection_error: FloatArray | None = None


def write_up(
    table: Table | LargeTable, request: FitSpec, metric: Metric, data: Usable, groups: list[list[int]],
    solved: list[Group], reduction: dict[str, Any], clock: Clock,
) -> FitResult:  # fmt: skip
    """The FitResult of the solved groups; ``reduction`` says how the table was made smaller."""
    names = tuple(table.channels[c].name for c in data.channels)
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
            none = np.asarray(np.nan)
            parameters[p.name] = Estimate(value, none, none, p.unit, p.description, (None,))
            continue
        common = (p.name, None) in slots
        keys = [(p.name, None)] if common else [(p.name, c) for c in data.channels]
        found = [slots[key] for key in keys]
        value = np.array([solved[g].estimates.values[k] for g, k in found])
        u = np.sqrt(np.array([solved[g].estimates.covariance[k, k] for g, k in found]))
        freedom = np.array([solved[g].estimates.degrees[k] for g, k in found])
        ends = tuple(solved[g].estimates.at_bound[k] for g, k in found)
        scalar = not p.linear and (common or len(names) == 1)
        y, u, freedom = (np.asarray(a[0] if scalar else a) for a in (value, u, freedom))
        parameters[p.name] = Estimate(y, u, freedom, p.unit, p.description, ends)
        labels += [p.name if scalar or c is None else f"{p.name}[{table.channels[c].name}]" for _, c in keys]
        rows += found
    choices = [solved[g].selection_error for g, _ in rows]
    selection = None
    if any(choice is not None for choice in choices):
        selection = {
            label: None if choice is None or not np.isfinite(choice[k]) else float(choice[k])
            for label, choice, (_, k) in zip(labels, choices, rows, strict=True)
        }
    covariance = np.zeros((len(rows), len(rows)))
    for i, (g, k) in enumerate(rows):
        for j, (other, m) in enumerate(rows):
            if g == other:
                covariance[i, j] = solved[g].estimates.covariance[k, m]

    kind = models.family_of(request.model)
    values = {name: jnp.asarray(e.value) for name, e in parameters.items()}
    model = kind(spec=request.model, channels=names, values=values)
    incidences = table.domain.theta_i
    if (limit := request.select.theta_i_max_deg) is not None:
        incidences = (incidences[0], min(incidences[1], math.radians(limit)))
    albedo = largest_albedo(model, incidences)
    status, message, warnings = _verdict(request, names, groups, solved, data, table, albedo)
    complete = request.polish == "full" or all(s.subset == len(data) for s in solved)
    used = {"fitted": len(data), "subset": max(s.subset for s in solved), "left_out": data.left_out}
    clock.lap("check")
    return FitResult(
        spec=request,
        model=model,
        parameters=parameters,
        labels=tuple(labels),
        covariance=covariance,
        uncertainty="curvature" if data.likelihood and complete else "sandwich",
        metrics=_metrics(data, solved),
        status=status,
        message=message,
        evidence={
            "solver": request.solver,
            "search_error": max(s.search_error for s in solved),
            "selection_error": selection,
            "groups": [
                {"channels": [names[c] for c in group], **s.evidence}
                for group, s in zip(groups, solved, strict=True)
            ],
            "largest_albedo": {
                "value": albedo.value, "channel": names[albedo.channel],
                "theta_i_deg": math.degrees(albedo.theta_i), "phi_i_deg": math.degrees(albedo.phi_i),
            },
        },
        cost={
            **clock.cost(None if isinstance(table, LargeTable) else table.load_seconds),
            "passes": sum(s.passes for s in solved),
            "samples": len(data),
        },
        table={
            "name": table.metadata.name, "hash": table.hash, "samples": len(table),
            "usable": table.usable, "metric": metric, "weighting": data.weighting,
            "domain": table.domain.to_dict(), **used, **reduction,
        },
        warnings=warnings,
        versions={"brdf-fitter": __version__}
        | {name: installed(name) for name in ("numpy", "jax", "optimistix", "nlopt")},
    )  # fmt: skip


def _metrics(data: Usable, solved: list[Group]) -> dict[str, float]:
    values = len(data) * len(data.channels)
    objective = sum(s.errors.objective for s in solved)
    squared = sum(s.errors.squared for s in solved)
    spread = float(data.summary.spread.sum())
    free = sum(len(s.polished.p) for s in solved)
    found = {
        "objective": objective / values,
        "rmse": float(np.sqrt(squared / values)),
        "relative_rmse": float(np.sqrt(sum(s.errors.relative for s in solved) / values)),
        "r2": 1.0 - squared / spread if spread > 0 else float("nan"),
    }
    if data.likelihood and values > free:
        # Birge ratio: 1 where the stated noise explains the residuals.
        found["chi2_per_dof"] = objective / (values - free)
    return found


def _verdict(
    request: FitSpec, names: Sequence[str], groups: list[list[int]], solved: list[Group], data: Usable,
    table: Table | LargeTable, albedo: LargestAlbedo,
) -> tuple[str, str, tuple[str, ...]]:  # fmt: skip
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
        # Starts from the minima of a scan lie in basins of their own: none need agree.
        if starts > 1 and s.evidence["agree"] == 1 and not s.evidence.get("scanned"):
            warnings.append(f"only 1 of {starts} starts reached the best optimum: try more starts")
    for why, count in data.left_out.items():
        warnings.append(f"{count} usable samples left out: {why}")
    isotropic = models.family_of(request.model).isotropic(request.model)
    if table.symmetry == "anisotropic" and isotropic:
        warnings.append("the table is anisotropic and this model is not: it finds an average over azimuths")
    if table.symmetry == "isotropic" and not isotropic:
        warnings.append("the table is isotropic and this model is not: its azimuth means nothing")
    if any(label.partition("[")[0].endswith("psi") for label in open_labels):
        warnings.append("no direction is found in the surface: the isotropic form of this model would do")
    if albedo.exceeds:
        warnings.append(
            f"reflects {albedo.value:.3g} of the light at theta_i = {math.degrees(albedo.theta_i):.0f} deg, "
            f"channel {names[albedo.channel]}: more than arrives"
        )
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
    used = max(s.subset for s in solved)
    if request.polish == "subset" and used < len(data):
        message = f"converged on a subset of {used} of {len(data)} samples"
        stated = np.concatenate([s.selection_error for s in solved if s.selection_error is not None])
        if np.isfinite(stated).any():
            message += f", whose choice moves a parameter by up to {np.nanmax(stated):.2g} standard errors"
        return "converged", message, tuple(warnings)
    return "converged", f"converged in {passes} passes over {len(data)} samples", tuple(warnings)
