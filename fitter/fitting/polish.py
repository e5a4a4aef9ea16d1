"""Safeguarded Gauss-Newton passes over the full table, accumulated in chunks on all cores.

One pass evaluates the model and its derivatives once and keeps only the normal equations: no N x P
Jacobian ever exists. The vector is p = [u (T,), inner (M, C) flattened], see :class:`Layout`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from fitter.fitting import metrics, rows, separable
from fitter.fitting.blocks import BLOCK, Block, Blocks, count
from fitter.fitting.chunks import (
    CHUNK,
    Arrays,
    arrays,
    chunk,
    residual,
    squared_errors,
    summed,
    values_and_columns,
    with_slopes,
)
from fitter.fitting.layout import Layout
from fitter.fitting.least_squares import MAX_PASSES, TOLERANCE, Solution, foretold, solve
from fitter.programs import kept
from fitter.spec import Metric

FloatArray = NDArray[np.float64]
#: The tolerance of :func:`fitter.fitting.least_squares.solve` where a pass takes time: a hundredth of a
#: standard uncertainty.
COARSE = 1e-4


class Normal(NamedTuple):
    """Sums over samples: Gauss-Newton matrix (P, P), descent side -gradient/2 (P,), objective, and squared
    errors, plain and relative, of :func:`fitter.fitting.chunks.squared_errors`: what a pass ends with needs
    no pass of its own."""

    matrix: FloatArray
    rhs: FloatArray
    objective: float
    squared: float
    relative: float


@kept("layout", "metric")
def _accumulate(
    layout: Layout, metric: Metric, u: Array, inner: Array, floor: Array, block: Arrays, chunks: Array
) -> tuple[Array, Array]:
    """Sums of products (C, F + M + 1, F + M + 1) of each channel's weighted derivatives and, last, residuals,
    over the first ``chunks`` chunks of a block: a traced count, so that one program serves all. And the
    squared errors (2,)."""
    (m, c), own = inner.shape, len(layout.free)

    def step(index: Array, total: tuple[Array, Array]) -> tuple[Array, Array]:
        pair, y, w = chunk(block, index)
        f, columns = values_and_columns(layout, u, inner, pair)
        value, slope = residual(metric, f, y, w, floor)
        x = columns(slope, value)
        return total[0] + jnp.einsum("cin,cjn->cij", x, x), total[1] + squared_errors(f, y, w, floor)

    size = own + m + 1
    return jax.lax.fori_loop(0, chunks, step, (jnp.zeros((c, size, size)), jnp.zeros(2)))


@kept("layout")
def _accumulate_alike(
    layout: Layout, u: Array, inner: Array, floor: Array, block: Arrays, chunks: Array
) -> tuple[Array, Array]:
    """The same where the channels have the same weights and the metric is a weighted square: the derivatives
    of all of them are combinations of the terms and the terms' slopes."""
    (k, c), own = inner.shape, len(layout.free)
    mix = jnp.zeros((c, own + k, k + k * own))
    mix = mix.at[:, own:, :k].set(jnp.eye(k))
    for t in range(own):
        mix = mix.at[:, t, k + t :: own].set(inner.T)

    def step(index: Array, total: tuple[Array, Array]) -> tuple[Array, Array]:
        pair, y, w = chunk(block, index)
        terms, slopes = with_slopes(layout, u, pair)
        f = separable.model(layout, terms, inner)
        of_k = slopes.swapaxes(0, 1).reshape(k * own, terms.shape[1])
        x = rows.joined([part * w for part in (terms, of_k, f - y)])
        return total[0] + x @ x.T, total[1] + squared_errors(f, y, w, floor)

    size = k + k * own
    total, squared = jax.lax.fori_loop(
        0, chunks, step, (jnp.zeros((size + c, size + c)), jnp.zeros(2))
    )
    cross = jnp.einsum("cij,jc->ci", mix, total[:size, size:])
    matrix = jnp.einsum("cij,jk,clk->cil", mix, total[:size, :size], mix)
    last = jnp.concatenate([cross, jnp.diagonal(total[size:, size:])[:, None]], axis=1)
    whole = jnp.concatenate([jnp.concatenate([matrix, cross[:, :, None]], axis=2), last[:, None]], axis=1)
    return whole, squared


def normal_equations(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, blocks: Blocks
) -> Normal:
    """The sums over all blocks at the vector p."""
    t, c = len(layout.entries), len(floor)
    u, inner = p[:t], p[t:].reshape(-1, c)
    plain = metric in metrics.QUADRATIC and layout.coefficients_are_free and not layout.mixed

    def one(block: Block) -> Sequence[Array]:
        chunks = -(-block.count // CHUNK)
        if plain and c > 1 and len(block.weight) == 1:
            return _accumulate_alike(layout, u, inner, floor, arrays(block), chunks)
        return _accumulate(layout, metric, u, inner, floor, arrays(block), chunks)

    sums, errors = summed(one, blocks)
    size = len(p)
    matrix, rhs = np.zeros((size, size)), np.zeros(size)
    for channel, where in enumerate(layout.positions(size, c)):
        matrix[np.ix_(where, where)] += sums[channel, :-1, :-1]
        rhs[where] -= sums[channel, -1, :-1]
    return Normal(matrix, rhs, float(sums[:, -1, -1].sum()), *(float(error) for error in errors))


#: The end of the passes: the vector p, its sums, how many passes, whether the tolerance was met.
Polished = Solution[Normal]


def polish(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, blocks: Blocks,
    max_passes: int = MAX_PASSES, rest: FloatArray | None = None,
) -> Polished:  # fmt: skip
    """Damped least squares on p = [u, inner] within its bounds, see :mod:`fitter.fitting.least_squares`.

    rest : the second-order part that other samples of the table have taught, (P, P).
    """
    lower, upper = bounds(layout, len(p))
    samples = count(blocks)
    return solve(
        lambda at: normal_equations(layout, metric, floor, at, blocks), p, lower, upper,
        max(1, samples * len(floor) - len(p)), max_passes, TOLERANCE if samples <= BLOCK else COARSE, rest,
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
