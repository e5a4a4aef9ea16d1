"""Effective samples a second of a posterior, against emcee as its tutorial uses it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import emcee
import numpy as np
from numpy.typing import NDArray

import fitter
from fitter.posterior.diagnostics import diagnose
from tests.bench import plain, tables
from tests.bench.measuring import Figure, Row, Size

FloatArray = NDArray[np.float64]
SEED = 4
WALKERS = 32


def run(size: Size) -> Iterator[Row]:
    table = tables.scattered("ward", size.pick(1400, 200), SEED)
    fit = fitter.fit(table, "ward")
    fitter.posterior(table, fit, ess=100, rhat=1.1, seed=99)  # compiles
    default: list[float] = []
    sampling: list[float] = []
    whole: list[float] = []
    stretch = _Stretch.of(table, fit)
    posterior: Any = None
    for turn in range(size.pick(3, 1)):
        began = time.perf_counter()
        fitter.posterior(table, fit, seed=turn)
        default.append(time.perf_counter() - began)
        posterior = fitter.posterior(table, fit, ess=size.pick(10_000, 1000), seed=turn)
        ess = min(d.ess_bulk for d in posterior.diagnostics.values())
        sampling.append(ess / posterior.cost["phases"]["sampling"])
        whole.append(ess / posterior.cost["seconds"])
        stretch.advance(size.pick(7.0, 0.5))
    rate, rhat = stretch.judged()
    facts = {
        "samples": len(table), "channels": 3, "parameters": len(posterior.labels),
        "status": posterior.status, "steps": posterior.cost["steps"], "rhat": posterior.history[-1]["rhat"],
        "stretch_steps": stretch.sampler.iteration, "stretch_seconds": stretch.seconds, "stretch_rhat": rhat,
    }  # fmt: skip
    other = Figure.of("emcee: stretch move, scalar NumPy density", "1/s", [rate])
    what = f"effective samples of the worst parameter, Ward, {len(table):,} RGB samples"
    yield Row(
        case=f"{what}, while sampling",
        ours=Figure.of("fitter.posterior", "1/s", sampling), others=(other,), facts=facts, seed=SEED,
    )  # fmt: skip
    yield Row(
        case="the same, mode and tuning included",
        ours=Figure.of("fitter.posterior", "1/s", whole), others=(other,), facts=facts, seed=SEED,
    )  # fmt: skip
    yield Row(
        case="posterior with default targets: R-hat < 1.01, 1,000 effective samples",
        ours=Figure.of("fitter.posterior", "s", default),
        # At its rate and no later: whether its R-hat would do by then is not asked.
        others=(Figure.of(f"{other.name}, 1,000 / rate", "s", [1000.0 / rate]),),
        facts=facts, seed=SEED,
    )  # fmt: skip


@dataclass
class _Stretch:
    """emcee from the least-squares fit, as its tutorial has it."""

    sampler: emcee.EnsembleSampler
    state: Any
    seconds: float = 0.0

    @staticmethod
    def of(table: fitter.Table, fit: fitter.FitResult) -> _Stretch:
        wi, wo, y, sigma = table.wi, table.wo, table.value, table.sigma
        assert sigma is not None

        def log_density(p: FloatArray) -> float:
            if (p <= 0).any():
                return -np.inf
            f = plain.ward(wi, wo, p[:3], p[3:6], p[6])
            return -0.5 * float(np.sum(np.square((y - f) / sigma)))

        found = [fit.parameters[name] for name in ("kd", "ks", "alpha")]
        centre = np.concatenate([np.atleast_1d(e.value) for e in found])
        spread = np.concatenate([np.atleast_1d(e.standard_uncertainty) for e in found])
        rng = np.random.default_rng([SEED, 2])
        sampler = emcee.EnsembleSampler(WALKERS, len(centre), log_density)
        sampler.random_state = np.random.RandomState(SEED).get_state()
        return _Stretch(sampler, centre + 2 * spread * rng.standard_normal((WALKERS, len(centre))))

    def advance(self, budget: float) -> None:
        began = time.perf_counter()
        while time.perf_counter() - began < budget:
            self.state = self.sampler.run_mcmc(self.state, 50, progress=False)
        self.seconds += time.perf_counter() - began

    def judged(self) -> tuple[float, float]:
        """Effective samples a second and R-hat, as for ours: half discarded, all of the time counted.

        Counted as for ours and by emcee's autocorrelation time, whichever is more: walkers that have not
        mixed in the time they had would otherwise count for too little.
        """
        chains = self.sampler.get_chain()[self.sampler.iteration // 2 :].transpose(1, 0, 2)
        found = diagnose(chains)
        plainly = chains.shape[0] * chains.shape[1] / max(d.autocorrelation_time for d in found)
        return max(plainly, min(d.ess_bulk for d in found)) / self.seconds, max(d.rhat for d in found)
