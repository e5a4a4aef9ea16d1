"""The global search where some parameters are shared by the channels and others are each channel's own.

In all T = F_shared + C F_own coordinates at once a search is hopeless for three channels already. But one
candidate of the F parameters of a single channel serves every channel with one evaluation of the terms, so a
product of candidates (shared x own) says for each shared candidate which own parameters suit each channel.
From the best of them each channel is solved alone first. The shared values that single channels find, and
those of the best candidates, are then held while each channel's own parameters are solved, and in the end all
are solved together.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitter.fitting import beam, candidates, separable
from fitter.fitting.blocks import Block
from fitter.fitting.chunks import CHUNK
from fitter.fitting.layout import Layout
from fitter.fitting.order import in_order
from fitter.fitting.polish import polish

FloatArray = NDArray[np.float64]
#: Candidates by the number of shared and of own parameters; the last for more.
SHARED, OWN = (32, 64, 128), (16, 32, 64)
#: Starts of each channel alone, channels whose shared values are tried, candidates beside them.
ALONE, PREFERRED, CANDIDATES = 6, 4, 4
#: Passes of the joint solve, at most.
PASSES = 60


def solve(
    layout: Layout, pair: FloatArray, y: FloatArray, weight: FloatArray, solves: int, seed: int
) -> tuple[FloatArray, FloatArray, FloatArray, int]:
    """Local optima from the ``solves`` best starts: u (S, T), objective (S,), inner (S, M, C), and how many
    candidates were screened."""
    count = max(ALONE, solves)
    begin, screened = _screened(layout, pair, y, weight, count, seed)
    grown = _grown(layout, pair, y, weight, count - count // 3)
    if grown is not None:
        begin = np.concatenate([grown, begin])[:count]
    data = [(pair, y[:, c : c + 1], weight[:, c : c + 1]) for c in range(layout.channels)]
    every, own = np.ones(len(layout.free), bool), np.array(layout.own)
    alone = np.stack(
        [_best(layout.alone, begin[:, c], *data[c], every) for c in range(layout.channels)]
    )  # fmt: skip
    # Each channel's own values with the shared ones that it, or another, prefers.
    picked = np.unique(np.linspace(0, layout.channels - 1, PREFERRED).astype(int))
    starts = [np.where(own, alone, alone[c]) for c in picked]
    starts += list(begin[: max(CANDIDATES, solves - len(starts))])
    u = np.empty((len(starts), len(layout.entries)))
    for k, start in enumerate(starts):
        for c in range(layout.channels):
            u[k, layout.where[c]] = _best(layout.alone, start[c][None], *data[c], own)
    objective = np.array(
        [np.sum(np.square(separable.residuals(layout, jnp.asarray(row), pair, y, weight))) for row in u]
    )
    best = np.argsort(np.where(np.isfinite(objective), objective, np.inf), kind="stable")[:solves]
    block = _block(pair, y, weight)
    ends = []
    for row in u[best]:
        inner = np.asarray(separable.inner(layout, jnp.asarray(row), pair, y, weight))
        start = np.concatenate([row, inner.reshape(-1)])
        ends.append(polish(layout, "absolute", np.ones(y.shape[1]), start, [block], PASSES))
    t = len(layout.entries)
    return (
        np.stack([end.p[:t] for end in ends]),
        np.array([end.normal.objective for end in ends]),
        np.stack([end.p[t:].reshape(-1, y.shape[1]) for end in ends]),
        screened,
    )


def _screened(
    layout: Layout, pair: FloatArray, y: FloatArray, weight: FloatArray, count: int, seed: int
) -> tuple[FloatArray, int]:
    """(count, C, F) the best distinct shared candidates, each with what suits each channel of its own."""
    low, high = np.array(layout.lower), np.array(layout.upper)
    shared, own = np.flatnonzero(np.logical_not(layout.own)), np.flatnonzero(layout.own)
    outer = candidates.sobol(len(shared), SHARED[min(len(shared), len(SHARED)) - 1], seed)
    inner = candidates.sobol(len(own), OWN[min(len(own), len(OWN)) - 1], seed + 1)
    cube = np.empty((len(outer), len(inner), len(layout.free)))
    cube[:, :, shared], cube[:, :, own] = outer[:, None], inner[None]
    tried = low + (high - low) * cube
    stride = candidates.stride(pair.shape[1])
    part = (pair[:, ::stride], y[::stride], weight[::stride])
    flat = jnp.asarray(tried.reshape(-1, len(layout.free)))
    cost = np.asarray(separable.screen(layout.alone, flat, *part)).reshape(len(outer), len(inner), -1)
    cost = np.where(np.isfinite(cost), cost, np.inf)
    chosen = candidates.distinct(outer, cost.min(axis=1).sum(axis=1), count)
    suits = cost[chosen].argmin(axis=1)  # (count, C)
    return tried[chosen[:, None], suits], tried.shape[0] * tried.shape[1]


def _grown(
    layout: Layout, pair: FloatArray, y: FloatArray, weight: FloatArray, count: int
) -> FloatArray | None:
    """(S, C, F) starts of several lobes, found for each channel by itself."""
    each: list[FloatArray] = []
    for c in range(layout.channels):
        found = beam.candidates(layout.alone, pair, y[:, c : c + 1], weight[:, c : c + 1], count)
        if found is None:
            return None
        each.append(found)
    return np.stack([found[: min(map(len, each))] for found in each], axis=1)


def _best(
    alone: Layout, starts: FloatArray, pair: FloatArray, y: FloatArray, weight: FloatArray,
    moving: NDArray[np.bool_],
) -> FloatArray:  # fmt: skip
    """The best solution (F,) of one channel from starts (S, F), in order, with those not ``moving`` held."""
    best, least = starts[0], np.inf
    for start in starts:
        # One start at a time: one program serves every call.
        u, cost, _ = separable.solve_many(alone, start[None], pair, y, weight, moving=moving)
        if np.isfinite(u).all() and float(cost[0]) < least:
            best, least = u[0], float(cost[0])
    # Two channels may have found the same surface under different labels.
    return in_order(alone, best) if moving.all() else best


def _block(pair: FloatArray, y: FloatArray, weight: FloatArray) -> Block:
    """The samples as a block of whole chunks."""
    missing = -len(y) % CHUNK
    values, weights = (np.pad(np.asarray(a).T, ((0, 0), (0, missing))) for a in (y, weight))
    padded = np.pad(np.asarray(pair), ((0, 0), (0, missing)), mode="edge")
    return Block(pair=padded, y=values, weight=weights, count=len(y) + missing)
