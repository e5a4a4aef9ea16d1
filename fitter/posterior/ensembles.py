"""Ensembles of one group of channels: where they start, how their proposals are tuned, how they run."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import emcee
import numpy as np
from numpy.typing import NDArray

from fitter.errors import FitError
from fitter.fitting.layout import Layout
from fitter.fitting.metrics import LOG_FLOOR
from fitter.fitting.result import FitResult
from fitter.fitting.samples import Usable
from fitter.posterior.density import Density
from fitter.posterior.moves import mixture
from fitter.spec import PosteriorSpec

FloatArray = NDArray[np.float64]
#: Upper bound of the inferred relative noise: beyond it "relative" has lost its meaning.
LARGEST_NOISE = 3.0
#: Upper bound of linear parameters without one, in units of pi times the largest value. A lobe that hides
#: between the samples can have any strength: without a bound its posterior is not proper.
LARGEST_SCALE = 100.0


@dataclass
class Ensembles:
    """The density and labels of a group, and its independent emcee ensembles as they grow."""

    density: Density
    labels: list[str]
    logs: NDArray[np.bool_]
    units: FloatArray
    starts: list[FloatArray]
    seeds: np.random.SeedSequence
    samplers: list[emcee.EnsembleSampler]

    def renew(self, mean: FloatArray, covariance: FloatArray) -> None:
        """New samplers with proposals of this mean and covariance, each with its own random state."""
        self.samplers = []
        for seed in self.seeds.spawn(len(self.starts)):
            sampler = emcee.EnsembleSampler(
                len(self.starts[0]), self.density.size, self.density, vectorize=True,
                moves=mixture(mean, covariance),
            )  # fmt: skip
            state = np.random.RandomState(seed.generate_state(8))
            sampler.random_state = state.get_state()
            self.samplers.append(sampler)

    def advance(self, steps: int) -> None:
        """Every ensemble by ``steps``; the compiled density releases the GIL, so threads help."""

        def one(k: int) -> FloatArray:
            state = self.samplers[k].run_mcmc(self.starts[k], steps, progress=False)
            assert state is not None
            return np.asarray(state.coords)

        with ThreadPoolExecutor(len(self.samplers)) as pool:
            self.starts = list(pool.map(one, range(len(self.samplers))))

    def tune(self, steps: int) -> None:
        """Run, then fit the proposals to where the walkers are: a posterior is seldom its own Laplace."""
        self.advance(steps)
        seen = np.concatenate([_chain(s)[steps // 2 :].reshape(-1, self.density.size) for s in self.samplers])
        covariance = np.cov(seen.T).reshape(self.density.size, -1)
        covariance += np.diag(1e-12 * np.diagonal(covariance) + 1e-300)
        self.renew(seen.mean(axis=0), covariance)

    def natural(self, y: FloatArray) -> FloatArray:
        """The parameters in their own units from the model's coordinates, both (..., P)."""
        return np.where(self.logs, np.exp(np.where(self.logs, y, 0.0)), y * self.units)

    def chains(self) -> FloatArray:
        """(walkers of all ensembles, steps, P) in the model's coordinates, the first half discarded."""
        kept = [_chain(s)[s.iteration // 2 :].transpose(1, 0, 2) for s in self.samplers]
        return self.density.folded(np.concatenate(kept))


def start(
    places: Layout, fit: FitResult, data: Usable, index: NDArray[np.intp], group: Sequence[int],
    kind: str, request: PosteriorSpec, rng: np.random.Generator,
) -> Ensembles:  # fmt: skip
    """Ensembles for the channels ``group`` of the samples ``index``, around the mode near the fit.

    Raises FitError where there are fewer values than parameters or the likelihood is not finite.
    """
    linear = places.linear
    names = fit.model.channels
    # In units of a typical value: squares of values near 1e-100 would not be numbers any more. Only where
    # the coefficients are free does a common factor of the values pass to the parameters.
    unit = float(data.floor[list(group)].max()) / LOG_FLOOR if places.coefficients_are_free else 1.0
    value = data.value[index][:, group] / unit
    sigma = data.sigma[index][:, group] / unit if kind == "table" and data.sigma is not None else None
    c = len(group)
    x: list[float] = []
    labels: list[str] = []
    low: list[float] = []
    high: list[float] = []
    units: list[float] = []
    for p in linear:
        own_unit = unit if np.isinf(p.upper) else 1.0
        units += [own_unit] * c
        x += [float(fit.parameters[p.name].value[k]) / own_unit for k in group]
        labels += [f"{p.name}[{names[k]}]" for k in group]
        low += [p.lower] * c
        high += [min(p.upper, LARGEST_SCALE * np.pi * float(np.abs(value).max()))] * c
    lower, upper = places.box
    x += list(places.search_vector({name: e.value for name, e in fit.parameters.items()}, group))
    for entry, (k, c_own) in enumerate(places.entries):
        estimate, channel = fit.parameters[places.free[k]].value, group[c_own or 0]
        labels.append(places.free[k] + (f"[{names[channel]}]" if np.ndim(estimate) else ""))
        low.append(lower[entry])
        high.append(upper[entry])
        units.append(1.0)
    if sigma is None:
        misfit = float(np.clip(fit.metrics["relative_rmse"], 1e-3, 0.3))
        guesses = (("relative_noise", misfit * np.ones(c)), ("noise_floor", data.floor[list(group)] / unit))
        for what, guess in guesses:
            x += list(guess)
            units += [unit if what == "noise_floor" else 1.0] * c
            labels += [f"{what}[{names[k]}]" for k in group]
            low += [0.0] * c
            high += [np.inf if what == "noise_floor" else LARGEST_NOISE] * c
    if value.size < len(x):
        raise FitError(
            f"{value.size} usable values can't determine {len(x)} parameters", code="too-few-samples",
            remedy="measure more geometries, fix parameters, or use a simpler model",
        )  # fmt: skip
    logs = np.zeros(len(x), bool)
    logs[len(linear) * c :][: len(places.entries)] = [places.logs[k] for k, _ in places.entries]
    density = Density(
        places, np.ascontiguousarray(data.pair[:, index]), np.ascontiguousarray(value.T),
        None if sigma is None else np.ascontiguousarray(sigma.T), np.array(low), np.array(high),
    )  # fmt: skip
    try:
        mode, covariance = density.mode(np.clip(np.array(x), density.lower, density.upper))
    except np.linalg.LinAlgError as error:
        raise FitError(
            "the likelihood has no usable curvature at its mode", code="likelihood-not-finite",
            cause="values near the limits of floating point", remedy="rescale the table's values",
        ) from error  # fmt: skip
    if not np.isfinite(density(mode[None])).all():
        raise FitError(
            "the likelihood is not finite at its mode", code="likelihood-not-finite",
            cause="standard uncertainties far too small, or values near the limits of floating point",
            remedy="check sigma and the units of the values",
        )  # fmt: skip
    density = replace(density, centre=mode)
    walkers = request.walkers or max(32, 2 * (len(x) + 1))
    # At about twice the Laplace spread: closer starts hide what the ensemble has not found.
    spread = 2.0 * np.linalg.cholesky(covariance)
    starts = [mode + rng.standard_normal((walkers, len(x))) @ spread.T for _ in range(request.ensembles)]
    starts = [np.where(density.within(w)[:, None], w, density.folded(w)) for w in starts]
    seeds = np.random.SeedSequence(int(rng.integers(2**63)))
    run = Ensembles(density, labels, logs, np.array(units), starts, seeds, [])
    run.renew(mode, covariance)
    return run


def _chain(sampler: emcee.EnsembleSampler) -> FloatArray:
    """(steps, walkers, P) since the sampler was made."""
    return np.asarray(sampler.get_chain(), np.float64)
