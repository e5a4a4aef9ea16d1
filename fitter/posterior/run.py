"""posterior: independent ensembles run until they agree, or until the budget ends, and which it was."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from fitter import progress
from fitter.compression import CompressedTable
from fitter.errors import SpecError
from fitter.fitting.layout import channel_groups, layout
from fitter.fitting.result import FitResult
from fitter.fitting.samples import Usable, usable
from fitter.posterior.diagnostics import diagnose
from fitter.posterior.ensembles import Ensembles, start
from fitter.posterior.result import Diagnostic, Posterior
from fitter.spec import PosteriorSpec, posterior_spec
from fitter.table import Table

FloatArray = NDArray[np.float64]
FIRST_STEPS = 100
#: Steps of the rounds after which the proposals are fitted to the walkers; all of them are discarded.
TUNING = (100, 100, 200)


def sample(
    table: Table | CompressedTable,
    fit: FitResult,
    spec: PosteriorSpec | None = None,
    *,
    progress: progress.Progress = progress.ignore,
    **settings: Any,
) -> Posterior:
    """Sample the posterior of a fit's free parameters with emcee.

    Parameters
    ----------
    table, fit : the table and a fit of it (the metric of the fit plays no part: the likelihood does).
    spec, settings : a PosteriorSpec, or its fields as keywords.
    progress : called with (share, text); may raise to stop.

    Returns
    -------
    Posterior : with status "not_converged" and the missed target where the budget ended first.

    Raises
    ------
    SpecError : settings that make no sense, or noise="table" without sigma.
    FitError : fewer values than parameters, or a likelihood that is nowhere finite.
    """
    begun = time.perf_counter()
    if spec is not None and settings:
        raise SpecError("give a PosteriorSpec or its fields, not both", code="bad-spec", parameter="spec")
    request = spec or posterior_spec(settings)
    if isinstance(table, CompressedTable):
        table = table.decompress()
    kind = request.noise or ("table" if table.sigma is not None else "inferred")
    if kind == "table" and table.sigma is None:
        raise SpecError(
            "noise 'table' needs the table's own standard uncertainty, and it states none",
            code="noise-needs-sigma", parameter="noise", remedy="use noise='inferred'",
        )  # fmt: skip
    anisotropic = not fit.model.isotropic(fit.spec.model)
    data = usable(table, "absolute", fit.spec.select, anisotropic=anisotropic)
    places = layout(fit.spec, len(data.channels))
    rng = np.random.default_rng(request.seed)
    index = np.arange(len(data))
    if len(index) > request.max_samples:
        index = np.sort(rng.choice(len(data), request.max_samples, replace=False))
    groups = channel_groups(fit.spec, len(data.channels))
    progress(0.0, "finding the mode")
    runs = [start(places, fit, data, index, group, kind, request, rng) for group in groups]
    prepared = time.perf_counter()

    for steps in TUNING:
        progress(0.01, "tuning the proposals")
        for run in runs:
            run.tune(steps)
    tuned = time.perf_counter()

    history: list[dict[str, float]] = []
    steps = FIRST_STEPS
    while True:
        share = min(0.99, (time.perf_counter() - begun) / request.budget_seconds)
        progress(share, f"sampling: {runs[0].samplers[0].iteration} steps")
        for run in runs:
            run.advance(steps)
        found = [diagnose(run.chains()) for run in runs]
        every = [d for group in found for d in group]
        rhat = max(d.rhat for d in every)
        ess = min(min(d.ess_bulk, d.ess_tail) for d in every)
        seconds = time.perf_counter() - begun
        history.append(
            {
                "steps": float(runs[0].samplers[0].iteration), "rhat": rhat, "ess": ess, "seconds": seconds,
            }
        )  # fmt: skip
        done = rhat < request.rhat and ess >= request.ess
        per_step = (seconds - (tuned - begun)) / runs[0].samplers[0].iteration
        left = request.budget_seconds - seconds
        if done or left < per_step * FIRST_STEPS / 2:
            break
        # As many steps again, or what the budget still allows.
        steps = max(FIRST_STEPS // 2, min(runs[0].samplers[0].iteration, int(left / per_step)))
    progress(1.0, "done")
    phases = {
        "mode": prepared - begun, "tuning": tuned - prepared, "sampling": time.perf_counter() - tuned
    }  # fmt: skip
    return _posterior(table, fit, request, runs, found, history, done, kind, data, len(index), phases)


def _posterior(
    table: Table, fit: FitResult, request: PosteriorSpec, runs: list[Ensembles],
    found: list[list[Diagnostic]], history: list[dict[str, float]], done: bool, kind: str, data: Usable,
    used: int, phases: dict[str, float],
) -> Posterior:  # fmt: skip
    rng = np.random.default_rng([request.seed, 1])
    labels: list[str] = []
    columns: list[FloatArray] = []
    for run in runs:
        flat = run.chains().reshape(-1, run.density.size)
        # Groups are independent, so any pairing of their draws is a draw of all.
        picked = flat[rng.choice(len(flat), request.keep, replace=len(flat) < request.keep)]
        columns.append(run.natural(picked))
        labels += run.labels
    diagnostics = {
        label: d
        for run, group in zip(runs, found, strict=True)
        for label, d in zip(run.labels, group, strict=True)
    }
    last = history[-1]
    steps = int(last["steps"])
    reached = f"R-hat {last['rhat']:.4f}, effective sample size {last['ess']:.0f} after {steps} steps"
    if done:
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
    chi2 = fit.metrics.get("chi2_per_dof")
    if kind == "table" and chi2 is not None and chi2 > 2:
        warnings.append(
            f"residuals exceed the stated noise (Birge ratio {np.sqrt(chi2):.1f}): the model is not exact, "
            "and these intervals leave that out"
        )
    walkers = runs[0].samplers[0].nwalkers
    return Posterior(
        spec=request,
        fit_spec=fit.spec,
        template=fit.model,
        labels=tuple(labels),
        draws=np.concatenate(columns, axis=1),
        noise=_noise(kind, data),
        diagnostics=diagnostics,
        acceptance=float(np.mean([s.acceptance_fraction for run in runs for s in run.samplers])),
        status="converged" if done else "not_converged",
        message=message,
        history=tuple(history),
        cost={
            "seconds": sum(phases.values()),
            "phases": phases,
            "evaluations": int(steps * walkers * request.ensembles * len(runs)),
            "walkers": int(walkers), "ensembles": request.ensembles, "steps": steps,
        },
        table={"name": table.metadata.name, "hash": table.hash, "samples": len(data), "used": used},
        warnings=tuple(warnings),
    )  # fmt: skip


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
