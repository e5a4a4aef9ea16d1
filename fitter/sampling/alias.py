"""Choosing an item with given probabilities in constant time: Walker's alias method.

Each of K equal boxes holds one item and, above ``share``, another (A. J. Walker 1977, "An efficient method
for generating discrete random variables with general distributions"). The table is built without a loop:
light items are filled up by heavy ones in order, and the running sums of what the light ones lack and of
what the heavy ones have too much say which heavy item fills which box.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]


class AliasTable:
    """Items 0..K-1 with probabilities proportional to ``weights`` (K,), not negative, not all 0."""

    def __init__(self, weights: FloatArray) -> None:
        count = len(weights)
        scaled = weights * (count / float(weights.sum()))
        light, heavy = np.flatnonzero(scaled < 1.0), np.flatnonzero(scaled >= 1.0)
        if len(heavy) == 0:  # all are 1 but for rounding
            heavy, light = light[-1:], light[:-1]
        lack = np.cumsum(1.0 - scaled[light])
        excess = np.cumsum(scaled[heavy] - 1.0)
        share = np.minimum(scaled, 1.0)
        alias = np.arange(count, dtype=np.intp)
        # A light item is filled by the first heavy one whose excess the boxes before have not used up.
        before = np.concatenate([[0.0], lack])[: len(light)]
        alias[light] = heavy[np.minimum(np.searchsorted(excess, before, side="right"), len(heavy) - 1)]
        # A heavy item that has given too much is itself filled up by the next one.
        used = np.searchsorted(lack, excess, side="left")
        given = lack[np.minimum(used, len(lack) - 1)] - excess if len(lack) else np.zeros(len(heavy))
        share[heavy] = np.clip(1.0 - given, 0.0, 1.0)
        alias[heavy[:-1]] = heavy[1:]
        share[heavy[-1]] = 1.0
        self._share, self._alias, self._count = share, alias, count

    @property
    def boxes(self) -> tuple[FloatArray, NDArray[np.int32]]:
        """Share of each box's own item, and the other one, as kernels want them."""
        return self._share, self._alias.astype(np.int32)

    def choose(self, uniform: FloatArray) -> IndexArray:
        """(m,) items, of uniform numbers (m,) in [0, 1), which are overwritten."""
        uniform *= self._count
        item = uniform.astype(np.intp)
        uniform -= item
        return np.where(uniform < self._share.take(item), item, self._alias.take(item))
