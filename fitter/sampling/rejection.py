"""Draws in blocks, on all cores.

Draws come in blocks with a random stream of their own each: the same seed gives the same draws on any number
of cores.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from threading import Event

import numpy as np
from numpy.typing import NDArray

from fitter.sampling.drawing import Arrays, Drawable

FloatArray = NDArray[np.float64]

#: Draws with one random stream.
BLOCK = 1 << 16


@dataclass(frozen=True)
class Drawn:
    """``wo`` (n, 3) or pairs (n, 6); ``pdf`` (n,); ``weight`` (n, C), None of one channel: it is constant.

    tried : candidates; hits : those accepted, used or not; filled : draws made. Fewer than n where the
    candidates allowed were used up.
    """

    wo: FloatArray
    pdf: FloatArray
    weight: FloatArray | None
    tried: int
    hits: int
    filled: int


def blocks(
    source: Drawable,
    n: int,
    seed: np.random.SeedSequence,
    channels: int,
    most: int | None,
    each: int,
    at_once: int,
    width: int = 3,
) -> Iterator[Drawn]:
    """``n`` draws, ``at_once`` blocks at a time, in order.

    most : candidates allowed in all: blocks then come one after another, so that each knows what is left.
    each : candidates allowed to a block otherwise. width : numbers of a candidate (6 for pairs wi, wo).
    """
    count = -(-n // BLOCK)
    sizes = [min(BLOCK, n - k * BLOCK) for k in range(min(count, at_once))]
    workers = 1 if most is not None else min(_cores(), len(sizes))
    pool = ThreadPoolExecutor(workers) if workers > 1 else None
    given_up = Event()
    try:
        for start in range(0, count, at_once):
            some = range(start, min(start + at_once, count))
            whole = _empty(sum(min(BLOCK, n - k * BLOCK) for k in some), channels, width)
            parts = [_part(whole, k - start) for k in some]
            streams = [_child(seed, k) for k in some]
            if pool is not None:
                done = list(pool.map(_fill, repeat(source), streams, parts, repeat(each), repeat(given_up)))
            else:
                done: list[tuple[int, int, int]] = []
                for stream, part in zip(streams, parts, strict=True):
                    budget = each if most is None else most
                    done.append(_fill(source, stream, part, budget, given_up))
                    most = None if most is None else most - done[-1][0]
            yield Drawn(*whole, *(sum(column) for column in zip(*done, strict=True)))
    finally:
        if pool is not None:
            pool.shutdown(cancel_futures=True)


def _part(whole: Arrays, k: int) -> Arrays:
    mine = slice(k * BLOCK, (k + 1) * BLOCK)
    wo, pdf, weight = whole
    return wo[mine], pdf[mine], None if weight is None else weight[mine]


def _child(seed: np.random.SeedSequence, k: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, k))


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _empty(n: int, channels: int, width: int) -> Arrays:
    return np.empty((n, width)), np.empty(n), None if channels == 1 else np.empty((n, channels))


def _fill(
    source: Drawable, seed: np.random.SeedSequence, out: Arrays, budget: int, given_up: Event
) -> tuple[int, int, int]:
    """One block. given_up : set once a block has used up its candidates: no other one need go on."""
    done = source.fill(seed, out, budget, given_up)
    if done[2] < len(out[1]):
        given_up.set()
    return done
