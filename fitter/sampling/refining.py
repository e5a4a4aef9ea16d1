"""Which cells of an envelope are worth halving."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


def worth_halving(envelope: FloatArray, mass: FloatArray, acceptance: float, most: int) -> BoolArray | None:
    """(K,) cells to halve, at most ``most`` cells in the end; None where the acceptance is reached.

    envelope, mass : (K,) integrals of the envelope and of what it bounds over each cell.
    """
    allowed = float(mass.sum()) * (1 / acceptance - 1)
    waste = envelope - mass
    room = most - len(waste)
    if float(waste.sum()) <= allowed or room <= 0:
        return None
    # Splitting only what is above its fair share lets the work go where it is needed.
    split = waste > max(0.5 * allowed, 1e-9 * float(envelope.sum())) / len(waste)
    if np.count_nonzero(split) > room:
        worst = np.argpartition(waste, -room)[-room:]
        split = np.zeros(len(waste), bool)
        split[worst] = True
    return split if split.any() else None
