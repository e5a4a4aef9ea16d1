"""TableSampler: exact random directions from a raw table, with no model in between."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitter import directions
from fitter.errors import FitError, SpecError, TableError
from fitter.sampling.drawing import Drawable
from fitter.sampling.envelope import Envelope, JointEnvelope, JointInfo, Method, SliceInfo
from fitter.sampling.interpolant import interpolant
from fitter.sampling.rejection import BLOCK, Drawn, blocks
from fitter.sampling.samples import Samples

if TYPE_CHECKING:
    from fitter.table import Table

FloatArray = NDArray[np.float64]

#: More draws than this don't fit in one answer (about 5 GB); stream them.
MOST_DRAWS = 50_000_000
# Blocks of draws in one part of a stream.
_AT_ONCE = 4
#: Set-ups of the latest incidences that are kept; one is a few MB.
KEPT = 16
# Without a budget of the caller's: an acceptance below this is a failure, not a reason to go on.
_HOPELESS = 1e-3


class TableSampler:
    """Draws wo with density proportional to f+(wi, wo) cos(theta_o), where f+ is the table's interpolant.

    Parameters
    ----------
    table : any :class:`fitter.Table` that covers more than the plane of incidence.
    weights : (C,) of the channels in f+, not negative; default equal. A channel of weight 0 is seen only
        where another one is positive.
    method : "rejection" (any table) or "inversion" (scattered tables and grids in incoming and outgoing
        angles, where nothing is rejected). Both are exact. Default: inversion for scattered tables, else
        rejection, whichever is faster.
    acceptance : refine envelopes until this share of the candidates is expected to be accepted.
    cells : at most so many cells per envelope.

    Negative values of a table that keeps them count as 0, sample by sample; :meth:`info` says how much
    that changes. Directions outside the measured domain are never drawn.

    Raises
    ------
    TableError : ``in-plane-only``.
    SpecError : weights or a method that make no sense.
    """

    def __init__(
        self,
        table: Table,
        *,
        weights: ArrayLike | None = None,
        method: Method | None = None,
        acceptance: float = 0.9,
        cells: int = 40_000,
    ) -> None:
        self._interpolant = interpolant(table)
        self._name = table.metadata.name or None
        self._weights = _weights(weights, len(table.channels))
        if method not in (None, "rejection", "inversion"):
            raise SpecError(
                f"there is no method {method!r}", code="bad-method", parameter="method",
                remedy="give 'rejection' or 'inversion', or leave it out",
            )  # fmt: skip
        self._method: Method | None = method
        self._target = acceptance, cells
        self._kept: dict[tuple[float, float, float], Envelope] = {}
        self._joint: JointEnvelope | None = None
        if self._interpolant.in_plane:
            raise TableError(
                "the table covers the plane of incidence only, which has no solid angle to draw from",
                code="in-plane-only", file=self._name, remedy="fit a model and draw from that",
            )  # fmt: skip

    def info(self, wi: ArrayLike, *, allow_extrapolated: bool = False) -> SliceInfo:
        """What the sampler knows about one incidence: integral, coverage, expected acceptance, clamping."""
        envelope = self.envelope(wi, allow_extrapolated=allow_extrapolated)
        return replace(envelope.info, energy_error=envelope.energy_error())

    def slices(self, wi: ArrayLike, *, allow_extrapolated: bool = False) -> list[dict[str, Any]] | None:
        """:meth:`info` of incidences (M, 3) or (3,) just drawn for; None of more than are kept."""
        several = np.atleast_2d(np.asarray(wi, np.float64))
        if len(several) > KEPT:
            return None
        return [asdict(self.info(one, allow_extrapolated=allow_extrapolated)) for one in several]

    def pdf(self, wi: ArrayLike, wo: ArrayLike, *, allow_extrapolated: bool = False) -> FloatArray:
        """(M,) density of wo (M, 3) given ``wi`` (3,) per unit solid angle, 1/sr."""
        envelope = self.envelope(wi, allow_extrapolated=allow_extrapolated)
        wo = np.atleast_2d(np.asarray(wo, np.float64))
        return envelope.values(wo) @ self._weights * np.maximum(wo[:, 2], 0.0) / envelope.integral

    def sample(
        self,
        wi: ArrayLike,
        n: int,
        seed: Any,
        *,
        allow_extrapolated: bool = False,
        max_evaluations: int | None = None,
    ) -> Samples:
        """``n`` directions for the incidence ``wi`` (3,), or ``n`` for each of ``wi`` (M, 3) in turn.

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
        several = np.asarray(wi, np.float64)
        if several.ndim != 2:
            _check_count(n, MOST_DRAWS)
            envelope, sequence, kept = self._start(wi, seed, allow_extrapolated)
            drawn = next(self._drawn(envelope.kernel, n, sequence, max_evaluations, -(-n // BLOCK)))
            return _samples(envelope, drawn, drawn.hits / drawn.tried, drawn.tried, kept)
        _check_count(n, MOST_DRAWS // max(len(several), 1))
        sequence, kept = _sequence(seed)
        parts: list[Samples] = []
        tried = 0
        for k, one in enumerate(several):
            left = None if max_evaluations is None else max_evaluations - tried
            envelope = self.envelope(one, allow_extrapolated=allow_extrapolated)
            own = np.random.SeedSequence(sequence.entropy, spawn_key=(*sequence.spawn_key, k))
            drawn = next(self._drawn(envelope.kernel, n, own, left, -(-n // BLOCK)))
            tried += drawn.tried
            parts.append(_samples(envelope, drawn, drawn.hits / drawn.tried, drawn.tried, kept))
        return joined(parts, np.repeat(several, n, axis=0))

    def stream(
        self,
        wi: ArrayLike,
        n: int,
        seed: Any,
        *,
        allow_extrapolated: bool = False,
        max_evaluations: int | None = None,
    ) -> Iterator[Samples]:
        """The same draws as :meth:`sample` for one incidence (3,) in parts of bounded size; any ``n``.

        ``acceptance`` and ``evaluations`` of each part are those of all candidates so far.
        """
        _check_count(n, None)
        envelope, sequence, kept = self._start(wi, seed, allow_extrapolated)
        return self._stream(envelope, n, sequence, kept, max_evaluations)

    def sample_pairs(self, n: int, seed: Any, *, max_evaluations: int | None = None) -> Samples:
        """``n`` pairs of directions, density proportional to f+(wi, wo) cos(theta_i) cos(theta_o).

        ``wi`` of the result holds the incidences; ``pdf`` is the joint density in 1/sr^2, and the mean of
        ``weight`` = f_r cos(theta_i) cos(theta_o) / pdf estimates pi times the bihemispherical reflectance
        over what was measured. Raises as :meth:`sample`; TableError ``too-few-incidences``.
        """
        _check_count(n, MOST_DRAWS // 2)
        sequence, kept = _sequence(seed)
        envelope = self._pairs()
        drawn = next(self._drawn(envelope, n, sequence, max_evaluations, -(-n // BLOCK), width=6))
        found = _samples(envelope, drawn, drawn.hits / drawn.tried, drawn.tried, kept)
        wi, wo = (np.ascontiguousarray(found.wo[:, part]) for part in (slice(0, 3), slice(3, 6)))
        return replace(found, wo=wo, wi=wi)

    def info_pairs(self) -> JointInfo:
        """What the sampler knows about pairs: their integral, its error, expected acceptance."""
        return self._pairs().info

    def _pairs(self) -> JointEnvelope:
        if self._joint is None:
            self._joint = self._interpolant.joint(self._weights, *self._target, self._method)
        return self._joint

    def _stream(
        self, envelope: Envelope, n: int, sequence: np.random.SeedSequence, kept: int | None, most: int | None
    ) -> Iterator[Samples]:
        tried = hits = 0
        for drawn in self._drawn(envelope.kernel, n, sequence, most, _AT_ONCE):
            tried, hits = tried + drawn.tried, hits + drawn.hits
            yield _samples(envelope, drawn, hits / tried, tried, kept)

    def _drawn(
        self,
        source: Drawable,
        n: int,
        sequence: np.random.SeedSequence,
        most: int | None,
        at_once: int,
        width: int = 3,
    ) -> Iterator[Drawn]:
        """Parts of ``n`` draws. Raises FitError once ``most`` candidates were not enough."""
        tried = hits = made = 0
        count, each = len(self._weights), int(BLOCK / _HOPELESS)
        for drawn in blocks(source, n, sequence, count, most, each, at_once, width):
            tried, hits, made = tried + drawn.tried, hits + drawn.hits, made + drawn.filled
            if drawn.filled < len(drawn.wo):
                raise FitError(
                    f"{made} of {n} directions drawn after {tried} candidates "
                    f"(acceptance {hits / max(tried, 1):.3g})",
                    code="evaluation-budget", parameter="max_evaluations",
                    cause="the budget is small, or the slice is a narrow peak its cells don't resolve",
                    remedy="raise max_evaluations, or give the sampler more cells",
                )  # fmt: skip
            yield drawn

    def _start(
        self, wi: ArrayLike, seed: Any, allow_extrapolated: bool
    ) -> tuple[Envelope, np.random.SeedSequence, int | None]:
        sequence, kept = _sequence(seed)
        return self.envelope(wi, allow_extrapolated=allow_extrapolated), sequence, kept

    def envelope(self, wi: ArrayLike, *, allow_extrapolated: bool = False) -> Envelope:
        """What candidates for the incidence ``wi`` (3,) are drawn from; kept for the latest few."""
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
            if len(self._kept) >= KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = part.envelope(self._weights, *self._target, self._method or part.preferred)
        return self._kept[key]


def _samples(
    envelope: Envelope | JointEnvelope, drawn: Drawn, acceptance: float, tried: int, seed: int | None
) -> Samples:
    n, weight = len(drawn.wo), drawn.weight
    if weight is None:
        # The same number for all: no memory need be written.
        weight = np.broadcast_to(np.float64(envelope.integral), (n, 1))
    return Samples(
        wo=drawn.wo, pdf=drawn.pdf, weight=weight, valid=np.ones(n, bool), is_delta=np.zeros(n, bool),
        acceptance=acceptance, seed=seed, evaluations=tried,
    )  # fmt: skip


def joined(parts: list[Samples], wi: FloatArray) -> Samples:
    """Draws for several incidences as one."""
    arrays = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("wo", "pdf", "weight", "valid", "is_delta")
    }
    tried = sum(part.evaluations or 0 for part in parts)
    hits = sum(part.acceptance * (part.evaluations or 0) for part in parts)
    return Samples(**arrays, acceptance=hits / tried, seed=parts[0].seed, evaluations=tried, wi=wi)


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


def _sequence(seed: Any) -> tuple[np.random.SeedSequence, int | None]:
    """A seed sequence from an integer or a JAX key, and the integer if it was one."""
    if isinstance(seed, int | np.integer) and not isinstance(seed, bool) and seed >= 0:
        return np.random.SeedSequence(int(seed)), int(seed)
    jax = sys.modules.get("jax")  # whoever holds a key has imported it; nobody else should wait for it
    if jax is not None and isinstance(seed, jax.Array):
        return np.random.SeedSequence(np.asarray(jax.random.key_data(seed)).reshape(-1).tolist()), None
    raise SpecError(
        f"seed must be an integer >= 0 or a JAX key, not {seed!r}", code="bad-seed", parameter="seed",
        remedy="give an integer; the same one gives the same draws",
    )  # fmt: skip
