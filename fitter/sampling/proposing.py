"""Pairs of directions from candidates in arrays, a few thousand at a time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.sampling.drawing import Arrays
from fitter.sampling.envelope import JointInfo

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# Candidates at a time: what is computed of them stays in a core's cache.
_PART = 1 << 13


@dataclass(frozen=True)
class Candidates:
    """wo : components of wi and then of wo, each (m,). accepted : (m,). density : (m,) weighted f+ in 1/sr,
    defined where accepted.

    place : where the candidates lie, in the envelope's own terms, for :meth:`Proposing.channels`.
    """

    wo: tuple[FloatArray, ...]
    accepted: BoolArray
    density: FloatArray
    place: tuple[NDArray[Any], ...]


class Proposing(ABC):
    """Draws by candidates, each accepted with exactly the right probability."""

    info: JointInfo

    @property
    def integral(self) -> float:
        """Of what the draws follow."""
        return self.info.integral

    @abstractmethod
    def draw(self, rng: np.random.Generator, m: int) -> Candidates:
        """``m`` candidates; the accepted ones are independent and follow the density."""
        ...

    @abstractmethod
    def channels(self, place: tuple[NDArray[Any], ...]) -> FloatArray:
        """(m, C) f+ of every channel in 1/sr at candidates' places."""
        ...

    def fill(
        self, seed: np.random.SeedSequence, out: Arrays, budget: int, stop: Event
    ) -> tuple[int, int, int]:
        """As :class:`Drawable` has it."""
        rng, integral = np.random.default_rng(seed), self.integral
        wo, pdf, weight = out
        tried = hits = filled = 0
        hopeful = 1.0
        while filled < len(pdf) and tried < budget and not stop.is_set():
            left = len(pdf) - filled
            m = min(left if hopeful == 1 else int(left / hopeful) + 16, _PART, budget - tried)
            found = self.draw(rng, m)
            tried += m
            good = np.flatnonzero(found.accepted)
            hits += len(good)
            good = good[:left]
            hopeful = max(hits / tried, 1e-3)
            density = found.density[good]
            part = slice(filled, filled + len(density))
            for k, column in enumerate(found.wo):
                wo[part, k] = column[good]
            np.multiply(density, wo[part, 2] * wo[part, 5] / integral, out=pdf[part])
            if weight is not None:
                values = self.channels(tuple(one[good] for one in found.place))
                # f cos / pdf = f / f+ x integral: the cosines cancel, so this stays exact at the horizon.
                np.multiply(values, (integral / density)[:, None], out=weight[part])
            filled += len(density)
        return tried, hits, filled
