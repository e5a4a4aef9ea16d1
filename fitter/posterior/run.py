"""posterior: independent ensembles run until they agree, or until the budget ends, and which it was."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import emcee
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from fitter import models, progress, spec
from fitter.compression import CompressedTable
from fitter.errors import FitError, SpecError
from fitter.fitting.layout import Layout, layout, per_channel
from fitter.fitting.result import FitResult
from fitter.fitting.samples import Usable, usable
from fitter.posterior.density import Density
from fitter.posterior.diagnostics import diagnose
from fitter.posterior.moves import mixture
from fitter.posterior.result import Diagnostic, Posterior
from fitter.spec import PosteriorSpec
from fitter.table import Table

FloatArray = NDArray[np.float64]
FIRST_STEPS = 100
#: Steps of the rounds after which the proposals are fitted to the walkers; all of them are discarded.
TUNING = (100, 100, 200)
#: Upper bound of the inferred relative noise: beyond it "relative" has lost its meaning.
LARGEST_NOISE = 3.0


@dataclass
class _Run:
    """One group of channels: its density, its labels, and the ensembles as they grow."""

    density: Density
    labels: list[str]
    logs: NDArray[np.bool_]
    starts: list[FloatArray]
    seeds: np.random.SeedSequence
    samplers: list[emcee.EnsembleSampler]

    def ensembles(self, mean: FloatArray, covariance: FloatArray) -> None:
        """New samplers with proposals of this mean and covariance, each with its own random state."""
        self.samplers = []
        for seed in self.seeds.spawn(len(self.starts)):
            sampler = emcee.EnsembleSampler(
                len(self.starts[0]), self.density.size, self.density, vectorize=True,
                moves=mixture(mean, covariance),
            )  # fmt: skip
            state = np.random.RandomState(seed.generate_state(8))  # noqa: NPY002 (emcee's generator)
            sampler.random_state = state.get_state()
            self.samplers.append(sampler)

    def advance(self, steps: int) -> None:
        """Every ensemble by ``steps``; the compiled density releases the GIL, so threads help."""

        def one(k: int) -> FloatArray:
            return self.samplers[k].run_mcmc(self.starts[k], steps, progress=False).coords

        with ThreadPoolExecutor(len(self.samplers)) as pool:
            self.starts = list(pool.map(one, range(len(self.samplers))))

    def tune(self, steps: int) -> None:
        """Run, then fit the proposals to where the walkers are: a posterior is seldom its own Laplace."""
        self.advance(steps)
        seen = np.concatenate([s.get_chain(discard=steps // 2, flat=True) for s in self.samplers])
        covariance = np.cov(seen.T).reshape(self.density.size, -1)
        covariance += np.diag(1e-12 * np.diagonal(covariance) + 1e-300)
        self.ensembles(seen.mean(axis=0), covariance)

    def chains(self) -> FloatArray:
        """(walkers of all ensembles, steps, P) in the model's coordinates, the first half discarded."""
        kept = [s.get_chain()[s.iteration // 2 :].transpose(1, 0, 2) for s in self.samplers]
        return self.density.folded(np.concatenate(kept))


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
    request = spec or _request(settings)
    if isinstance(table, CompressedTable):
        table = table.decompress()
    kind = request.noise or ("table" if table.sigma is not None else "inferred")
    if kind == "table" and table.sigma is None:
        raise SpecError(
            "noise 'table' needs the table's own standard uncertainty, and it states none",
            code="noise-needs-sigma", parameter="noise", remedy="use noise='inferred'",
        )  # fmt: skip
    places = layout(fit.spec)
    data = usable(table, "absolute", fit.spec.select)
    rng = np.random.default_rng(request.seed)
    index = np.arange(len(data))
    if len(index) > request.max_samples:
        index = np.sort(rng.choice(len(data), request.max_samples, replace=False))
    channels = range(len(data.channels))
    groups = [[c] for c in channels] if per_channel(fit.spec.model) else [list(channels)]
    progress(0.0, "finding the mode")
    runs = [_start(places, fit, data, index, group, kind, request, rng) for group in groups]
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
    return _posterior(table, fit, request, runs, found, history, done, kind, data, index, begun, prepared, tuned)


def _request(settings: dict[str, Any]) -> PosteriorSpec:
    return spec.posterior_spec(settings)


def _start(
    places: Layout, fit: FitResult, data: Usable, index: NDArray[np.intp], group: Sequence[int], kind: str,
    request: PosteriorSpec, rng: np.random.Generator,
) -> _Run:  # fmt: skip
    table = {p.name: p for p in models.parameter_table(places.spec)}
    linear = [p for p in table.values() if p.linear]
    names = fit.model.channels
    value = data.value[index][:, group]
    sigma = data.sigma[index][:, group] if kind == "table" and data.sigma is not None else None
    c = len(group)
    x: list[float] = []
    labels: list[str] = []
    low: list[float] = []
    high: list[float] = []
    for p in linear:
        x += [float(fit.parameters[p.name].value[k]) for k in group]
        labels += [f"{p.name}[{names[k]}]" for k in group]
        low += [p.lower] * c
        high += [p.upper] * c
    for k, name in enumerate(places.free):
        own = np.atleast_1d(fit.parameters[name].value)
        number = float(own[group[0]] if len(own) > 1 else own[0])
        x.append(float(np.log(number)) if places.logs[k] else number)
        labels.append(name if np.ndim(fit.parameters[name].value) == 0 else f"{name}[{names[group[0]]}]")
        low.append(places.lower[k])
        high.append(places.upper[k])
    if sigma is None:
        misfit = float(np.clip(fit.metrics["relative_rmse"], 1e-3, 0.3))
        for what, guess in (("relative_noise", misfit * np.ones(c)), ("noise_floor", data.floor[list(group)])):
            x += list(guess)
            labels += [f"{what}[{names[k]}]" for k in group]
            low += [0.0] * c
            high += [np.inf if what == "noise_floor" else LARGEST_NOISE] * c
    if value.size < len(x):
        raise FitError(
            f"{value.size} usable values can't determine {len(x)} parameters", code="too-few-samples",
            remedy="measure more geometries, fix parameters, or use a simpler model",
        )  # fmt: skip
    logs = np.zeros(len(x), bool)
    logs[len(linear) * c : len(linear) * c + len(places.free)] = places.logs
    density = Density(
        places, np.ascontiguousarray(data.pair[:, index]), np.ascontiguousarray(value.T),
        None if sigma is None else np.ascontiguousarray(sigma.T), np.array(low), np.array(high),
    )  # fmt: skip
    mode, covariance = density.mode(np.array(x))
    if not np.isfinite(density(mode[None])).all():
        raise FitError(
            "the likelihood is not finite at its mode", code="likelihood-not-finite",
            cause="standard uncertainties that are far too small, or values near the limits of floating point",
            remedy="check sigma and the units of the values",
        )  # fmt: skip
    walkers = request.walkers or max(32, 2 * (len(x) + 1))
    # At about twice the Laplace spread: closer starts hide what the ensemble has not found.
    spread = 2.0 * np.linalg.cholesky(covariance)
    starts = [
        mode + rng.standard_normal((walkers, len(x))) @ spread.T for _ in range(request.ensembles)
    ]
    seeds = np.random.SeedSequence(int(rng.integers(2**63)))
    run = _Run(density, labels, logs, starts, seeds, [])
    run.ensembles(mode, covariance)
    return run


def _posterior(
    table: Table, fit: FitResult, request: PosteriorSpec, runs: list[_Run], found: list[list[Diagnostic]],
    history: list[dict[str, float]], done: bool, kind: str, data: Usable, index: NDArray[np.intp],
    begun: float, prepared: float, tuned: float,
) -> Posterior:  # fmt: skip
    rng = np.random.default_rng([request.seed, 1])
    labels: list[str] = []
    columns: list[FloatArray] = []
    for run in runs:
        flat = run.chains().reshape(-1, run.density.size)
        # Groups are independent, so any pairing of their draws is a draw of all.
        picked = flat[rng.choice(len(flat), request.keep, replace=len(flat) < request.keep)]
        columns.append(np.where(run.logs, np.exp(np.where(run.logs, picked, 0.0)), picked))
        labels += run.labels
    diagnostics = {
        label: d for run, group in zip(runs, found, strict=True) for label, d in zip(run.labels, group, strict=True)
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
    if len(index) < len(data):
        warnings.append(f"conditioned on {len(index)} of {len(data)} samples: intervals are wider than the table allows")
    if kind == "inferred":
        warnings.append(
            "misfit counts as independent noise here: on real tables it is correlated, and these intervals are "
            "too narrow by a factor of several; compare the fit's own standard uncertainties"
        )
    chi2 = fit.metrics.get("chi2_per_dof")
    if kind == "table" and chi2 is not None and chi2 > 2:
        warnings.append(
            f"residuals exceed the stated noise (Birge ratio {np.sqrt(chi2):.1f}): the model is not exact, and "
            "these intervals leave that out"
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
            "seconds": time.perf_counter() - begun,
            "phases": {"mode": prepared - begun, "tuning": tuned - prepared, "sampling": time.perf_counter() - tuned},
            "evaluations": int(steps * walkers * request.ensembles * len(runs)),
            "walkers": int(walkers), "ensembles": request.ensembles, "steps": steps,
        },
        table={"name": table.metadata.name, "hash": table.hash, "samples": len(data), "used": len(index)},
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
    return {"kind": kind, "relative_noise": float(np.sqrt(solved[0])), "noise_floor": float(np.sqrt(solved[1]))}
