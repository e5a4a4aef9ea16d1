"""Which cells of an envelope are worth halving."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# What halving a cell takes of its waste, or more: half of it where the field is linear along what is cut.
_SAVED = 0.4
# Aimed at beyond the acceptance asked for, of what is missing to 1: estimated masses are not exact.
_BEYOND = 0.1


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
    worth = np.flatnonzero(waste > max(0.5 * allowed, 1e-9 * float(envelope.sum())) / len(waste))
    # The worst of them, and no more than are needed: every cell costs set-up.
    worth = worth[np.argsort(-waste[worth])]
    saved = _SAVED * np.cumsum(waste[worth])
    enough = int(np.searchsorted(saved, float(waste.sum()) - (1 - _BEYOND) * allowed)) + 1
    split = np.zeros(len(waste), bool)
    split[worth[: min(enough, room)]] = True
    return split if split.any() else None
