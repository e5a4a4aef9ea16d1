"""Effective samples a second of a posterior, against emcee as its tutorial uses it, and against NUTS."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import emcee
import numpy as np
from numpy.typing import NDArray

import fitter
from fitter.posterior.diagnostics import diagnose
from tests.bench import nuts, plain_canon, tables
from tests.bench.measuring import Figure, Row, Size

FloatArray = NDArray[np.float64]
SEED = 4
WALKERS = 32


def run(size: Size) -> Iterator[Row]:
    for count in (size.pick(1400, 200), 20_000)[: size.pick(2, 1)]:
        yield from _of(count, size)


def _of(count: int, size: Size) -> Iterator[Row]:
    table = _table(count)
    fit = fitter.fit(table, "ward:anisotropic")
    fitter.posterior(table, fit, ess=100, rhat=1.1, seed=99)  # compiles
    default: list[float] = []
    sampling: list[float] = []
    processor: list[tuple[float, float]] = []
    stretch = _Stretch.of(table, fit)
    posterior: Any = None
    for turn in range(size.pick(3, 1)):
        began, cpu = time.perf_counter(), time.process_time()
        posterior = fitter.posterior(table, fit, seed=turn)
        default.append(time.perf_counter() - began)
        ess = min(min(d.ess_bulk, d.ess_tail) for d in posterior.diagnostics.values())
        # All of the time, the mode and the tuning and what stands beside the posterior included.
        sampling.append(ess / default[-1])
        used = time.process_time() - cpu
        processor.append((used, used / ess))
        stretch.advance(size.pick(10.0, 0.5))
    whole, each = np.median(processor, axis=0)
    facts: dict[str, Any] = {
        "samples": count, "channels": 3, "parameters": len(posterior.labels), "status": posterior.status,
        "steps": posterior.cost["steps"], "evaluations": posterior.cost["evaluations"],
        "rhat": posterior.history[-1]["rhat"], "stretch_steps": stretch.sampler.iteration,
        "stretch_seconds": stretch.seconds,
    }  # fmt: skip
    rate, facts["stretch_rhat"] = stretch.judged()
    plainly = "emcee: stretch move, scalar NumPy density"
    others = [Figure.of(plainly, "1/s", [rate], stretch.cpu / (rate * stretch.seconds))]
    if nuts.installed():
        found = nuts.rate(table, fit, SEED, size.pick(500, 50))
        facts["nuts_rhat"] = found["rhat"]
        name = "blackjax: NUTS, the same density, sampling alone"
        others.append(Figure.of(name, "1/s", [found["rate"]], found["cpu"]))
    else:
        print("NUTS IS ABSENT: blackjax is not installed, and ours is not compared with it", file=sys.stderr)
        facts["nuts"] = "absent: blackjax is not installed"
    yield Row(
        case=f"effective samples of the worst parameter, anisotropic Ward, {count:,} RGB samples",
        ours=Figure.of("fitter.posterior", "1/s", sampling, float(each)), others=tuple(others), facts=facts,
        seed=SEED,
    )  # fmt: skip
    yield Row(
        case=f"posterior of {count:,} samples with default targets: R-hat < 1.01, 1,000 effective samples",
        ours=Figure.of("fitter.posterior", "s", default, float(whole)),
        # At their rate and no later: whether their R-hat would do by then is not asked.
        others=tuple(Figure.of(f"{o.name}, 1,000 / rate", "s", [1000.0 / o.median]) for o in others),
        facts=facts, seed=SEED,
    )  # fmt: skip


def _table(count: int, noise: float = 0.02) -> fitter.Table:
    wi, wo = tables.pairs(count, SEED)
    shape, values = plain_canon.CANON["ward:anisotropic"]
    value = shape(wi, wo, **{name: np.asarray(v) if np.ndim(v) else v for name, v in values.items()})
    sigma = noise * value
    rng = np.random.default_rng([SEED, 1])
    noisy = value + sigma * rng.standard_normal(value.shape)
    return fitter.Table(wi=wi, wo=wo, value=noisy, sigma=sigma)


@dataclass
class _Stretch:
    """emcee from the least-squares fit, as its tutorial has it."""

    sampler: emcee.EnsembleSampler
    state: Any
    seconds: float = 0.0
    cpu: float = 0.0

    @staticmethod
    def of(table: fitter.Table, fit: fitter.FitResult) -> _Stretch:
        wi, wo, y, sigma = table.wi, table.wo, table.value, table.sigma
        assert sigma is not None

        def log_density(p: FloatArray) -> float:
            if (p[:8] <= 0).any():
                return -np.inf
            f = plain_canon.ward_anisotropic(wi, wo, p[:3], p[3:6], p[6], p[7], p[8])
            return -0.5 * float(np.sum(np.square((y - f) / sigma)))

        found = [fit.parameters[name] for name in ("kd", "ks", "alpha_x", "alpha_y", "psi")]
        centre = np.concatenate([np.atleast_1d(e.value) for e in found])
        spread = np.concatenate([np.atleast_1d(e.standard_uncertainty) for e in found])
        rng = np.random.default_rng([SEED, 2])
        sampler = emcee.EnsembleSampler(WALKERS, len(centre), log_density)
        sampler.random_state = np.random.RandomState(SEED).get_state()
        return _Stretch(sampler, centre + 2 * spread * rng.standard_normal((WALKERS, len(centre))))

    def advance(self, budget: float) -> None:
        began, cpu = time.perf_counter(), time.process_time()
        while time.perf_counter() - began < budget:
            self.state = self.sampler.run_mcmc(self.state, 50, progress=False)
        self.seconds += time.perf_counter() - began
        self.cpu += time.process_time() - cpu

    def judged(self) -> tuple[float, float]:
        """Effective samples a second and R-hat, as for ours: half discarded, all of the time counted.

        Counted as for ours and by emcee's autocorrelation time, whichever is more: walkers that have not
        mixed in the time they had would otherwise count for too little.
        """
        chains = self.sampler.get_chain()[self.sampler.iteration // 2 :].transpose(1, 0, 2)
        found = diagnose(chains)
        plainly = chains.shape[0] * chains.shape[1] / max(d.autocorrelation_time for d in found)
        return max(plainly, min(d.ess_bulk for d in found)) / self.seconds, max(d.rhat for d in found)
