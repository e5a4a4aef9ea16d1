"""What the rejection sampler draws candidates from, and what it knows about one slice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class SliceInfo:
    """One incidence of a table, as the sampler sees it. f+ is the interpolant of the values clamped at 0.

    integral : of f+ cos(theta_o), channels weighted, over the measured part of the hemisphere.
    integral_error : estimated relative error of that integral (0 where it is exact but for rounding).
    clamped_share : how much of f+ cos(theta_o) comes from clamping negative values at 0, relative.
    coverage : share of the projected hemisphere (of the disk) that was measured and can be drawn.
    cells : cells of the envelope.
    acceptance : expected share of candidates that is accepted.
    extrapolated : True when the incidence lies outside the measured ones (only if that was allowed).
    """

    integral: float
    integral_error: float
    clamped_share: float
    coverage: float
    cells: int
    acceptance: float
    extrapolated: bool


@dataclass(frozen=True)
class Candidates:
    """wo : (m, 3); accepted : (m,); density : (m,) weighted f+ in 1/sr, defined where accepted."""

    wo: FloatArray
    accepted: BoolArray
    density: FloatArray


class Envelope(Protocol):
    """Draws candidates and accepts them with exactly the right probability."""

    info: SliceInfo

    def draw(self, rng: np.random.Generator, m: int) -> Candidates:
        """``m`` candidates; the accepted ones are independent and distributed as f+ cos(theta_o)."""
        ...

    def values(self, wo: FloatArray) -> FloatArray:
        """(M, C) f+ of every channel in 1/sr at directions (M, 3), 0 outside the measured part."""
        ...
