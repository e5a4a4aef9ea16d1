"""Candidates a chunk at a time, whose numbers are rows of one array that stays in the first cache.

Row k of a chunk is ``b[k * CHUNK + i]`` for the candidates i.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import part
from fitter.kernels.uniform import moved, one, two

FloatArray = NDArray[np.float64]
Words = NDArray[np.uint64]

#: Candidates of a chunk.
CHUNK = 64
#: The first rows: two numbers for the place in a cell, one for the test; what follows is a kernel's own.
U, V, CHANCE, OWN = 0, 1, 2, 3
#: Instead of a pdf: of a candidate that was rejected, and of one above its majorant.
REJECTED, ABOVE = -1.0, -2.0


@part
def proposed(
    state: Words,
    share: FloatArray,
    alias: NDArray[np.int32],
    bits: Words,
    b: FloatArray,
    items: NDArray[np.int64],
) -> None:
    """A chunk of cells chosen into ``items``, and uniform numbers into the first rows of ``b``, whose bits
    are ``bits``; the row ``OWN`` is used on the way."""
    moved(state, bits, 3 * CHUNK)
    # What is left of the number that chooses a box chooses between its two items.
    two(bits, U * CHUNK, OWN * CHUNK, CHUNK)
    one(bits, V * CHUNK, 2 * CHUNK)
    count = np.float64(len(share))
    for i in range(CHUNK):
        b[U * CHUNK + i] -= 1.0
        chooses = (b[V * CHUNK + i] - 1.0) * count
        b[V * CHUNK + i] = b[OWN * CHUNK + i] - 1.0
        b[CHANCE * CHUNK + i] -= 1.0
        b[OWN * CHUNK + i] = chooses
    for i in range(CHUNK):
        u = b[OWN * CHUNK + i]
        box = np.int64(u)
        other = np.int64(alias[box])
        items[i] = box if u - box < share[box] else other


@part
def collected(
    b: FloatArray,
    x: int,
    m: int,
    every: bool,
    wo: FloatArray,
    pdf: FloatArray,
    taken: NDArray[np.int64],
    filled: int,
) -> tuple[int, int]:
    """What was accepted of ``m`` candidates, whose rows from ``x`` on are wo and pdf, after ``filled`` draws.

    every : all of them. Returns how many candidates were used, -1 where one is above its majorant, and the
    draws there are now; ``taken`` holds which candidates became draws.
    """
    above, before, room = 0, filled, len(pdf) - filled
    for i in range(m):
        above += np.int64(b[(x + 3) * CHUNK + i] == ABOVE)
    if above > 0:
        return -1, filled
    if every:
        m = min(m, room)
        for i in range(m):
            wo[filled + i, 0] = b[x * CHUNK + i]
            wo[filled + i, 1] = b[(x + 1) * CHUNK + i]
            wo[filled + i, 2] = b[(x + 2) * CHUNK + i]
            pdf[filled + i] = b[(x + 3) * CHUNK + i]
        for i in range(m):
            taken[i] = i
        return m, filled + m
    for i in range(m):
        # Written wherever it may belong, and over that if it was rejected: nobody foresees which will be.
        if filled - before == room:
            return i, filled
        found = b[(x + 3) * CHUNK + i]
        wo[filled, 0] = b[x * CHUNK + i]
        wo[filled, 1] = b[(x + 1) * CHUNK + i]
        wo[filled, 2] = b[(x + 2) * CHUNK + i]
        pdf[filled] = found
        taken[filled - before] = i
        filled += int(found >= 0)
    return m, filled
