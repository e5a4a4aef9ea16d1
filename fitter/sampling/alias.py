"""Choosing an item with given probabilities in constant time: Walker's alias method.

Each of K equal boxes holds one item and, above ``share``, another (A. J. Walker 1977, "An efficient method
for generating discrete random variables with general distributions").
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]


class AliasTable:
    """Items 0..K-1 with probabilities proportional to ``weights`` (K,), not negative, not all 0."""

    def __init__(self, weights: FloatArray) -> None:
        from fitter.kernels.alias import boxes

        self._share, self._alias = np.empty(len(weights)), np.empty(len(weights), np.int32)
        boxes(np.ascontiguousarray(weights, np.float64), self._share, self._alias)

    @property
    def boxes(self) -> tuple[FloatArray, NDArray[np.int32]]:
        """Share of each box's own item, and the other one, as kernels want them."""
        return self._share, self._alias

    def choose(self, uniform: FloatArray) -> IndexArray:
        """(m,) items, of uniform numbers (m,) in [0, 1), which are overwritten."""
        uniform *= len(self._share)
        item = uniform.astype(np.intp)
        uniform -= item
        return np.where(uniform < self._share.take(item), item, self._alias.take(item))
