"""Draws from an envelope: the accepted ones of a stream of candidates, in their order, on all cores.

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

from fitter.sampling.envelope import Drawable

FloatArray = NDArray[np.float64]
Arrays = tuple[FloatArray, FloatArray, FloatArray | None]

#: Draws with one random stream.
BLOCK = 1 << 16
# Candidates at a time: what is computed of them stays in a core's cache.
_PART = 1 << 13


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
    envelope: Drawable,
    integral: float,
    n: int,
    seed: np.random.SeedSequence,
    channels: int,
    most: int | None,
    each: int,
    at_once: int,
    width: int = 3,
) -> Iterator[Drawn]:
    """``n`` draws, ``at_once`` blocks at a time, in order.

    integral : of what the draws follow.
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
            streams = [np.random.default_rng(_child(seed, k)) for k in some]
            if pool is not None:
                shared = (repeat(one) for one in (each, given_up))
                done = list(pool.map(_fill, repeat(envelope), repeat(integral), streams, parts, *shared))
            else:
                done: list[tuple[int, int, int]] = []
                for rng, part in zip(streams, parts, strict=True):
                    budget = each if most is None else most
                    done.append(_fill(envelope, integral, rng, part, budget, given_up))
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
    envelope: Drawable, integral: float, rng: np.random.Generator, out: Arrays, budget: int, given_up: Event
) -> tuple[int, int, int]:
    """``(tried, hits, filled)`` of filling the arrays of one block.

    given_up : set once a block has used up its candidates: no other one need go on.
    """
    wo, pdf, weight = out
    tried = hits = filled = 0
    hopeful = 1.0
    while filled < len(pdf):
        if tried >= budget or given_up.is_set():
            given_up.set()
            break
        left = len(pdf) - filled
        m = min(left if hopeful == 1 else int(left / hopeful) + 16, _PART, budget - tried)
        found = envelope.draw(rng, m)
        tried += m
        good: slice | NDArray[np.intp] = slice(0, min(m, left))
        count = m
        if found.accepted is not None:
            good = np.flatnonzero(found.accepted)
            count, good = len(good), good[:left]
        hits += count
        hopeful = max(hits / tried, 1e-3)
        density = found.density[good]
        part = slice(filled, filled + len(density))
        steep: FloatArray | float = 1.0 / integral
        for k, column in enumerate(found.wo):
            one = column[good]
            wo[part, k] = one
            if k % 3 == 2:
                steep = steep * one
        np.multiply(density, steep, out=pdf[part])
        if weight is not None:
            values = envelope.channels(tuple(one[good] for one in found.place))
            # f cos / pdf = f / f+ x integral: the cosine cancels, so this stays exact at the horizon.
            np.multiply(values, (integral / density)[:, None], out=weight[part])
        filled += len(density)
    return tried, hits, filled
