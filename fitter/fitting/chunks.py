"""Samples by chunks: values, residuals and derivatives of one, and all blocks one after the other.

The vector is p = [u (T,), inner (M, C) flattened], see :class:`Layout`.
"""

from __future__ import annotations

import functools
import os
from collections import deque
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from fitter.fitting import metrics, rows
from fitter.fitting.blocks import Block, Blocks
from fitter.fitting.layout import Layout
from fitter.spec import Metric

FloatArray = NDArray[np.float64]
#: pair, y, weight of a block.
Column = Array | FloatArray
Arrays = tuple[Column, Column, Column]
CHUNK = 2_048


def chunk(block: Arrays, index: Array) -> tuple[Array, Array, Array]:
    """The samples of one chunk: pair (6, n), y (C, n), weight (C, n) or (1, n)."""
    pair, y, w = (
        jax.lax.dynamic_slice_in_dim(jnp.asarray(part), index * CHUNK, CHUNK, axis=1) for part in block
    )  # fmt: skip
    return pair, y, w


def residual(metric: Metric, f: Array, y: Array, w: Array, floor: Array) -> tuple[Array, Array]:
    """The metric's residuals and slopes (C, n) of values f (C, n) from y, 0 where the weight is."""
    r = metrics.residual(metric, f, y, w, floor[:, None])
    used = w != 0
    value, slope = rows.settled(jnp.where(used, r.value, 0.0), jnp.where(used, r.slope, 0.0))
    return value, slope


def squared_errors(f: Array, y: Array, w: Array, floor: Array) -> Array:
    """(2,) sums of the squares of values' errors f - y, (C, n), and of those relative to |y| + 1 % of the
    typical value; of no error where the weight is 0."""
    plain = jnp.where(w != 0, f - y, 0.0)
    relative = plain / (jnp.abs(y) + 10.0 * floor[:, None])
    return jnp.stack([jnp.vdot(a, a) for a in rows.settled(plain, relative)])


def with_slopes(layout: Layout, u: Array, pair: Array) -> tuple[Array, Array]:
    """Terms (K, n) at pairs (6, n) and their derivatives (T, K, n) by u (T,), by linearising once: pushing
    every direction through the whole program takes twice as long."""
    terms, along = jax.linearize(lambda u_: layout.terms(u_, pair), u)
    slopes = jax.vmap(along)(jnp.eye(len(u))) if len(u) else jnp.zeros((0, *terms.shape))
    terms, slopes = rows.settled(terms, slopes)
    return terms, slopes


def values_and_columns(
    layout: Layout, u: Array, inner: Array, pair: Array
) -> tuple[Array, Callable[..., Array]]:
    """The values (C, n) at pairs (6, n), and what makes of slopes (C, n) the derivatives (C, F + M, n) of
    each channel by its own F nonlinear parameters and by its M inner entries, with further rows (C, n)."""
    t, alone = len(layout.free), layout.alone
    b = layout.coefficients(u, inner)  # (K, C)
    local = u[layout.where] if layout.mixed else u  # (C, F), or (F,) the same for all
    look = functools.partial(with_slopes, alone, pair=pair)
    # (C, K, n) and (C, F, K, n), with one instead of C where the channels share them.
    terms, slopes = jax.vmap(look)(local if layout.mixed else local[None])
    f = rows.combined(terms, b.T)

    def of_channel(v: Array, l_c: Array) -> Array:
        """(K, F + M) the derivatives of a channel's coefficients."""
        by_v, by_l = jax.jacfwd(lambda v_, l_: alone.coefficients(v_, l_[:, None])[:, 0], (0, 1))(v, l_c)
        return jnp.concatenate([by_v[:, :t], by_l], axis=1)

    def columns(slope: Array, *further: Array) -> Array:
        found = [rows.combined(slopes[:, k], b.T) for k in range(t)]
        if layout.coefficients_are_free:
            found += [terms[:, m] for m in range(len(inner))]
        else:
            by = jax.vmap(of_channel, (0 if layout.mixed else None, 1))(local, inner)
            through = [rows.combined(terms, by[:, :, k]) for k in range(t + len(inner))]
            found = [a + b for a, b in zip(found, through, strict=False)] + through[t:]
        return rows.stacked([row * slope for row in found] + list(further))

    return f, columns


def of_entries(layout: Layout, scores: Array) -> Array:
    """(P, n) scores of the entries of the vector p, from those of each channel's parameters and inner entries
    (C, F + M, n)."""
    own, by_inner = len(layout.free), scores[:, len(layout.free) :]
    if layout.mixed:
        by_u = jnp.zeros((len(layout.entries), scores.shape[2])).at[layout.where].add(scores[:, :own])
    else:
        by_u = scores[:, :own].sum(0)
    return jnp.concatenate([by_u, by_inner.transpose(1, 0, 2).reshape(-1, scores.shape[2])])


def arrays(block: Block) -> Arrays:
    """What compiled programs take of a block."""
    return block.pair, block.y, block.weight


def over_blocks(work: Callable[[Block], Sequence[Array]], blocks: Blocks) -> list[list[FloatArray]]:
    """What the program that ``work`` calls makes of each block.

    XLA computes on threads of its own: the next block is made meanwhile. Threads that make a block each and
    wait for its results take a third longer, for the interpreter's lock.
    """
    done: list[list[FloatArray]] = []
    # XLA reads a block in place: nothing may write to it before its results are there. So many at a time.
    running: deque[tuple[Block, Sequence[Array]]] = deque()

    def take() -> None:
        _, found = running.popleft()
        done.append([np.asarray(part) for part in found])

    for block in blocks:
        running.append((block, work(block)))
        if len(running) > (os.cpu_count() or 1):
            take()
    while running:
        take()
    return done


def summed(work: Callable[[Block], Sequence[Array]], blocks: Blocks) -> list[FloatArray]:
    """The sums over all blocks of what the program that ``work`` calls makes of each."""
    return [functools.reduce(np.add, parts) for parts in zip(*over_blocks(work, blocks), strict=True)]
