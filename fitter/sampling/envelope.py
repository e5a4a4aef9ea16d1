"""What the samplers draw from, and what they know about one slice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from fitter.errors import SpecError, TableError
from fitter.sampling.drawing import Drawable, Kernel

FloatArray = NDArray[np.float64]

Method = Literal["rejection", "inversion"]


@dataclass(frozen=True)
class SliceInfo:
    """One incidence of a table, as the sampler sees it. f+ is the interpolant of the values clamped at 0.

    integral : of f+ cos(theta_o), channels weighted, over the measured part of the hemisphere.
    integral_error : estimated relative error of that integral (0 where it is exact but for rounding).
    clamped_share : how much of f+ cos(theta_o) comes from clamping negative values at 0, relative.
    coverage : share of the projected hemisphere (of the disk) that was measured and can be drawn.
    blind : share of the hemisphere's solid angle that was not measured or is masked: never drawn.
    cells : cells of the envelope.
    acceptance : expected share of candidates that is accepted.
    extrapolated : True when the incidence lies outside the measured ones (only if that was allowed).
    method : how directions are drawn.
    energy_error : what the integral is known to for interpolation alone, relative, estimated; None where
        :meth:`fitter.TableSampler.info` did not ask.
    """

    integral: float
    integral_error: float
    clamped_share: float
    coverage: float
    blind: float
    cells: int
    acceptance: float
    extrapolated: bool
    method: Method
    energy_error: float | None = None


@dataclass(frozen=True)
class JointInfo:
    """Incidences and scattered directions drawn together, as the sampler sees them.

    integral : of f+ cos(theta_i) cos(theta_o) over both hemispheres, as far as measured, channels weighted.
    integral_error : its estimated relative error, a standard error where it comes from draws.
    acceptance : expected share of candidates that is accepted.
    """

    integral: float
    integral_error: float
    acceptance: float


class JointEnvelope(Drawable, Protocol):
    """Draws are pairs: six numbers, wi then wo."""

    info: JointInfo

    @property
    def integral(self) -> float:
        """Of what the draws follow."""
        ...


class Envelope(Protocol):
    """Draws for one incidence."""

    integral: float
    acceptance: float
    kernel: Kernel

    @property
    def info(self) -> SliceInfo:
        """What is known of the slice; what drawing does not need is computed when it is asked for."""
        ...

    def energy_error(self) -> float:
        """That of :class:`SliceInfo`, estimated when it is asked for."""
        ...

    def values(self, wo: FloatArray) -> FloatArray:
        """(M, C) f+ of every channel in 1/sr at directions (M, 3), 0 outside the measured part."""
        ...


def empty_slice() -> TableError:
    """Nothing is positive at this incidence."""
    return TableError(
        "nothing can be drawn: the table's values are all zero or missing at this incidence",
        code="slice-empty", cause="a blind region, a masked slice or an incidence out of range",
        remedy="choose another incidence; the table's info lists its domain",
    )  # fmt: skip


def no_inversion(what: str) -> SpecError:
    """The interpolant of this kind of table can't be inverted exactly."""
    return SpecError(
        f"{what} can't be drawn from by inversion", code="no-inversion", parameter="method",
        cause="its interpolant has no integral in closed form",
        remedy="leave the method out, or use 'rejection': the draws are exact either way",
    )  # fmt: skip
