"""Candidates inside kernels, a chunk at a time: step by step, each step a loop that the compiler turns into
vector instructions, over rows of one array that stays in the first cache.

Row k of a chunk is ``b[k * CHUNK + i]`` for the candidates i.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import part
from fitter.kernels.uniform import State, two, uniform

FloatArray = NDArray[np.float64]

#: Candidates of a chunk.
CHUNK = 128
#: The first rows: two numbers for the place in a cell, one for the test, then what is known of the cell.
U, V, CHANCE, CELL = 0, 1, 2, 3
#: Instead of a pdf: of a candidate that was rejected, and of one above its majorant.
REJECTED, ABOVE = -1.0, -2.0


@part
def proposed(
    r: State,
    share: FloatArray,
    alias: NDArray[np.int32],
    cells: FloatArray,
    columns: int,
    items: NDArray[np.int64],
    b: FloatArray,
    m: int,
) -> State:
    """``m`` cells chosen into ``items``, uniform numbers and the cells' first ``columns`` into the rows of
    ``b``."""
    for i in range(m):
        b[CHANCE * CHUNK + i], r = uniform(r)
        b[U * CHUNK + i], b[V * CHUNK + i], r = two(r)
        # What is left of the number that chooses a box chooses between its two items.
        u, r = uniform(r)
        u *= len(share)
        box = np.int64(u)
        items[i] = box
        b[CELL * CHUNK + i] = u - box
    for i in range(m):
        box = items[i]
        other = np.int64(alias[box])
        items[i] = box if b[CELL * CHUNK + i] < share[box] else other
    for i in range(m):
        item = items[i]
        for c in range(columns):
            b[(CELL + c) * CHUNK + i] = cells[item, c]
    return r


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

    Returns how many candidates were used, -1 where one is above its majorant, and the draws there are now;
    ``taken`` holds which candidates became draws.
    """
    before = filled
    for i in range(m):
        if filled == len(pdf):
            return i, filled
        found = b[(x + 3) * CHUNK + i]
        if found == ABOVE:
            return -1, filled
        wo[filled, 0] = b[x * CHUNK + i]
        wo[filled, 1] = b[(x + 1) * CHUNK + i]
        wo[filled, 2] = b[(x + 2) * CHUNK + i]
        pdf[filled] = found
        taken[filled - before] = i
        filled += 1 if every or found >= 0 else 0
    return m, filled
