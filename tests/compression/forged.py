"""Tiles of bytes that no encoder wrote, for the decoder's kernels, which check no bounds themselves.

As a program, ``python -m tests.compression.forged``, it runs where NUMBA_BOUNDSCHECK=1 makes them check: an
access beyond an array is an IndexError there.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np

from fitter.compression import entropy, tile
from fitter.compression.archive import pack_parts, unpack_parts

#: Channels and nodes: one value, one node, one axis of many, rows longer than a run, rows along other axes.
SHAPES = (
    (1, 1), (3, 1, 1, 1), (1, 2), (2, 1300), (1, 3, 1201), (1, 1201, 2), (2, 5, 7, 40), (3, 9, 6, 5),
    (1, 2, 2, 2, 2),
)  # fmt: skip
CLASSES = 48


def forged(rng: np.random.Generator, shape: tuple[int, ...]) -> tuple[bytes, np.ndarray | None]:
    """A tile of random content, whose parts have the lengths of one, and which of its nodes are good."""
    kind = rng.choice(list("FDfd"))
    size = 4 if kind == "F" else 8
    nodes = int(np.prod(shape))
    start = rng.bytes(size * shape[0]) if rng.random() < 0.5 else bytes(size * shape[0])
    # Rules that are read are 0 to 5 and 0 or 1; anything else is one of those, too.
    rules = rng.integers(0, 256 if rng.random() < 0.3 else 6, rng.integers(0, 4000)).astype(np.uint8)
    table = rng.integers(0, 256, (CLASSES, 4))
    table[:, 0] = np.arange(CLASSES)
    table[:, 2] %= len(entropy.EXPONENTS)
    if rng.random() < 0.5:
        table[:, 3] = rng.integers(256)
    bits = rng.bytes(int(rng.integers(0, 4 * nodes + 2)))
    words = rng.bytes(4 * int(rng.integers(0, nodes + 9)))
    head = str(kind).encode() + bytes([rng.integers(256)]) + start
    share = rng.choice([-1.0, 0.0, 0.5, 0.99])
    good = None if share < 0 else rng.random(shape) < share
    return pack_parts([head, rules.tobytes(), table.astype(np.uint8).tobytes(), bits, words]), good


def changed(rng: np.random.Generator, data: bytes) -> bytes:
    """A tile with bytes changed or lost in one of its parts."""
    parts = [bytearray(part) for part in unpack_parts(data, 5)]
    which = parts[rng.integers(len(parts))]
    for place in rng.integers(0, len(which), rng.integers(1, 5)) if which else ():
        which[place] = rng.integers(256)
    if rng.random() < 0.3:
        del which[rng.integers(len(which) + 1) :]
    return pack_parts([bytes(part) for part in parts])


def steps(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """What an encoder takes, gaps included."""
    found = rng.normal(0, rng.choice([0.2, 30.0, 1e4]), shape).cumsum(axis=-1)
    found[rng.random(shape) < rng.choice([0.0, 0.0, 0.2, 1.0])] = np.nan
    return found


def outcomes(seed: int, trials: int) -> Iterator[bool]:
    """Whether each tile was one after all. Anything but ValueError is raised."""
    rng = np.random.default_rng(seed)
    for trial in range(trials):
        shape = SHAPES[trial % len(SHAPES)]
        if trial % 2:
            data, good = forged(rng, shape)
        else:
            number = steps(rng, shape)
            there = np.isfinite(number)
            good = None if there.all() else there
            data, back = tile.encode(number)
            assert np.abs(back - number)[there].max(initial=0.0) < 0.51
            data = changed(rng, data)
        try:
            tile.decode(data, shape, good)
        except ValueError:
            yield False
        else:
            yield True


if __name__ == "__main__":
    found = list(outcomes(int(sys.argv[1]), int(sys.argv[2])))
    print(sum(found), len(found))
