"""Summary of a table's values, found in pieces that stay in the cache."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
#: Rows looked at together, and rows of which the median is taken at most.
PIECE, ENOUGH = 65_536, 131_072


class Summary(NamedTuple):
    """Of the usable values of each channel (C,): the largest magnitude, the median magnitude (of at most
    131,072 evenly spaced ones), the mean, and the sum of squares about it."""

    largest: FloatArray
    typical: FloatArray
    mean: FloatArray
    spread: FloatArray


def summarise(value: FloatArray, used: NDArray[np.bool_]) -> Summary:
    """The summary of the rows ``used`` (N,) of values (N, C); at least one is used."""
    channels = value.shape[1]
    largest, mean, spread, count = np.zeros(channels), np.zeros(channels), np.zeros(channels), 0
    for start in range(0, len(value), PIECE):
        here = used[start : start + PIECE]
        piece = value[start : start + PIECE]
        piece = piece if here.all() else piece[here]
        if not len(piece):
            continue
        largest = np.maximum(largest, np.maximum(piece.max(axis=0), -piece.min(axis=0)))
        # Means and spreads of two parts put together (Chan, Golub and LeVeque 1979): no cancellation.
        with np.errstate(over="ignore", invalid="ignore"):  # of values near the limits, which a fit refuses
            own = piece.mean(axis=0)
            away, total = own - mean, count + len(piece)
            spread += np.square(piece - own).sum(axis=0) + np.square(away) * (count * len(piece) / total)
            mean += away * (len(piece) / total)
        count = total
    some = np.flatnonzero(used)[:: max(1, count // ENOUGH)]
    magnitude = np.abs(value[some])
    typical = np.median(magnitude, axis=0)
    # Where most are zero the mean magnitude has to do.
    typical = np.where(typical > 0, typical, magnitude.mean(axis=0))
    return Summary(largest, typical, mean, spread)
