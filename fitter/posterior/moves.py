"""Moves of several independent ensembles at once: independence proposals and differential evolution.

The walkers of all ensembles lie behind each other in one emcee sampler, so that each step asks for the
log-density of all in one call; no move looks beyond its ensemble. emcee 3.1.6's DESnookerMove is not used:
it does not preserve its target (a 9-D normal comes out with standard deviations 13 % small). Every move used
here is tested against targets of known spread.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import emcee
import numpy as np
from emcee.model import Model
from emcee.state import State
from numpy.typing import NDArray

from fitter.posterior.blobs import Blobs

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
#: Degrees of freedom of the independence proposal: its tails are heavier than the posterior's, so no walker
#: sticks. Heavier ones (5) are refused twice as often in nine dimensions; lighter ones (20) let walkers stick
#: in the tails of posteriors from 60 samples.
FREEDOM = 10.0
#: Bounds that proposals are mirrored at, at most (32 images), from how many standard deviations on.
MIRRORS, NEAR = 5, 4.0
#: Shares of the moves. What the independence proposals can't reach, differential evolution learns; its jumps
#: of gamma = 1 cross between modes.
SHARES = (0.8, 0.15, 0.05)
FREE_SHARES = (0.6, 0.3, 0.1)
#: Beside either, of each move to a twin.
TWIN_SHARE = 0.05


class Coordinates(Protocol):
    """v(y) in which a move proposes: the density that it keeps is that of y times |dy/dv|."""

    def into(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """v (W, P) of y (W, P), and log |dy/dv| (W,)."""
        ...

    def back(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """y (W, P) of v (W, P), and log |dy/dv| (W,)."""
        ...


class Plain:
    """v = y."""

    def into(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        return y, np.zeros(len(y))

    def back(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        return v, np.zeros(len(v))


PLAIN = Plain()


class Independence(emcee.moves.Move):
    """Metropolis-Hastings with proposals that don't look at where a walker is (Tierney 1994).

    ``tried`` and ``accepted`` count its proposals.
    """

    coordinates: Coordinates = PLAIN
    tried = accepted = 0

    def propose(self, model: Model, state: State) -> tuple[State, NDArray[np.bool_]]:
        random = model.random
        x, volume = self.coordinates.into(state.coords)
        moved = self.proposals(len(x), random)
        proposed, moved_volume = self.coordinates.back(moved)
        found = model.compute_log_prob_fn(proposed)[0]
        log_ratio = self.log_density(x) - self.log_density(moved) + moved_volume - volume
        accepted = np.log(random.rand(len(x))) < found - state.log_prob + log_ratio
        self.tried += len(x)
        self.accepted += int(accepted.sum())
        return self.update(state, State(proposed, log_prob=found), accepted), accepted

    def proposals(self, count: int, random: np.random.RandomState) -> FloatArray:
        """(count, P) in ``coordinates``."""
        raise NotImplementedError

    def log_density(self, x: FloatArray) -> FloatArray:
        """(W,) of proposals x (W, P), up to a constant."""
        raise NotImplementedError


class IndependenceMove(Independence):
    """Proposals from a multivariate t about the mode.

    A posterior near a bound is half a bell. Proposals beyond a bound that the mode is near to are mirrored
    back, so that the density of a proposal is the sum over its mirror images; with more than MIRRORS such
    bounds, proposals beyond the others are left to be refused.
    """

    def __init__(
        self, mode: FloatArray, covariance: FloatArray, lower: FloatArray | float = -np.inf,
        upper: FloatArray | float = np.inf,
    ) -> None:  # fmt: skip
        self.mode = mode
        self.root = np.linalg.cholesky(covariance)
        sd = np.sqrt(np.diagonal(covariance))
        below, above = (mode - lower) / sd, (upper - mode) / sd
        self.bound = np.where(below <= above, lower, upper)
        self.side = np.where(below <= above, 1.0, -1.0)
        distance = np.minimum(below, above)
        self.near = np.argsort(distance, kind="stable")[:MIRRORS]
        self.near = self.near[distance[self.near] < NEAR]

    def proposals(self, count: int, random: np.random.RandomState) -> FloatArray:
        normal = random.standard_normal((count, len(self.mode)))
        z = normal * np.sqrt(FREEDOM / random.chisquare(FREEDOM, size=(count, 1)))
        proposed = self.mode + z @ self.root.T
        k = self.near
        proposed[:, k] = self.bound[k] + self.side[k] * np.abs(proposed[:, k] - self.bound[k])
        return proposed

    def log_density(self, x: FloatArray) -> FloatArray:
        # On the inner side of the mirrors.
        centred = (x - self.mode).T
        images = [centred]
        for k in self.near:
            shift = 2.0 * (self.bound[k] - self.mode[k])
            for one in list(images):
                mirrored = one.copy()
                mirrored[k] = shift - one[k]
                images.append(mirrored)
        z = np.linalg.solve(self.root, np.concatenate(images, axis=1))
        each = -0.5 * (FREEDOM + len(z)) * np.log1p(np.square(z).sum(axis=0) / FREEDOM)
        return np.logaddexp.reduce(each.reshape(len(images), len(x)), axis=0)


class BlobsMove(Independence):
    """Proposals from a mixture of multivariate t, one for each of the ``blobs`` of where walkers were."""

    def __init__(self, found: Blobs, coordinates: Coordinates) -> None:
        self.blobs, self.coordinates = found, coordinates
        self.roots = np.linalg.cholesky(found.covariance)
        self.inverse = np.linalg.inv(self.roots)
        self.sizes = np.log(np.diagonal(self.roots, axis1=1, axis2=2)).sum(axis=1)

    def proposals(self, count: int, random: np.random.RandomState) -> FloatArray:
        weight, mean, _ = self.blobs
        k = random.choice(len(weight), size=count, p=weight)
        normal = random.standard_normal((count, mean.shape[1]))
        z = normal * np.sqrt(FREEDOM / random.chisquare(FREEDOM, size=(count, 1)))
        return mean[k] + np.einsum("wij,wj->wi", self.roots[k], z)

    def log_density(self, x: FloatArray) -> FloatArray:
        weight, mean, _ = self.blobs
        z = self.inverse @ (x - mean[:, None]).swapaxes(1, 2)
        each = -0.5 * (FREEDOM + x.shape[1]) * np.log1p(np.square(z).sum(axis=1) / FREEDOM)
        return np.logaddexp.reduce((np.log(weight) - self.sizes)[:, None] + each)


class DifferenceMove(emcee.moves.Move):
    """Differential evolution (ter Braak 2006, Nelson et al. 2014): a walker of one half of its ensemble moves
    along the difference of two of the other half.

    ensembles : how many there are, of equal length. gamma : factor of the difference; None takes
    2.38/sqrt(2 P).
    """

    def __init__(
        self, ensembles: int, gamma: float | None = None, coordinates: Coordinates = PLAIN
    ) -> None:  # fmt: skip
        self.coordinates = coordinates
        self.ensembles = ensembles
        self.gamma = gamma

    def propose(self, model: Model, state: State) -> tuple[State, NDArray[np.bool_]]:
        random, (count, size), log_density = model.random, state.coords.shape, state.log_prob
        assert log_density is not None
        each = count // self.ensembles
        first = each * np.arange(self.ensembles)[:, None]
        shuffled = random.rand(self.ensembles, each).argsort(axis=1) + first
        accepted = np.zeros(count, bool)
        halves = shuffled[:, : each // 2], shuffled[:, each // 2 :]
        v, volume = self.coordinates.into(state.coords)
        v, volume = v.copy(), volume.copy()
        for mine, others in (halves, halves[::-1]):
            moved = self._moved(v, mine, others, random).reshape(-1, size)
            proposed, moved_volume = self.coordinates.back(moved)
            index = mine.reshape(-1)
            found = model.compute_log_prob_fn(proposed)[0]
            log_ratio = found - log_density[index] + moved_volume - volume[index]
            better = np.log(random.rand(len(index))) < log_ratio
            taken = index[better]
            accepted[taken] = True
            state.coords[taken], v[taken] = proposed[better], moved[better]
            log_density[taken], volume[taken] = found[better], moved_volume[better]
        return state, accepted

    def _moved(
        self, x: FloatArray, mine: IntArray, others: IntArray, random: np.random.RandomState
    ) -> FloatArray:
        """(E, H, P) proposals for the walkers ``mine`` (E, H) of differences of ``others`` (E, K)."""
        a = random.randint(others.shape[1], size=mine.shape)
        b = random.randint(others.shape[1] - 1, size=mine.shape)
        b += b >= a  # any but a
        difference = x[np.take_along_axis(others, a, 1)] - x[np.take_along_axis(others, b, 1)]
        gamma = self.gamma or 2.38 / np.sqrt(2 * x.shape[1])
        # Spread a little, as the references have it: otherwise jumps of 1 would stay on a lattice.
        return x[mine] + gamma * (1 + 1e-5 * random.standard_normal((*mine.shape, 1))) * difference


class TwinMove(emcee.moves.Move):
    """Metropolis-Hastings with the one vector that ``twin`` leads to, and back from: an involution that keeps
    volumes (L. Tierney, "A note on Metropolis-Hastings kernels for general state spaces", Annals of Applied
    Probability 8, 1998)."""

    def __init__(self, twin: Callable[[FloatArray], FloatArray]) -> None:
        self.twin = twin

    def propose(self, model: Model, state: State) -> tuple[State, NDArray[np.bool_]]:
        proposed = self.twin(state.coords)
        found = model.compute_log_prob_fn(proposed)[0]
        accepted = np.log(model.random.rand(len(proposed))) < found - state.log_prob
        return self.update(state, State(proposed, log_prob=found), accepted), accepted


def mixture(
    mode: FloatArray, covariance: FloatArray, ensembles: int, lower: FloatArray | float = -np.inf,
    upper: FloatArray | float = np.inf,
) -> list[tuple[Independence | DifferenceMove, float]]:  # fmt: skip
    """Independence proposals mixed with differential evolution, which learns a shape that isn't normal.

    lower, upper : bounds, beyond which the density is 0.
    """
    independence = IndependenceMove(mode, covariance, lower, upper)
    moves = (independence, DifferenceMove(ensembles), DifferenceMove(ensembles, 1.0))
    return list(zip(moves, SHARES, strict=True))


def free_mixture(
    found: Blobs, ensembles: int, coordinates: Coordinates
) -> list[tuple[Independence | DifferenceMove, float]]:
    """The like of :func:`mixture` for a posterior of any shape, in coordinates without bounds."""
    moves = (
        BlobsMove(found, coordinates), DifferenceMove(ensembles, None, coordinates),
        DifferenceMove(ensembles, 1.0, coordinates),
    )  # fmt: skip
    return list(zip(moves, FREE_SHARES, strict=True))
