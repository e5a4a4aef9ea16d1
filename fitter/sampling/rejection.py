"""Draws from an envelope: slot by slot until each holds an accepted candidate, on all cores.

Every slot is filled by rejection of its own, which is what makes the draws independent; only the rejected
ones are drawn again, so that nothing has to be moved. Draws come in blocks with a random stream of their own
each: the same seed gives the same draws on any number of cores.
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
    """``wo`` (n, 3) or pairs (n, 6); ``density`` (n,) f+, weighted; ``channels`` (n, C), None of one channel.

    tried : candidates; hits : those accepted, used or not; filled : draws made. Fewer than n where the
    candidates allowed were used up.
    """

    wo: FloatArray
    density: FloatArray
    channels: FloatArray | None
    tried: int
    hits: int
    filled: int


def blocks(
    envelope: Drawable,
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
            streams = [np.random.default_rng(_child(seed, k)) for k in some]
            if pool is not None:
                done = list(pool.map(_fill, repeat(envelope), streams, parts, repeat(each), repeat(given_up)))
            else:
                done: list[tuple[int, int, int]] = []
                for rng, part in zip(streams, parts, strict=True):
                    done.append(_fill(envelope, rng, part, each if most is None else most, given_up))
                    most = None if most is None else most - done[-1][0]
            yield Drawn(*whole, *(sum(column) for column in zip(*done, strict=True)))
    finally:
        if pool is not None:
            pool.shutdown(cancel_futures=True)


def _part(whole: Arrays, k: int) -> Arrays:
    mine = slice(k * BLOCK, (k + 1) * BLOCK)
    wo, density, channels = whole
    return wo[mine], density[mine], None if channels is None else channels[mine]


def _child(seed: np.random.SeedSequence, k: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, k))


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _empty(n: int, channels: int, width: int) -> Arrays:
    return np.empty((n, width)), np.empty(n), None if channels == 1 else np.empty((n, channels))


def _fill(
    envelope: Drawable, rng: np.random.Generator, out: Arrays, budget: int, given_up: Event
) -> tuple[int, int, int]:
    """``(tried, hits, filled)`` of filling the arrays of one block.

    given_up : set once a block has used up its candidates: no other one need go on.
    """
    wo, density, channels = out
    tried = hits = filled = 0
    for start in range(0, len(wo), _PART):
        stop = min(start + _PART, len(wo))
        empty = slice(start, stop)
        left = stop - start
        hopeful = 1.0
        while left > 0:
            if tried >= budget or given_up.is_set():
                given_up.set()
                return tried, hits, filled
            # Of a poor envelope so many more candidates that most slots are filled at once.
            m = min(left if hopeful > 0.5 else int(left / max(hopeful, 1e-3)) + 16, _PART, budget - tried)
            found = envelope.draw(rng, m)
            tried += m
            good = np.flatnonzero(found.accepted)
            hits += len(good)
            hopeful = max(len(good) / m, 1e-3)
            if isinstance(empty, slice):
                if m == left and len(good) > 0.5 * m:
                    # All of them, the rejected ones too: those slots are drawn again.
                    wo[empty], density[empty] = found.wo, found.density
                    if channels is not None:
                        channels[empty] = envelope.channels(found.place)
                    empty = start + np.flatnonzero(~found.accepted)
                    filled += len(good)
                    left = len(empty)
                    continue
                empty = np.arange(start, stop)
            take, where = good[:left], empty[: min(len(good), left)]
            wo[where], density[where] = found.wo[take], found.density[take]
            if channels is not None:
                channels[where] = envelope.channels(tuple(part[take] for part in found.place))
            empty = empty[len(where) :]
            filled += len(where)
            left = len(empty)
    return tried, hits, filled
