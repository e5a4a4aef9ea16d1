"""Ensembles of one group of channels: where they start, how their proposals are tuned, how they run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import emcee
import numpy as np
from emcee.state import State
from numpy.typing import NDArray

from fitter.errors import FitError
from fitter.fitting.layout import Layout
from fitter.fitting.metrics import LOG_FLOOR
from fitter.fitting.result import FitResult
from fitter.fitting.samples import Usable
from fitter.posterior.blobs import Blobs, blobs
from fitter.posterior.density import LARGEST_NOISE, Data, Density, Noise
from fitter.posterior.free import Free
from fitter.posterior.moves import TWIN_SHARE, Independence, TwinMove, free_mixture, mixture
from fitter.posterior.offsets import ANGLES, FARTHEST, tangents
from fitter.spec import PosteriorSpec

FloatArray = NDArray[np.float64]
NOWHERE: Mapping[str, tuple[float, float]] = MappingProxyType({})
#: Upper bound of linear parameters without one, in units of pi times the largest value. A lobe that hides
#: between the samples can have any strength: without a bound its posterior is not proper.
LARGEST_SCALE = 100.0
#: A relative misfit below this is rounding: a likelihood with inferred noise would have no largest value.
ROUNDING = 1e-9
#: Walkers of an ensemble, at least. R-hat over all walkers asks each of them for a hundred independent draws,
#: so that more walkers cost more; differential evolution needs twice the dimension to see all directions.
FEWEST_WALKERS = 12
#: Steps of the rounds after which the proposals are fitted to the walkers; all of them are discarded. They
#: end with the first round whose second half accepts this share of the independence proposals.
TUNING, ACCEPTED = (50, 50, 100, 200), 0.6
#: Where even the last one accepts less than this, a normal won't do: rounds of blobs in free coordinates
#: (:mod:`fitter.posterior.free`) follow, until they are accepted.
HARD, FREE_TUNING, FREE_ACCEPTED = 0.5, (100, 100, 200, 200, 400, 400, 800), 0.4
#: Points that blobs are fitted to, and values that all walkers go through in one of their rounds, at most.
BLOB_POINTS, FREE_VALUES = 4000, 400_000_000


class Segment(NamedTuple):
    """Consecutive steps: chain (steps, E W, P), and the walkers and the random state at their end."""

    chain: FloatArray
    log_density: FloatArray
    accepted: float
    random: tuple[NDArray[np.uint32], int, int, float]


class Proposal(NamedTuple):
    """Normal that independence proposals come from: mean (P,), covariance (P, P); and the walkers (E W, P)
    that start with it. Where a normal won't do, the blobs in its place, in free coordinates."""

    mean: FloatArray
    covariance: FloatArray
    walkers: FloatArray
    blobs: Blobs | None = None


@dataclass
class Ensembles:
    """The density and labels of a group, and its independent ensembles as they grow, segment by segment.

    count : of ensembles; their walkers lie behind each other in one emcee sampler. weight : (C, n) of the
    values in free coordinates.
    """

    density: Density
    labels: list[str]
    logs: NDArray[np.bool_]
    units: FloatArray
    count: int
    seed: np.random.SeedSequence
    proposal: Proposal
    weight: FloatArray
    segments: list[Segment] = field(default_factory=list[Segment])
    tuning: int = 0

    @property
    def steps(self) -> int:
        """Steps since the tuning."""
        return sum(len(segment.chain) for segment in self.segments)

    @cached_property
    def free(self) -> Free:
        return Free(self.density, self.weight)

    @property
    def acceptance(self) -> float:
        return sum(s.accepted * len(s.chain) for s in self.segments) / self.steps

    def tune(self) -> None:
        """Run, then fit the proposals to where the walkers are, until they are accepted: a posterior is
        seldom its own Laplace approximation."""
        log_density, accepted, seen = None, 0.0, self.proposal.walkers
        for steps in TUNING:
            seen, log_density, accepted = self._round(steps, log_density)
            covariance = np.cov(seen.T).reshape(self.density.size, -1)
            covariance += np.diag(1e-12 * np.diagonal(covariance) + 1e-300)
            self.proposal = self.proposal._replace(mean=seen.mean(axis=0), covariance=covariance)
            if accepted >= ACCEPTED:
                break
        if accepted >= HARD:
            return
        rng, found = np.random.default_rng(self.seed.spawn(1)[0]), [seen]
        self._fit_blobs(found, rng)
        for steps in FREE_TUNING:
            if steps * self.weight.size * len(self.proposal.walkers) > FREE_VALUES:
                break
            seen, log_density, accepted = self._round(steps, log_density)
            found.append(seen)
            self._fit_blobs(found, rng)
            if accepted >= FREE_ACCEPTED:
                break

    def _fit_blobs(self, found: list[FloatArray], rng: np.random.Generator) -> None:
        """To the later half of what was seen: walkers and blobs find a posterior together."""
        every = np.concatenate(found)
        walker = np.arange(len(every)) % len(self.proposal.walkers)
        late = np.arange(len(every) // 2, len(every))
        chosen = rng.permutation(late)[:BLOB_POINTS]
        points = self.free.into(every[chosen])[0]
        self.proposal = self.proposal._replace(blobs=blobs(points, walker[chosen] % 2 == 0, rng))

    def _round(self, steps: int, log_density: FloatArray | None) -> tuple[FloatArray, FloatArray, float]:
        """Where the walkers were in the second half of these steps (N, P), their log-density at the end, and
        the share of the independence proposals that the half accepted."""
        sampler, independence = self._sampler()
        random = np.random.RandomState(self.seed.spawn(1)[0].generate_state(8))
        sampler.random_state = random.get_state()
        state = State(self.proposal.walkers, log_prob=log_density)
        state = sampler.run_mcmc(state, steps // 2, skip_initial_state_check=True)
        independence.tried = independence.accepted = 0
        assert state is not None
        state = sampler.run_mcmc(State(state), steps - steps // 2, skip_initial_state_check=True)
        assert state is not None
        self.proposal = self.proposal._replace(walkers=np.asarray(state.coords))
        self.tuning += steps
        seen = _chain(sampler)[steps // 2 :].reshape(-1, self.density.size)
        return seen, np.asarray(state.log_prob), independence.accepted / max(independence.tried, 1)

    def advance(self, steps: int) -> Segment:
        """A segment more, the same whether those before it were run or read."""
        sampler, _ = self._sampler()
        if self.segments:
            last = self.segments[-1]
            state = State(last.chain[-1].copy(), log_prob=last.log_density.copy())
            sampler.random_state = ("MT19937", *last.random)
        else:
            state = State(self.proposal.walkers.copy())
            random = np.random.RandomState(self.seed.generate_state(8))
            sampler.random_state = random.get_state()
        state = sampler.run_mcmc(state, steps, skip_initial_state_check=True)
        assert state is not None
        _, keys, position, has_normal, normal = sampler.random_state
        segment = Segment(
            _chain(sampler), np.asarray(state.log_prob), float(np.mean(sampler.acceptance_fraction)),
            (np.asarray(keys, np.uint32), int(position), int(has_normal), float(normal)),
        )  # fmt: skip
        self.segments.append(segment)
        return segment

    def _sampler(self) -> tuple[emcee.EnsembleSampler, Independence]:
        mean, covariance, _, found = self.proposal
        if found is None:
            moves = mixture(mean, covariance, self.count, self.density.lower, self.density.upper)
        else:
            moves = free_mixture(found, self.count, self.free)
        twins = [(TwinMove(twin), TWIN_SHARE) for twin in self.density.twins]
        sampler = emcee.EnsembleSampler(
            len(self.proposal.walkers), self.density.size, self.density, vectorize=True,
            moves=[*moves, *twins],
        )  # fmt: skip
        first = moves[0][0]
        assert isinstance(first, Independence)
        return sampler, first

    def natural(self, y: FloatArray) -> FloatArray:
        """The parameters in their own units from the model's coordinates, both (..., P)."""
        return np.where(self.logs, np.exp(np.where(self.logs, y, 0.0)), y * self.units)

    def chains(self, discarded: int, steps: int) -> FloatArray:
        """(walkers of all ensembles, steps - discarded, P) in the model's coordinates."""
        whole = np.concatenate([segment.chain for segment in self.segments])
        return whole[discarded:steps].transpose(1, 0, 2)


def start(
    places: Layout, fit: FitResult, data: Usable, index: NDArray[np.intp], group: Sequence[int],
    kind: str, request: PosteriorSpec, angles: FloatArray, rng: np.random.Generator,
    within: Mapping[str, tuple[float, float]] = NOWHERE,
) -> Ensembles:  # fmt: skip
    """Ensembles for the channels ``group`` of the samples ``index``, around the mode near the fit.

    angles : (2 or 3,) standard uncertainties in radians of the instrument's angles; none, no offsets.
    within : narrower ranges of parameters by label, in their own units.

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
    scale = sigma
    if sigma is None:
        if fit.metrics["relative_rmse"] < ROUNDING:
            raise FitError(
                "the residuals are rounding: there is no noise to infer", code="no-noise",
                cause="a table of computed values, or of a single one", parameter="noise",
                remedy="give the table's standard uncertainties",
            )  # fmt: skip
        misfit = float(np.clip(fit.metrics["relative_rmse"], 1e-3, 0.3))
        guesses = (("relative_noise", misfit * np.ones(c)), ("noise_floor", data.floor[list(group)] / unit))
        scale = np.hypot(misfit * value, guesses[1][1])
        for what, guess in guesses:
            x += list(guess)
            units += [unit if what == "noise_floor" else 1.0] * c
            labels += [f"{what}[{names[k]}]" for k in group]
            low += [0.0] * c
            high += [np.inf if what == "noise_floor" else LARGEST_NOISE] * c
    tangent = None
    if len(angles):
        tangent = tangents(data.pair[:, index], signed=data.table.domain.in_plane)
        x += [0.0] * len(angles)
        units += list(angles)
        labels += [f"{name}_offset" for name in ANGLES[: len(angles)]]
        low += [-FARTHEST] * len(angles)
        high += [FARTHEST] * len(angles)
    for k, label in enumerate(labels):
        if label in within:
            low[k], high[k] = (end / units[k] for end in within[label])
    if value.size < len(x) - len(angles):
        raise FitError(
            f"{value.size} usable values can't determine {len(x)} parameters", code="too-few-samples",
            remedy="measure more geometries, fix parameters, or use a simpler model",
        )  # fmt: skip
    logs = np.zeros(len(x), bool)
    logs[len(linear) * c :][: len(places.entries)] = [places.logs[k] for k, _ in places.entries]
    walkers = request.walkers or max(FEWEST_WALKERS, 2 * len(x))
    density = Density(
        places,
        Data(
            np.ascontiguousarray(data.pair[:, index]), np.ascontiguousarray(value.T),
            None if sigma is None else np.ascontiguousarray(sigma.T), tangent,
            angles if len(angles) else None,
        ),
        np.array(low), np.array(high), None,
        Noise(request.degrees_of_freedom if request.likelihood == "student_t" else None, len(angles)),
        # Two parts of half of all walkers: a length for both kinds of moves, and work for two cores.
        max(1, -(-request.ensembles * walkers // 4)),
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
    # At about twice the Laplace spread: closer starts hide what the ensemble has not found.
    spread = 2.0 * np.linalg.cholesky(covariance)
    starts = mode + rng.standard_normal((request.ensembles * walkers, len(x))) @ spread.T
    starts = density.folded(starts)
    seed = np.random.SeedSequence(int(rng.integers(2**63)))
    proposal = Proposal(mode, covariance, starts)
    assert scale is not None
    weight = np.ascontiguousarray(1.0 / np.square(scale).T)
    return Ensembles(density, labels, logs, np.array(units), request.ensembles, seed, proposal, weight)


def _chain(sampler: emcee.EnsembleSampler) -> FloatArray:
    """(steps, E W, P) since the sampler was made."""
    return np.asarray(sampler.get_chain(), np.float64)
