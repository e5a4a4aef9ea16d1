"""TableSampler: exact random directions from a raw table, by rejection, with no model in between."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitter import directions
from fitter.errors import FitError, SpecError, TableError
from fitter.sampling.envelope import Envelope, SliceInfo
from fitter.sampling.interpolant import interpolant
from fitter.sampling.samples import Samples

if TYPE_CHECKING:
    from fitter.table import Table

FloatArray = NDArray[np.float64]

#: More draws than this don't fit in one answer (about 5 GB); stream them.
MOST_DRAWS = 50_000_000
_CHUNK = 1 << 18
# Kept set-ups; one is a few MB.
_KEPT = 16
# Without a budget of the caller's: an acceptance below this is a failure, not a reason to go on.
_HOPELESS = 1e-3


class TableSampler:
    """Draws wo with density proportional to f+(wi, wo) cos(theta_o), where f+ is the table's interpolant.

    Parameters
    ----------
    table : any :class:`fitter.Table` that covers more than the plane of incidence.
    weights : (C,) of the channels in f+, not negative; default equal. A channel of weight 0 is seen only
        where another one is positive.
    acceptance : refine envelopes until this share of the candidates is expected to be accepted.
    cells : at most so many cells per envelope.

    Negative values of a table that keeps them count as 0, sample by sample; :meth:`info` says how much
    that changes. Directions outside the measured domain are never drawn.

    Raises
    ------
    TableError : ``in-plane-only``.
    SpecError : weights that make no sense.
    """

    def __init__(
        self, table: Table, *, weights: ArrayLike | None = None, acceptance: float = 0.9, cells: int = 40_000
    ) -> None:
        self._interpolant = interpolant(table)
        self._name = table.metadata.name or None
        self._weights = _weights(weights, len(table.channels))
        self._target = acceptance, cells
        self._kept: dict[tuple[float, float, float], Envelope] = {}
        if self._interpolant.in_plane:
            raise TableError(
                "the table covers the plane of incidence only, which has no solid angle to draw from",
                code="in-plane-only", file=self._name, remedy="fit a model and draw from that",
            )  # fmt: skip

    def info(self, wi: ArrayLike, *, allow_extrapolated: bool = False) -> SliceInfo:
        """What the sampler knows about one incidence: integral, coverage, expected acceptance, clamping."""
        return self._envelope(wi, allow_extrapolated).info

    def pdf(self, wi: ArrayLike, wo: ArrayLike, *, allow_extrapolated: bool = False) -> FloatArray:
        """(M,) density of wo (M, 3) given ``wi`` (3,) per unit solid angle, 1/sr."""
        envelope = self._envelope(wi, allow_extrapolated)
        wo = np.atleast_2d(np.asarray(wo, np.float64))
        return envelope.values(wo) @ self._weights * np.maximum(wo[:, 2], 0.0) / envelope.info.integral

    def sample(
        self,
        wi: ArrayLike,
        n: int,
        seed: Any,
        *,
        allow_extrapolated: bool = False,
        max_evaluations: int | None = None,
    ) -> Samples:
        """``n`` directions for the one incidence ``wi`` (3,).

        Parameters
        ----------
        seed : an integer >= 0 or a JAX key; the same seed gives the same draws.
        allow_extrapolated : draw for incidences outside the measured ones too, from the nearest one.
        max_evaluations : candidates to try at most.

        Raises
        ------
        SpecError : n or seed that make no sense. TableError : an incidence that was not measured, or where
        nothing is positive. FitError : ``max_evaluations`` reached, with the acceptance so far.
        """
        _check_count(n, MOST_DRAWS)
        parts = list(
            self.stream(wi, n, seed, allow_extrapolated=allow_extrapolated, max_evaluations=max_evaluations)
        )
        arrays = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("wo", "pdf", "weight", "valid", "is_delta")
        }
        # Each part states the share so far: the last one is that of all.
        return Samples(**arrays, acceptance=parts[-1].acceptance, seed=parts[-1].seed)

    def stream(
        self,
        wi: ArrayLike,
        n: int,
        seed: Any,
        *,
        allow_extrapolated: bool = False,
        max_evaluations: int | None = None,
    ) -> Iterator[Samples]:
        """The same draws as :meth:`sample` in parts of bounded size; any ``n``.

        ``acceptance`` of each part is that of all candidates so far.
        """
        _check_count(n, None)
        rng, seed_kept = _generator(seed)
        envelope = self._envelope(wi, allow_extrapolated)
        return self._stream(envelope, n, rng, seed_kept, max_evaluations)

    def _stream(
        self,
        envelope: Envelope,
        n: int,
        rng: np.random.Generator,
        seed: int | None,
        max_evaluations: int | None,
    ) -> Iterator[Samples]:
        budget = max_evaluations if max_evaluations is not None else int(n / _HOPELESS) + 10 * _CHUNK
        tried = accepted = 0
        left = n
        while left > 0:
            m = min(int(left / max(envelope.info.acceptance, _HOPELESS) * 1.01) + 64, _CHUNK, budget - tried)
            if m <= 0:
                raise FitError(
                    f"{n - left} of {n} directions drawn after {tried} candidates "
                    f"(acceptance {accepted / max(tried, 1):.3g})",
                    code="evaluation-budget", parameter="max_evaluations",
                    cause="the budget is small, or the slice is a narrow peak its cells don't resolve",
                    remedy="raise max_evaluations, or give the sampler more cells",
                )  # fmt: skip
            candidates = envelope.draw(rng, m)
            tried += m
            hits = np.flatnonzero(candidates.accepted)
            accepted += len(hits)
            hits = hits[:left]
            left -= len(hits)
            if len(hits):
                yield self._samples(
                    envelope, candidates.wo[hits], candidates.density[hits], accepted / tried, seed
                )

    def _samples(
        self, envelope: Envelope, wo: FloatArray, density: FloatArray, acceptance: float, seed: int | None
    ) -> Samples:
        n = len(wo)
        # f cos / pdf = f / f+ x integral: the cosine cancels, so the weight stays exact at the horizon.
        share = np.ones((n, 1)) if len(self._weights) == 1 else envelope.values(wo) / density[:, None]
        return Samples(
            wo=wo, pdf=density * wo[:, 2] / envelope.info.integral, weight=share * envelope.info.integral,
            valid=np.ones(n, bool), is_delta=np.zeros(n, bool), acceptance=acceptance, seed=seed,
        )  # fmt: skip

    def _envelope(self, wi: ArrayLike, allow_extrapolated: bool) -> Envelope:
        w = np.asarray(wi, np.float64)
        if w.shape != (3,) or not np.isfinite(w).all() or abs(float(w @ w) - 1.0) > 1e-6 or w[2] <= 0:
            raise SpecError(
                "wi must be one unit vector above the surface", code="bad-incidence", parameter="wi",
                remedy="give (x, y, z) with x^2 + y^2 + z^2 = 1 and z > 0",
            )  # fmt: skip
        part = self._interpolant.slice(w)
        if part.extrapolated and not allow_extrapolated:
            theta = np.rad2deg(float(directions.spherical_from_vector(w)[0]))
            raise TableError(
                f"the incidence (theta_i {theta:.4g} degrees) lies outside the measured ones",
                code="incidence-not-measured", file=self._name, parameter="wi",
                remedy="choose a measured incidence, or allow extrapolation",
            )  # fmt: skip
        key = (float(w[0]), float(w[1]), float(w[2]))
        if key not in self._kept:
            if len(self._kept) >= _KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = part.envelope(self._weights, *self._target)
        return self._kept[key]


def _check_count(n: Any, most: int | None) -> None:
    whole = isinstance(n, int | np.integer) and not isinstance(n, bool)
    if not whole or n <= 0 or (most is not None and n > most):
        limit = f" and at most {most}" if most is not None else ""
        raise SpecError(
            f"the number of directions must be a positive integer{limit}, not {n!r}", code="bad-count",
            parameter="n", remedy="ask for fewer at a time, or stream them",
        )  # fmt: skip


def _weights(given: ArrayLike | None, channels: int) -> FloatArray:
    if given is None:
        return np.full(channels, 1.0 / channels)
    weights = np.asarray(given, np.float64)
    usable = weights.shape == (channels,) and np.isfinite(weights).all() and (weights >= 0).all()
    if not usable or weights.sum() <= 0:
        raise SpecError(
            f"weights must be {channels} numbers, not negative and not all 0", code="bad-weights",
            parameter="weights", remedy="give one weight per channel, or leave them out",
        )  # fmt: skip
    return weights / weights.sum()


def _generator(seed: Any) -> tuple[np.random.Generator, int | None]:
    """A numpy generator from an integer or a JAX key, and the integer if it was one."""
    if isinstance(seed, int | np.integer) and not isinstance(seed, bool) and seed >= 0:
        return np.random.default_rng(int(seed)), int(seed)
    jax = sys.modules.get("jax")  # whoever holds a key has imported it; nobody else should wait for it
    if jax is not None and isinstance(seed, jax.Array):
        return np.random.default_rng(np.asarray(jax.random.key_data(seed)).reshape(-1).tolist()), None
    raise SpecError(
        f"seed must be an integer >= 0 or a JAX key, not {seed!r}", code="bad-seed", parameter="seed",
        remedy="give an integer; the same one gives the same draws",
    )  # fmt: skip
