"""Extremes of any run of cells: of two rows of a power of two of them that overlap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.scene.intervals import Interval

FloatArray = NDArray[np.float64]


class Runs:
    """Of what is enclosed on cells (N,): row k holds the extremes of the 2^k cells from each on."""

    def __init__(self, low: FloatArray, high: FloatArray) -> None:
        cells = np.arange(len(low))
        lows, highs = [low], [high]
        for k in range(len(low).bit_length() - 1):
            on = np.minimum(cells + (1 << k), len(low) - 1)
            lows.append(np.minimum(lows[-1], lows[-1][on]))
            highs.append(np.maximum(highs[-1], highs[-1][on]))
        self._low, self._high = np.stack(lows), np.stack(highs)

    def over(self, first: NDArray[np.intp], last: NDArray[np.intp]) -> Interval:
        """From cell ``first`` to ``last``, both included."""
        run = np.frexp(last - first + 1)[1] - 1
        other = last + 1 - (1 << run)
        return Interval(
            np.minimum(self._low[run, first], self._low[run, other]),
            np.maximum(self._high[run, first], self._high[run, other]),
        )
