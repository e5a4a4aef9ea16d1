"""Filling a block with draws by a compiled kernel.

A block has a random stream of its own, so that the same seed gives the same draws on any number of cores.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from threading import Event
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fitter.errors import FitError

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
#: wo (m, 3), or (m, 6) of wi and wo; pdf (m,); weight (m, C), None of one channel.
Arrays = tuple[FloatArray, FloatArray, FloatArray | None]

# Candidates of a kernel until it is asked whether to go on.
_UNTIL_ASKED = 1 << 20
# Numbers of a cache line.
_LINE = 8


class Drawable(Protocol):
    """Not changed by drawing: threads may share one."""

    def fill(
        self, seed: np.random.SeedSequence, out: Arrays, budget: int, stop: Event
    ) -> tuple[int, int, int]:
        """``(tried, hits, filled)`` of filling the arrays of one block; ``hits`` are the accepted
        candidates, used or not, ``filled`` the draws made: fewer than asked for where ``budget`` candidates
        are used up or ``stop`` is set.

        Raises FitError where a candidate exceeds its majorant.
        """
        ...


@dataclass(frozen=True)
class Kernel:
    """A slice's draws. call : one of the ``fill`` of :mod:`fitter.kernels`, all but its last six arguments
    given."""

    call: Callable[..., tuple[int, int]]

    def fill(
        self, seed: np.random.SeedSequence, out: Arrays, budget: int, stop: Event
    ) -> tuple[int, int, int]:
        """As :class:`Drawable` has it."""
        wo, pdf, weight = out
        weight = np.empty((len(pdf), 0)) if weight is None else weight
        state = seed.generate_state(_words(), np.uint64)
        tried = filled = 0
        while filled < len(pdf) and tried < budget and not stop.is_set():
            some = min(budget - tried, _UNTIL_ASKED)
            more, fresh = self.call(state, False, wo[filled:], pdf[filled:], weight[filled:], some)
            if more < 0:
                raise violated()
            tried, filled = tried + more, filled + fresh
        return tried, filled, filled

    def candidates(self, rng: np.random.Generator, m: int) -> tuple[FloatArray, BoolArray]:
        """``(wo (m, 3), accepted (m,))`` of ``m`` candidates."""
        state = rng.integers(0, 2**64, _words(), np.uint64)
        wo, pdf = np.empty((m, 3)), np.empty(m)
        tried, _ = self.call(state, True, wo, pdf, np.empty((m, 0)), m)
        if tried < 0:
            raise violated()
        return wo, pdf >= 0


def in_lines(columns: Sequence[FloatArray], width: int) -> FloatArray:
    """(K, width) of ``columns`` (K,) each, the rest 0, from the start of a cache line on: rows of 4 or 8 then
    take no more lines than they must."""
    count = len(columns[0])
    space = np.zeros(count * width + _LINE)
    start = -space.ctypes.data // space.itemsize % _LINE
    rows = space[start : start + count * width].reshape(count, width)
    for k, column in enumerate(columns):
        rows[:, k] = column
    return rows


def _words() -> int:
    from fitter.kernels.uniform import STATE  # imports Numba: not before something is drawn

    return STATE


def violated() -> FitError:
    """A candidate exceeds its majorant."""
    return FitError(
        "the interpolant exceeds its bound: the draws would not be exact", code="majorant-violated",
        cause="a defect of this library", remedy="report it with the table and the incidence",
    )  # fmt: skip
