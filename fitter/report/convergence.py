"""The posterior as the report shows it: convergence, history, and draws for the corner plot."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fitter.report.clean import drawn
from fitter.report.fitted import Fitted, display

if TYPE_CHECKING:
    from fitter.posterior.result import Posterior

#: Parameters and draws that the corner plot shows at most.
MOST_PARAMETERS = 6
MOST_DRAWS = 1_500
CAVEAT = (
    "The posterior is the one under the stated likelihood, whose noise is independent from sample to sample. "
    "Where the residuals are systematic, as they are on nearly every measured table, its credible intervals "
    "are too narrow, often several times."
)


def section(fitted: Fitted, posterior: Posterior | None) -> dict[str, Any] | None:
    """JSON-ready, None without a posterior."""
    if posterior is None:
        return None
    found = posterior.diagnostics.values()
    varying = _varying(posterior)
    shown = _for_corner(fitted, posterior, varying)
    rows = np.linspace(0, len(posterior.draws) - 1, min(len(posterior.draws), MOST_DRAWS)).astype(int)
    return {
        "status": posterior.status,
        "message": posterior.message,
        "caveat": CAVEAT,
        "draws": len(posterior.draws),
        "acceptance": posterior.acceptance,
        "largest_rhat": _extreme([d.rhat for d in found], largest=True),
        "smallest_ess_bulk": _extreme([d.ess_bulk for d in found], largest=False),
        "smallest_ess_tail": _extreme([d.ess_tail for d in found], largest=False),
        "targets": {"rhat": posterior.spec.rhat, "ess": posterior.spec.ess},
        "diagnostics": {label: d.to_dict() for label, d in posterior.diagnostics.items()},
        "noise": dict(posterior.noise),
        "history": [dict(h) for h in posterior.history],
        "time": _time(posterior),
        "cost": dict(posterior.cost),
        "spec": posterior.spec.model_dump(mode="json"),
        "corner": {
            "labels": [display(posterior.labels[k], fitted.fit.model.channels) for k in shown],
            "of": len(posterior.labels),
            "draws": [drawn(posterior.draws[rows, k], 7) for k in shown],
            "estimates": [_estimate(fitted, posterior.labels[k]) for k in shown],
        },
        "warnings": list(posterior.warnings),
    }


def _time(posterior: Posterior) -> list[dict[str, float]]:
    """What the sampling time bought, and what half or ten times of it would: effective samples grow with it,
    and the error that is left in a standard deviation is 1/sqrt(2 ESS) of it, in the end of a 95 % interval
    2.7/sqrt(ESS) standard deviations (the density of a normal at its 2.5 % quantile)."""
    if not posterior.history or not posterior.history[-1].get("ess"):
        return []
    last = posterior.history[-1]
    rows: list[dict[str, float]] = []
    for times in (0.5, 1.0, 10.0):
        ess = times * float(last["ess"])
        rows.append({
            "times": times, "seconds": times * float(last["seconds"]), "ess": ess,
            "error_of_deviation": float(1.0 / np.sqrt(2.0 * ess)), "error_of_end": float(2.7 / np.sqrt(ess)),
        })  # fmt: skip
    return rows


def _varying(posterior: Posterior) -> list[int]:
    """Columns that a histogram can be made of."""
    draws = posterior.draws
    return [k for k in range(draws.shape[1]) if np.isfinite(draws[:, k]).all() and np.ptp(draws[:, k]) > 0]


def _for_corner(fitted: Fitted, posterior: Posterior, varying: list[int]) -> list[int]:
    """The shared parameters first, then those of one channel after the other."""
    order = [fitted.fit.model.channels[c] for c in fitted.shown]

    def rank(k: int) -> tuple[int, int]:
        name, bracket, rest = posterior.labels[k].partition("[")
        noise = name not in fitted.fit.parameters
        if not bracket:
            return (len(order) if noise else -1, k)
        channel = rest.removesuffix("]")
        return ((order.index(channel) if channel in order else len(order)) + (len(order) + 1) * noise, k)

    return sorted(sorted(varying, key=rank)[:MOST_PARAMETERS])


def _estimate(fitted: Fitted, label: str) -> float | None:
    name, bracket, rest = label.partition("[")
    estimate = fitted.fit.parameters.get(name)
    if estimate is None:
        return None
    channel = rest.removesuffix("]")
    return float(estimate.value[fitted.fit.model.channels.index(channel)] if bracket else estimate.value)


def _extreme(values: list[float], *, largest: bool) -> float | None:
    finite = [v for v in values if np.isfinite(v)]
    if len(finite) < len(values) or not finite:
        return None  # a parameter without a diagnostic has not been shown to converge
    return float(max(finite) if largest else min(finite))
