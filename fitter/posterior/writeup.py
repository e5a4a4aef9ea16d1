"""write_up: what a run has found becomes a Posterior."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from fitter.fitting.result import FitResult
from fitter.fitting.samples import Usable
from fitter.posterior.beside import beside, rescaled
from fitter.posterior.ensembles import Ensembles
from fitter.posterior.jackknife import Robust
from fitter.posterior.looks import Look
from fitter.posterior.result import Posterior
from fitter.spec import PosteriorSpec
from fitter.table import Table

FloatArray = NDArray[np.float64]
#: An offset is remarkable from so many standard uncertainties on.
FAR_OFF = 3.0
#: Draws are as open as their prior from this share of its standard deviation on.
EVEN = 0.85
#: Draws lie against a bound where 97.5 % of them are within this share of the range of it.
AGAINST = 0.05


def write_up(
    table: Table, fit: FitResult, request: PosteriorSpec, runs: list[Ensembles], look: Look,
    history: list[dict[str, float]], kind: str, data: Usable, used: int, phases: dict[str, float],
    resumed: int, plain: dict[str, float] | None, without_scans: Robust | None,
) -> Posterior:  # fmt: skip
    rng = np.random.default_rng([request.seed, 1])
    labels: list[str] = []
    columns: list[FloatArray] = []
    for run in runs:
        flat = run.chains(look.discarded, look.steps).reshape(-1, run.density.size)
        # Groups are independent, so any pairing of their draws is a draw of all.
        picked = flat[rng.choice(len(flat), request.keep, replace=len(flat) < request.keep)]
        columns.append(run.natural(picked))
        labels += run.labels
    sampled = np.concatenate(columns, axis=1)
    draws = sampled
    if request.draws == "robust" and without_scans is not None:
        draws = rescaled(sampled, labels, fit.model, without_scans, rng)
    diagnostics = {
        label: d
        for run, group in zip(runs, look.found, strict=True)
        for label, d in zip(run.labels, group, strict=True)
    }
    steps, walkers = look.steps, len(runs[0].proposal.walkers)
    reached = f"R-hat {look.rhat:.4f}, effective sample size {look.ess:.0f} after {steps} steps"
    status = "converged" if look.met else "not_converged"
    pressed, open_ends = _pressed(runs, fit, look), _open(runs, look)
    if look.met and pressed:
        status = "prior_conflict"
        message = (
            f"the bounds given for {', '.join(pressed)} exclude what the table asks for: the draws lie "
            f"against them ({reached})"
        )
    elif look.met and open_ends:
        status = "not_identified"
        message = (
            f"the draws of {', '.join(open_ends)} fill the whole range that was allowed: the table says "
            f"nothing of it ({reached})"
        )
    elif look.met:
        message = f"converged: {reached}"
    else:
        message = (
            f"not converged within {request.budget_seconds:g} s: {reached}; wanted R-hat < {request.rhat:g} "
            f"and {request.ess} effective samples: give it more time"
        )
    warnings: list[str] = []
    if used < len(data):
        warnings.append(
            f"conditioned on {used} of {len(data)} samples: intervals are wider than the table allows"
        )
    if kind == "inferred":
        warnings.append(
            "misfit counts as independent noise here: on real tables it is correlated, and these intervals "
            "are too narrow by a factor of several; compare the fit's own standard uncertainties"
        )
    if table.domain.incidences == 1:
        warnings.append(
            "one incidence: what the parameters do at other incidences is the model's, not the table's"
        )
    chi2 = fit.metrics.get("chi2_per_dof")
    if kind == "table" and chi2 is not None and chi2 > 2:
        warnings.append(
            f"residuals exceed the stated noise (Birge ratio {np.sqrt(chi2):.1f}): the model is not exact, "
            "and these intervals leave that out"
        )
    scale = table.metadata.scale_uncertainty
    if scale:
        warnings.append(
            f"the table's common scale uncertainty of {100 * scale:.2g} % is not in these draws: it adds to "
            "the uncertainty of every albedo, as the report states it"
        )
    stated = table.metadata.angle_uncertainty
    if stated and request.angles == "exact" and request.angle_uncertainty_deg is None:
        warnings.append(
            f"the table's angle uncertainty of {np.rad2deg(stated):.2g} deg is not in these draws: the "
            "report propagates it, and angles 'offset' samples it"
        )
    for k, label in enumerate(labels):
        if label.endswith("_offset"):
            off = float(sampled[:, k].mean() / runs[0].units[runs[0].labels.index(label)])
            if abs(off) > FAR_OFF:
                warnings.append(
                    f"{label} comes out {abs(off):.1f} standard uncertainties from 0: the angles are less "
                    "exact than stated, or the model's misfit looks like an offset"
                )
    return Posterior(
        spec=request,
        fit_spec=fit.spec,
        template=fit.model,
        labels=tuple(labels),
        draws=draws,
        noise={**_noise(kind, data), **_shape(request)},
        diagnostics=diagnostics,
        acceptance=float(np.mean([run.acceptance for run in runs])),
        status=status,
        message=message,
        history=tuple(history),
        cost={
            "seconds": sum(phases.values()),
            "phases": phases,
            "evaluations": sum((run.tuning + run.steps) * walkers for run in runs),
            "walkers": walkers // request.ensembles, "ensembles": request.ensembles, "steps": steps,
            "discarded": look.discarded, "tuning_steps": [run.tuning for run in runs],
            "resumed_at_step": resumed,
        },
        table={"name": table.metadata.name, "hash": table.hash, "samples": len(data), "used": used},
        uncertainties=beside(labels, sampled, _likelihood(kind, request, labels), plain, without_scans),
        warnings=tuple(warnings),
    )  # fmt: skip


def _open(runs: list[Ensembles], look: Look) -> list[str]:
    """Labels of parameters whose draws are spread as evenly as their prior."""
    found: list[str] = []
    for run in runs:
        low, high = run.density.prior_range
        sd = run.chains(look.discarded, look.steps).std(axis=(0, 1))
        even = (high - low) / math.sqrt(12.0)
        for k in np.flatnonzero(np.isfinite(high)):
            if sd[k] > EVEN * even[k] and not run.labels[k].endswith("_offset"):
                found.append(run.labels[k])
    return found


def _pressed(runs: list[Ensembles], fit: FitResult, look: Look) -> list[str]:
    """Labels of parameters that lie against a bound of the specification."""
    found: list[str] = []
    for run in runs:
        density, y = run.density, run.chains(look.discarded, look.steps)
        for k, label in enumerate(run.labels):
            if label.partition("[")[0] in fit.spec.bounds:
                low, high = density.lower[k], density.upper[k]
                ends = np.quantile(np.minimum(y[..., k] - low, high - y[..., k]), 0.975)
                if ends < AGAINST * (high - low):
                    found.append(label)
    return found


def _shape(request: PosteriorSpec) -> dict[str, Any]:
    if request.likelihood == "gaussian":
        return {"likelihood": "gaussian"}
    return {"likelihood": "student_t", "degrees_of_freedom": request.degrees_of_freedom}


def _likelihood(kind: str, request: PosteriorSpec, labels: list[str]) -> str:
    """The likelihood in words."""
    shape = "Gaussian noise"
    if request.likelihood == "student_t":
        shape = f"Student's t noise with {request.degrees_of_freedom:g} degrees of freedom"
    scale = "the scale that the table states" if kind == "table" else "an inferred scale"
    offsets = ", and offsets of the instrument's angles" if labels[-1].endswith("_offset") else ""
    return f"independent {shape} of {scale}{offsets}"


def _noise(kind: str, data: Usable) -> dict[str, Any]:
    """The noise model in numbers: of a new measurement, where the table states its sigma, a fit to it."""
    if kind == "inferred" or data.sigma is None:
        return {"kind": kind}
    variance = np.square(data.sigma).reshape(-1)
    design = np.stack([np.square(data.value).reshape(-1), np.ones(len(variance))], axis=1)
    weight = 1.0 / variance
    # Weighted by 1/variance: the relative error of the variance is what should be small.
    solved, _ = nnls(design * weight[:, None], variance * weight)
    relative, floor = (float(np.sqrt(part)) for part in solved)
    return {"kind": kind, "relative_noise": relative, "noise_floor": floor}
