"""Boxes for choosing an item in constant time, see :mod:`fitter.sampling.alias`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled

FloatArray = NDArray[np.float64]


@compiled
def boxes(weights: FloatArray, share: FloatArray, alias: NDArray[np.int32]) -> None:
    """Share of each box's own item, and the item that has the rest, of items with probabilities proportional
    to ``weights`` (K,), not negative, not all 0.

    Items lighter than a box are filled up in order by the first heavier one that has something left; once it
    has less than a box itself, the next heavier one fills it up.
    """
    count, total = len(weights), 0.0
    for k in range(count):
        total += weights[k]
    scale = count / total
    for k in range(count):
        share[k], alias[k] = weights[k] * scale, k
    light = heavy = 0
    while heavy < count and share[heavy] < 1.0:
        heavy += 1
    if heavy == count:  # all are 1 but for rounding
        share[:] = 1.0
        return
    following, left = heavy + 1, share[heavy]
    while True:
        if left >= 1.0:
            while light < count and weights[light] * scale >= 1.0:
                light += 1
            if light == count:
                break
            left -= 1.0 - share[light]
            alias[light] = heavy
            light += 1
        else:
            while following < count and share[following] < 1.0:
                following += 1
            if following == count:
                break
            share[heavy], alias[heavy] = left, following
            left += share[following] - 1.0
            heavy, following = following, following + 1
    # What is left of the last one is a box but for rounding; so is what lighter ones still lack in all.
    share[heavy] = 1.0
    for k in range(light, count):
        if weights[k] * scale < 1.0:
            alias[k] = heavy
    for k in range(following, count):
        share[k] = min(share[k], 1.0)
