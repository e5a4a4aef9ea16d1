"""Safeguarded Gauss-Newton passes over the full table, accumulated in chunks on all cores.

One pass evaluates the model and its derivatives once and keeps only the normal equations: no N x P
Jacobian ever exists. The vector is p = [u (T,), inner (M, C) flattened], see :class:`Layout`.
"""

from __future__ import annotations

import functools
import os
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from fitter.fitting import metrics, separable
from fitter.fitting.layout import Layout
from fitter.fitting.least_squares import MAX_PASSES, TOLERANCE, Solution, foretold, solve
from fitter.fitting.samples import BLOCK, Block, Blocks, count
from fitter.spec import Metric

FloatArray = NDArray[np.float64]
T = TypeVar("T")
#: pair, y, goal, weight of a block.
Column = Array | FloatArray
Arrays = tuple[Column, Column, Column, Column]
CHUNK = 2_048
#: The tolerance of :func:`fitter.fitting.least_squares.solve` where a pass takes time: a hundredth of a
#: standard uncertainty.
COARSE = 1e-4


class Normal(NamedTuple):
    """Sums over samples: Gauss-Newton matrix (P, P), descent side -gradient/2 (P,), objective."""

    matrix: FloatArray
    rhs: FloatArray
    objective: float


@functools.partial(jax.jit, static_argnames=("layout", "metric"))
def _accumulate(
    layout: Layout, metric: Metric, u: Array, inner: Array, floor: Array, block: Arrays, chunks: Array
) -> Array:
    """Sums of products (C, F + M + 1, F + M + 1) of each channel's weighted derivatives and, last, residuals,
    over the first ``chunks`` chunks of a block: a traced count, so that one program serves all."""
    (m, c), own = inner.shape, len(layout.free)

    def step(index: Array, total: Array) -> Array:
        pair, _, goal, w = _chunk(block, index)
        f, columns = _columns(layout, u, inner, pair)
        value, slope = _residual(metric, f.T, goal.T, w.T, floor)
        x = jnp.concatenate([columns(slope), value[:, None, :]], axis=1)
        return total + jnp.einsum("cin,cjn->cij", x, x)

    return jax.lax.fori_loop(0, chunks, step, jnp.zeros((c, own + m + 1, own + m + 1)))


@functools.partial(jax.jit, static_argnames="layout")
def _accumulate_alike(layout: Layout, u: Array, inner: Array, block: Arrays, chunks: Array) -> Array:
    """The same where the channels have the same weights and the metric is a weighted square: the derivatives
    of all of them are combinations of the terms and the terms' slopes."""
    (k, c), own = inner.shape, len(layout.free)
    mix = jnp.zeros((c, own + k, k + k * own))
    mix = mix.at[:, own:, :k].set(jnp.eye(k))
    for t in range(own):
        mix = mix.at[:, t, k + t :: own].set(inner.T)

    def step(index: Array, total: Array) -> Array:
        pair, y, _, w = _chunk(block, index)
        terms, slopes = _with_slopes(layout, u, pair)
        r = separable.model(layout, terms, inner) - y
        rows = jnp.concatenate([terms, slopes.swapaxes(0, 1).reshape(k * own, terms.shape[1]), r.T])
        rows = rows * w.T
        return total + rows @ rows.T

    size = k + k * own
    total = jax.lax.fori_loop(0, chunks, step, jnp.zeros((size + c, size + c)))
    cross = jnp.einsum("cij,jc->ci", mix, total[:size, size:])
    matrix = jnp.einsum("cij,jk,clk->cil", mix, total[:size, :size], mix)
    last = jnp.concatenate([cross, jnp.diagonal(total[size:, size:])[:, None]], axis=1)
    return jnp.concatenate([jnp.concatenate([matrix, cross[:, :, None]], axis=2), last[:, None]], axis=1)


def _chunk(block: Arrays, index: Array) -> tuple[Array, Array, Array, Array]:
    """The samples of one chunk: pair (6, n), y, goal (n, C), weight (n, C) or (n, 1)."""
    def part(column: Column, axis: int = 0) -> Array:
        return jax.lax.dynamic_slice_in_dim(jnp.asarray(column), index * CHUNK, CHUNK, axis)

    return part(block[0], 1), part(block[1]), part(block[2]), part(block[3])


def _residual(metric: Metric, f: Array, goal: Array, w: Array, floor: Array) -> tuple[Array, Array]:
    """The metric's residuals and slopes (C, n) of values f (C, n), 0 where the weight is.

    Channels first: three to a row are no length for the processor's vectors.
    """
    r = metrics.residual(metric, f, goal, w, floor[:, None])
    used = w != 0
    return jnp.where(used, r.value, 0.0), jnp.where(used, r.slope, 0.0)


def _with_slopes(layout: Layout, u: Array, pair: Array) -> tuple[Array, Array]:
    """Terms (K, n) at pairs (6, n) and their derivatives (T, K, n) by u (T,), by linearising once: pushing
    every direction through the whole program takes twice as long."""
    terms, along = jax.linearize(lambda u_: layout.terms(u_, pair), u)
    return terms, jax.vmap(along)(jnp.eye(len(u))) if len(u) else jnp.zeros((0, *terms.shape))


def _columns(
    layout: Layout, u: Array, inner: Array, pair: Array
) -> tuple[Array, Callable[[Array], Array]]:
    """The values (n, C) at pairs (6, n), and what makes of slopes (C, n) the derivatives (C, F + M, n) of
    each channel by its own F nonlinear parameters and by its M inner entries."""
    t, alone = len(layout.free), layout.alone
    b = layout.coefficients(u, inner)
    local = u[layout.where] if layout.mixed else u  # (C, F), or (F,) the same for all
    each = 0 if layout.mixed else None
    look = functools.partial(_with_slopes, alone, pair=pair)
    terms, slopes = jax.vmap(look)(local) if layout.mixed else look(local)
    f = separable.model(layout, terms, b)

    def free(terms_c: Array, slopes_c: Array, b_c: Array, slope_c: Array) -> Array:
        return jnp.concatenate([jnp.einsum("tkn,k->tn", slopes_c, b_c), terms_c]) * slope_c

    def bound(terms_c: Array, slopes_c: Array, b_c: Array, slope_c: Array, v: Array, l_c: Array) -> Array:
        by_v, by_l = jax.jacfwd(lambda v_, l_: alone.coefficients(v_, l_[:, None])[:, 0], (0, 1))(v, l_c)
        through = jnp.einsum("kn,kt->tn", terms_c, jnp.concatenate([by_v[:, :t], by_l], axis=1))
        return through.at[:t].add(jnp.einsum("tkn,k->tn", slopes_c, b_c)) * slope_c

    def columns(slope: Array) -> Array:
        if layout.coefficients_are_free:
            return jax.vmap(free, in_axes=(each, each, 1, 0))(terms, slopes, b, slope)
        return jax.vmap(bound, in_axes=(each, each, 1, 0, each, 1))(terms, slopes, b, slope, local, inner)

    return f, columns


def _flat(layout: Layout, scores: Array) -> Array:
    """(P, n) scores of the entries of the vector p, from those of each channel's parameters and inner entries
    (C, F + M, n)."""
    own, by_inner = len(layout.free), scores[:, len(layout.free) :]
    if layout.mixed:
        by_u = jnp.zeros((len(layout.entries), scores.shape[2])).at[layout.where].add(scores[:, :own])
    else:
        by_u = scores[:, :own].sum(0)
    return jnp.concatenate([by_u, by_inner.transpose(1, 0, 2).reshape(-1, scores.shape[2])])


def normal_equations(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, blocks: Blocks
) -> Normal:
    """The sums over all blocks at the vector p."""
    t, c = len(layout.entries), len(floor)
    u, inner = p[:t], p[t:].reshape(-1, c)
    plain = metric in metrics.QUADRATIC and layout.coefficients_are_free and not layout.mixed

    def one(block: Block) -> FloatArray:
        chunks = -(-block.count // CHUNK)
        if plain and c > 1 and block.weight.shape[1] == 1:
            return np.asarray(_accumulate_alike(layout, u, inner, arrays(block), chunks))
        return np.asarray(_accumulate(layout, metric, u, inner, floor, arrays(block), chunks))

    sums = functools.reduce(np.add, over_blocks(one, blocks))
    size = len(p)
    matrix, rhs = np.zeros((size, size)), np.zeros(size)
    for channel in range(c):
        own = layout.where[channel if layout.mixed else 0]
        where = np.concatenate([own, t + np.arange(len(inner)) * c + channel])
        matrix[np.ix_(where, where)] += sums[channel, :-1, :-1]
        rhs[where] -= sums[channel, -1, :-1]
    return Normal(matrix, rhs, float(sums[:, -1, -1].sum()))


class Errors(NamedTuple):
    """Sums over samples at the end of a fit: the objective, plain and relative squared errors."""

    objective: float
    squared: float
    relative: float


def errors(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, blocks: Blocks
) -> Errors:
    """The errors of all blocks at the vector p, in a pass without derivatives.

    The relative error of a value is that over |y| + 1 % of the typical one.
    """
    t = len(layout.entries)
    u, inner = p[:t], p[t:].reshape(-1, len(floor))

    def one(block: Block) -> FloatArray:
        chunks = -(-block.count // CHUNK)
        return np.asarray(_errors(layout, metric, u, inner, floor, arrays(block), chunks))

    return Errors(*(float(total) for total in functools.reduce(np.add, over_blocks(one, blocks))))


@functools.partial(jax.jit, static_argnames=("layout", "metric"))
def _errors(
    layout: Layout, metric: Metric, u: Array, inner: Array, floor: Array, block: Arrays, chunks: Array
) -> Array:
    def step(index: Array, total: Array) -> Array:
        pair, *columns = _chunk(block, index)
        y, goal, w = (column.T for column in columns)
        f = separable.model(layout, layout.terms(u, pair), layout.coefficients(u, inner)).T
        value, _ = _residual(metric, f, goal, w, floor)
        plain = jnp.where(w != 0, f - y, 0.0)
        relative = plain / (jnp.abs(y) + 10.0 * floor[:, None])
        return total + jnp.stack([jnp.sum(a * a) for a in (value, plain, relative)])

    return jax.lax.fori_loop(0, chunks, step, jnp.zeros(3))


class Scores(NamedTuple):
    """Sums over samples, or over a part of them that stands for all: outer products of the samples' scores
    (P, P), and (M, C) on how many samples each inner entry effectively lives: (sum x^2)^2 / sum x^4 of the
    weighted derivative x, 1 where one sample carries it all."""

    outer: FloatArray
    support: FloatArray


def scores(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, blocks: Blocks,
    step: int = 1,
) -> Scores:  # fmt: skip
    """The scores of the blocks' samples at the vector p; ``step`` : how many samples each stands for."""
    t, c = len(layout.entries), len(floor)
    u, inner = p[:t], p[t:].reshape(-1, c)

    def one(block: Block) -> list[FloatArray]:
        chunks = -(-block.count // CHUNK)
        found = _scores(layout, metric, u, inner, floor, arrays(block), chunks)
        return [np.asarray(part) for part in found]

    outer, second, fourth = (
        functools.reduce(np.add, part) for part in zip(*over_blocks(one, blocks), strict=True)
    )  # fmt: skip
    return Scores(step * outer, step * second**2 / np.maximum(fourth, 1e-300))


@functools.partial(jax.jit, static_argnames=("layout", "metric"))
def _scores(
    layout: Layout, metric: Metric, u: Array, inner: Array, floor: Array, block: Arrays, chunks: Array
) -> tuple[Array, Array, Array]:
    (m, c), own = inner.shape, len(layout.free)

    def step(index: Array, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        pair, _, goal, w = _chunk(block, index)
        f, columns = _columns(layout, u, inner, pair)
        value, slope = _residual(metric, f.T, goal.T, w.T, floor)
        x = columns(slope)  # (C, F + M, n)
        flat = _flat(layout, x * value[:, None, :])
        energy = jnp.square(x[:, own:])
        moments = (energy.sum(axis=2).T, jnp.square(energy).sum(axis=2).T)
        return carry[0] + flat @ flat.T, carry[1] + moments[0], carry[2] + moments[1]

    size = len(layout.entries) + m * c
    zero = (jnp.zeros((size, size)), jnp.zeros((m, c)), jnp.zeros((m, c)))
    return jax.lax.fori_loop(0, chunks, step, zero)


def sample_scores(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, block: Block
) -> tuple[FloatArray, FloatArray]:
    """Residuals (C, n) of the samples of a block at the vector p, and their derivatives (P, C, n) by it."""
    value, slopes = (np.asarray(a) for a in _sample_scores(layout, metric, p, floor, arrays(block)))
    return value[:, : block.count], slopes[:, :, : block.count]


@functools.partial(jax.jit, static_argnames=("layout", "metric"))
def _sample_scores(
    layout: Layout, metric: Metric, p: Array, floor: Array, block: Arrays
) -> tuple[Array, Array]:
    pair, _, goal, w = (jnp.asarray(column) for column in block)
    t, c = len(layout.entries), floor.shape[0]
    f, columns = _columns(layout, p[:t], p[t:].reshape(-1, c), pair)
    value, slope = _residual(metric, f.T, goal.T, w.T, floor)
    x = columns(slope)  # (C, F + M, n)
    each = [_flat(layout, x * (jnp.arange(c) == k)[:, None, None]) for k in range(c)]
    return value, jnp.stack(each, axis=1)


class ScanSums(NamedTuple):
    """Sums over the samples of each of G scans: scores (G, P), half the gradient of the objective, and their
    exact derivatives (G, P, P), in which the slope of the metric moves with the model."""

    scores: FloatArray
    slopes: FloatArray


def scan_sums(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, block: Block, label: NDArray[np.intp],
    scans: int,
) -> ScanSums:  # fmt: skip
    """The sums at the vector p of the samples of a block, (n,) of which ``label`` gives the scan."""
    padded = np.full(len(block.y), -1)
    padded[: len(label)] = label
    # Few counts of scans are compiled for.
    most = -(-scans // 16) * 16
    found = _scan_sums(layout, metric, p, floor, arrays(block), padded, -(-block.count // CHUNK), most)
    return ScanSums(*(np.asarray(part)[:scans] for part in found))


@functools.partial(jax.jit, static_argnames=("layout", "metric", "scans"))
def _scan_sums(
    layout: Layout, metric: Metric, p: Array, floor: Array, block: Arrays, label: Array, chunks: Array,
    scans: int,
) -> tuple[Array, Array]:  # fmt: skip
    t = len(layout.entries)

    def step(index: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        pair, _, goal, w = _chunk(block, index)
        here = jax.lax.dynamic_slice_in_dim(label, index * CHUNK, CHUNK)
        member = (here[:, None] == jnp.arange(scans)).astype(pair.dtype)

        def scores_of(p_: Array) -> tuple[Array, Array]:
            f, columns = _columns(layout, p_[:t], p_[t:].reshape(-1, floor.shape[0]), pair)
            value, slope = _residual(metric, f.T, goal.T, w.T, floor)
            found = (_flat(layout, columns(slope) * value[:, None, :]) @ member).T
            return found, found

        slopes, scores = jax.jacfwd(scores_of, has_aux=True)(p)
        return carry[0] + scores, carry[1] + slopes

    size = len(p)
    return jax.lax.fori_loop(0, chunks, step, (jnp.zeros((scans, size)), jnp.zeros((scans, size, size))))


def arrays(block: Block) -> Arrays:
    """What compiled programs take of a block."""
    return block.pair, block.y, block.goal, block.weight


def over_blocks(work: Callable[[Block], T], blocks: Blocks) -> list[T]:
    """``work`` of every block, on threads: compiled programs release the GIL. A block is made by the thread
    that needs it."""
    if isinstance(blocks, Sequence) and len(blocks) == 1:
        return [work(blocks[0])]
    threads = os.cpu_count() or 1
    with ThreadPoolExecutor(threads) as pool:
        if isinstance(blocks, Sequence):
            return list(pool.map(lambda k: work(blocks[k]), range(len(blocks))))
        done: list[T] = []
        waiting: deque[Future[T]] = deque()
        for block in blocks:
            waiting.append(pool.submit(work, block))
            if len(waiting) > 2 * threads:  # no more than that are held at a time
                done.append(waiting.popleft().result())
        return done + [one.result() for one in waiting]


#: The end of the passes: the vector p, its sums, how many passes, whether the tolerance was met.
Polished = Solution[Normal]


def polish(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, blocks: Blocks,
    max_passes: int = MAX_PASSES,
) -> Polished:  # fmt: skip
    """Damped least squares on p = [u, inner] within its bounds, see :mod:`fitter.fitting.least_squares`."""
    lower, upper = bounds(layout, len(p))
    samples = count(blocks)
    return solve(
        lambda at: normal_equations(layout, metric, floor, at, blocks), p, lower, upper,
        max(1, samples * len(floor) - len(p)), max_passes, TOLERANCE if samples <= BLOCK else COARSE,
    )  # fmt: skip


def further_fall(layout: Layout, end: Polished) -> float:
    """By how much the objective would fall with one more step, by its quadratic model."""
    lower, upper = bounds(layout, len(end.p))
    return foretold(end.normal, end.p, lower, upper)


def bounds(layout: Layout, size: int) -> tuple[FloatArray, FloatArray]:
    """Bounds of the whole vector: the box of u, and coefficients >= 0 or the box of what they depend on."""
    low, high = layout.box
    rest = size - len(low)
    if layout.coefficients_are_free:
        return np.concatenate([low, np.zeros(rest)]), np.concatenate([high, np.full(rest, np.inf)])
    sides = [np.repeat(side, rest // len(side)) for side in layout.inner_box]
    return np.concatenate([low, sides[0]]), np.concatenate([high, sides[1]])
