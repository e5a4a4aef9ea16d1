"""calibrate: simulation-based calibration of a model's posterior on the directions of a table.

Truths are drawn from the prior, data are simulated on the table's directions with the noise that the
posterior's likelihood takes for granted, and a posterior is sampled from each (S. Talts et al., 2018). Where
the sampler, the likelihood and the prior agree, a truth's rank among draws is uniform. The rank of the
truth's log-likelihood is looked at, too: it sees what single parameters don't (M. Modrak et al.,
"Simulation-based calibration checking for Bayesian computation", 2023).
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitter import progress
from fitter._version import __version__
from fitter.calibration.result import LIKELIHOOD, Calibration
from fitter.calibration.truths import Truths, truths
from fitter.compression import CompressedTable
from fitter.errors import FitterError, SpecError
from fitter.fitting import fit as fitted
from fitter.fitting.result import FitResult
from fitter.fitting.samples import Usable
from fitter.fitting.usable import usable
from fitter.models import ReflectanceModel
from fitter.posterior.result import Posterior
from fitter.posterior.run import noise_of, sample
from fitter.progress import Cancelled
from fitter.spec import CalibrationSpec, FitSpec, Select, calibration_spec
from fitter.table import Table

FloatArray = NDArray[np.float64]
#: Largest effective sample size that a posterior is asked for to have enough draws in the ranges.
MOST_EFFECTIVE = 20_000
SHORT = "too few independent draws in the ranges"


def calibrate(
    table: Table | CompressedTable,
    fit: FitResult,
    spec: CalibrationSpec | None = None,
    *,
    progress: progress.Progress = progress.ignore,
    **settings: Any,
) -> Calibration:
    """Simulate, fit and sample over and over: do posteriors of this model on these directions tell the truth?

    Parameters
    ----------
    table, fit : directions, sigma and channels are the table's; the fit says which model, with what fixed and
        bounded, and where the truths lie unless ``around`` is None. Of many samples
        ``posterior.max_samples`` are used.
    spec, settings : a CalibrationSpec, or its fields as keywords.
    progress : called with (share, text); may raise to stop.

    Raises
    ------
    SpecError : settings that make no sense, noise "table" without sigma, ranges outside the prior.
    """
    begun = time.perf_counter()
    if spec is not None and settings:
        raise SpecError("give a CalibrationSpec or its fields, not both", code="bad-spec", parameter="spec")
    request = spec or calibration_spec(settings)
    whole = table.decompress() if isinstance(table, CompressedTable) else table
    kind = noise_of(whole, request.noise)
    fit.columns_of(whole)
    data = usable(whole, "absolute", fit.spec.select, anisotropic=not fit.model.isotropic(fit.spec.model))
    from_ = truths(
        fit, data, inferred=kind == "inferred", around=request.around, ranges=request.ranges,
        used=min(len(data), request.posterior.max_samples),
    )  # fmt: skip
    simulator = _Simulator.of(fit, data, from_, request, kind)
    reached = 0.0

    def forward(share: float, what: str) -> None:
        nonlocal reached
        reached = max(reached, share)  # a posterior that still samples can't know how long it will
        progress(reached, what)

    ranks: list[dict[str, int] | None] = []
    covered: list[dict[str, bool] | None] = []
    failures: dict[str, int] = {}
    for k in range(request.simulations):
        left = math.inf if request.time_limit_seconds is None else request.time_limit_seconds
        if ranks and time.perf_counter() - begun + (time.perf_counter() - begun) / len(ranks) > left:
            break
        try:
            found = simulator.one(k, forward)
        except Cancelled:
            raise
        except FitterError as error:
            found = error.code
        if isinstance(found, str):
            failures[found] = failures.get(found, 0) + 1
        ranks.append(None if isinstance(found, str) else found[0])
        covered.append(None if isinstance(found, str) else found[1])
    progress(1.0, "done")
    return Calibration(
        spec=request, fit_spec=simulator.spec, noise=kind, labels=(*from_.labels, LIKELIHOOD),
        ranks=tuple(ranks), covered=tuple(covered), failures=failures,
        ranges={
            label: (float(a), float(b)) for label, a, b in
            zip(from_.labels, from_.natural(from_.low), from_.natural(from_.high), strict=True)
        },
        table={
            "name": whole.metadata.name, "hash": whole.hash, "samples": len(data),
            "used": simulator.pair.shape[1],
        },
        seconds=time.perf_counter() - begun, version=__version__,
    )  # fmt: skip


@dataclass(frozen=True)
class _Simulator:
    """pair : (6, n) directions. sigma : (n, C), or None where the noise is inferred."""

    spec: FitSpec
    truths: Truths
    request: CalibrationSpec
    pair: FloatArray
    sigma: FloatArray | None
    table: Table

    @staticmethod
    def of(fit: FitResult, data: Usable, from_: Truths, request: CalibrationSpec, kind: str) -> _Simulator:
        index = np.arange(len(data))
        if len(index) > request.posterior.max_samples:
            rng = np.random.default_rng(request.seed)
            index = np.sort(rng.choice(len(data), request.posterior.max_samples, replace=False))
        stated = kind == "table" and data.sigma is not None
        # The table holds what was selected, with every sample of its own.
        metric = fit.spec.metric if stated or fit.spec.metric != "measurement" else None
        spec = fit.spec.model_copy(
            update={
                "select": Select(), "metric": metric, "weighting": "samples", "budget_seconds": None,
                "target_error": None,
            }
        )  # fmt: skip
        sigma = data.sigma[index] if stated and data.sigma is not None else None
        return _Simulator(spec, from_, request, data.pair[:, index], sigma, data.table)

    def one(self, k: int, progress: progress.Progress) -> tuple[dict[str, int], dict[str, bool]] | str:
        """Ranks and coverage of simulation k, or why there are none."""
        every = self.request.simulations

        def step(share: float, what: str) -> None:
            progress((k + share) / every, f"simulation {k + 1} of {every}: {what}")

        rng = np.random.default_rng([self.request.seed, k])
        truth = self.truths.draw(rng)
        model = self.truths.model_of(truth)
        f = np.asarray(_values(model, self.pair))
        sigma = self.sigma
        if sigma is None:
            relative, floor = self.truths.noise_of(truth)
            sigma = np.hypot(relative * f, floor)
        value = f + sigma * rng.standard_normal(f.shape)
        table = Table(
            wi=self.pair[:3].T, wo=self.pair[3:].T, value=value, sigma=self.sigma,
            channels=model.channels, symmetry=self.table.symmetry if model.isotropic(model.spec)
            else "anisotropic", negatives="keep", duplicates="keep",
        )  # fmt: skip

        def sampling(share: float, what: str) -> None:
            step(0.3 + 0.7 * share, what)

        fit = fitted(table, self.spec, progress=lambda share, what: step(0.3 * share, what))
        asked = self.request.posterior.model_copy(update={
            "seed": int(rng.integers(2**63)), "noise": "inferred" if self.sigma is None else "table",
        })  # fmt: skip
        posterior = sample(table, fit, asked, progress=sampling, robust=False, within=self.truths.within)
        # Draws that fill a range, or lie at its end, are draws: only walkers that don't agree are none.
        if posterior.status == "not_converged":
            return posterior.status
        y, effective = self._inside(posterior)
        if effective < self.request.draws:
            share = max(len(y), 1) / len(posterior.draws)
            more = math.ceil(1.2 * self.request.draws / share)
            if more > MOST_EFFECTIVE:
                return SHORT
            kept = max(asked.keep, math.ceil(2.0 * self.request.draws / share))
            asked = asked.model_copy(update={"ess": more, "keep": kept})
            posterior = sample(table, fit, asked, progress=sampling, robust=False, within=self.truths.within)
            y, effective = self._inside(posterior)
            if posterior.status == "not_converged" or effective < self.request.draws:
                return SHORT
        chosen = y[rng.choice(len(y), self.request.draws, replace=False)]
        ranks = {
            label: int((chosen[:, j] < truth[j]).sum()) for j, label in enumerate(self.truths.labels)
        }  # fmt: skip
        likelihood = self._log_likelihood(np.concatenate([truth[None], chosen]), value)
        ranks[LIKELIHOOD] = int((likelihood[1:] < likelihood[0]).sum())
        tail = 0.5 * (1.0 - self.request.level)
        low, high = np.quantile(y, [tail, 1.0 - tail], axis=0)
        covered = {
            label: bool(low[j] <= truth[j] <= high[j]) for j, label in enumerate(self.truths.labels)
        }  # fmt: skip
        return ranks, covered

    def _inside(self, posterior: Posterior) -> tuple[FloatArray, float]:
        """The draws (S, P) within the ranges, and how many independent ones they are worth."""
        y = self.truths.named(self.truths.search(posterior.draws, posterior.labels))
        kept = y[self.truths.inside(y)]
        worth = min(min(d.ess_bulk, d.ess_tail) for d in posterior.diagnostics.values())
        return kept, min(float(len(kept)), worth * len(kept) / len(y))

    def _log_likelihood(self, y: FloatArray, value: FloatArray) -> FloatArray:
        """(S,) log-likelihood of vectors (S, P), up to a constant."""
        models = [self.truths.model_of(row) for row in y]
        stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *models)
        f = np.asarray(_each(stacked, self.pair))
        if self.sigma is not None:
            return -0.5 * np.square((value - f) / self.sigma).sum(axis=(1, 2))
        relative, floor = self.truths.noise_of(y)
        variance = np.square(relative[:, None] * f) + np.square(floor[:, None])
        return -0.5 * (np.square(value - f) / variance + np.log(variance)).sum(axis=(1, 2))


@eqx.filter_jit
def _values(model: ReflectanceModel, pair: FloatArray) -> jax.Array:
    return model.evaluate(pair[:3].T, pair[3:].T)


@eqx.filter_jit
def _each(models: ReflectanceModel, pair: FloatArray) -> jax.Array:
    return jax.lax.map(lambda one: one.evaluate(pair[:3].T, pair[3:].T), models)
