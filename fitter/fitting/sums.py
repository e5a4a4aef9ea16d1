"""Sums over samples at the end of a fit: errors, outer products of scores, and both by scan.

Made in chunks, as in :mod:`fitter.fitting.polish`; the vector is p = [u (T,), inner (M, C) flattened].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from fitter.fitting import rows, separable
from fitter.fitting.blocks import Block, Blocks
from fitter.fitting.chunks import (
    CHUNK,
    Arrays,
    arrays,
    chunk,
    of_entries,
    residual,
    squared_errors,
    summed,
    values_and_columns,
)
from fitter.fitting.layout import Layout
from fitter.programs import kept
from fitter.spec import Metric

FloatArray = NDArray[np.float64]
#: What 1 - h counts for at least: a sample that a term has to itself has neither residual nor room.
LEAST = 0.05


class Errors(NamedTuple):
    """Sums over samples at the end of a fit: the objective, and squared errors, plain and relative, of
    :func:`fitter.fitting.chunks.squared_errors`."""

    objective: float
    squared: float
    relative: float


def errors(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, blocks: Blocks
) -> Errors:
    """The errors of all blocks at the vector p, in a pass without derivatives."""
    t = len(layout.entries)
    u, inner = p[:t], p[t:].reshape(-1, len(floor))

    def one(block: Block) -> Sequence[Array]:
        chunks = -(-block.count // CHUNK)
        return _errors(layout, metric, u, inner, floor, arrays(block), chunks)

    objective, others = summed(one, blocks)
    return Errors(float(objective), *(float(error) for error in others))


@kept("layout", "metric")
def _errors(
    layout: Layout, metric: Metric, u: Array, inner: Array, floor: Array, block: Arrays, chunks: Array
) -> tuple[Array, Array]:
    def step(index: Array, total: tuple[Array, Array]) -> tuple[Array, Array]:
        pair, y, w = chunk(block, index)
        (terms,) = rows.settled(layout.terms(u, pair))
        f = separable.model(layout, terms, layout.coefficients(u, inner))
        value, _ = residual(metric, f, y, w, floor)
        return total[0] + jnp.vdot(value, value), total[1] + squared_errors(f, y, w, floor)

    return jax.lax.fori_loop(0, chunks, step, (jnp.zeros(()), jnp.zeros(2)))


class Scores(NamedTuple):
    """Sums over samples, or over a part of them that stands for all.

    outer : (P, P) outer products of the samples' scores, each residual over 1 - h. support : (M, C) on how
    many samples each inner entry effectively lives: (sum x^2)^2 / sum x^4 of the weighted derivative x, 1
    where one sample carries it all. degrees : (Q,) of freedom that a parameter's sandwich has.
    """

    outer: FloatArray
    support: FloatArray
    degrees: FloatArray


def scores(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, blocks: Blocks, inverse: FloatArray,
    jacobian: FloatArray, step: float = 1.0,
) -> Scores:  # fmt: skip
    """The scores of the blocks' samples at the vector p.

    inverse : (P, P) of the curvature. It tells the leverages h: a sample that pulls the fit towards itself
    has a small residual whatever its error, so that residuals are divided by 1 - h (HC3; MacKinnon and White
    1985, J. Econom. 29, 305). The channels of a sample may share its error: their pull at shared parameters
    counts together, that at their own for each by itself. Where few samples tell a parameter, its sandwich is
    uncertain itself: a sum of squares with the weights b = a^2 / (1 - h), where a is what an error of the
    sample does to the parameter, has (sum b)^2 / sum b^2 degrees of freedom (Satterthwaite 1946, Biometrics
    Bull. 2, 110; for the sandwich Bell and McCaffrey 2002, Surv. Methodol. 28, 169).
    jacobian : (Q, P) of the parameters in their own units. step : how many samples each stands for.
    """
    t, c = len(layout.entries), len(floor)
    u, inner = p[:t], p[t:].reshape(-1, c)
    own = layout.positions(len(p), c)
    bread = inverse[own[:, :, None], own[:, None, :]]  # (C, F + M, F + M)
    alone = _of_the_channels_own(layout, inverse, own)
    # In units of the u that the curvature alone gives: an open parameter may move by 1e80 of its own unit.
    least = np.sqrt(np.maximum(np.einsum("qp,pr,qr->q", jacobian, inverse, jacobian), 0.0))
    effect = jacobian @ inverse / np.where(least > 0, least, 1.0)[:, None]
    influence = effect[:, own].swapaxes(0, 1)  # (C, Q, F + M)

    def one(block: Block) -> Sequence[Array]:
        chunks = -(-block.count // CHUNK)
        return _scores(layout, metric, u, inner, floor, bread, alone, influence, arrays(block), chunks)

    outer, (x2, x4), (b, b2) = summed(one, blocks)
    return Scores(step * outer, _effective(x2, x4, step), _effective(b, b2, step))


def _of_the_channels_own(layout: Layout, inverse: FloatArray, own: NDArray[np.intp]) -> FloatArray:
    """(C, F + M, F + M) the inverse's rows and columns ``own`` (C, F + M), the parameters that channels share
    held: what is left is of those that each has for itself."""
    shared = np.array([k for k, (_, channel) in enumerate(layout.entries) if channel is None], np.intp)
    common = np.linalg.pinv(inverse[np.ix_(shared, shared)], rcond=1e-12, hermitian=True)
    found = np.zeros((*own.shape, own.shape[1]))
    for c, where in enumerate(own):
        mine = ~np.isin(where, shared)
        rest = where[mine]
        across = inverse[np.ix_(rest, shared)]
        found[c][np.ix_(mine, mine)] = inverse[np.ix_(rest, rest)] - across @ common @ across.T
    return found


def _effective(first: FloatArray, second: FloatArray, step: float) -> FloatArray:
    """How many equal parts make a sum as even as this one, from the sums of parts and of their squares."""
    return step * first**2 / np.maximum(second, 1e-300)


@kept("layout", "metric")
def _scores(
    layout: Layout, metric: Metric, u: Array, inner: Array, floor: Array, bread: Array, alone: Array,
    influence: Array, block: Arrays, chunks: Array,
) -> tuple[Array, Array, Array]:  # fmt: skip
    (m, c), own, q = inner.shape, len(layout.free), influence.shape[1]

    def step(index: Array, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        pair, y, w = chunk(block, index)
        f, columns = values_and_columns(layout, u, inner, pair)
        value, slope = residual(metric, f, y, w, floor)
        x = columns(slope)  # (C, F + M, n)
        # As one einsum this would be a product of vectors of length F + M for each sample.
        whole, part = (jnp.sum(x * jnp.einsum("cij,cjn->cin", by, x), axis=1) for by in (bread, alone))
        room = jnp.maximum(1.0 - part - jnp.sum(whole - part, axis=0), LEAST)
        flat = of_entries(layout, x * (value / room)[:, None, :])
        energy = jnp.square(x[:, own:])
        moments = (energy.sum(axis=2).T, jnp.square(energy).sum(axis=2).T)

        def of_channel(total: Array, here: tuple[Array, Array, Array]) -> tuple[Array, None]:
            return total + (here[0] @ here[1]) / jnp.sqrt(here[2]), None

        # By channel: of many channels the influences of all at once would not fit in memory.
        a, _ = jax.lax.scan(of_channel, jnp.zeros((q, CHUNK)), (influence, x, room))
        b = jnp.square(a)
        spread = jnp.stack([b.sum(axis=1), jnp.square(b).sum(axis=1)])
        return carry[0] + flat @ flat.T, carry[1] + jnp.stack(moments), carry[2] + spread

    size = len(layout.entries) + m * c
    zero = (jnp.zeros((size, size)), jnp.zeros((2, m, c)), jnp.zeros((2, q)))
    return jax.lax.fori_loop(0, chunks, step, zero)


def sample_scores(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, block: Block
) -> tuple[FloatArray, FloatArray]:
    """Residuals (C, n) of the samples of a block at the vector p, and their derivatives (P, C, n) by it."""
    value, slopes = (np.asarray(a) for a in _sample_scores(layout, metric, p, floor, arrays(block)))
    return value[:, : block.count], slopes[:, :, : block.count]


@kept("layout", "metric")
def _sample_scores(
    layout: Layout, metric: Metric, p: Array, floor: Array, block: Arrays
) -> tuple[Array, Array]:
    pair, y, w = (jnp.asarray(part) for part in block)
    t, c = len(layout.entries), floor.shape[0]
    f, columns = values_and_columns(layout, p[:t], p[t:].reshape(-1, c), pair)
    value, slope = residual(metric, f, y, w, floor)
    x = columns(slope)  # (C, F + M, n)
    each = [of_entries(layout, x * (jnp.arange(c) == k)[:, None, None]) for k in range(c)]
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
    padded = np.full(block.y.shape[1], -1)
    padded[: len(label)] = label
    # Few counts of scans are compiled for.
    most = -(-scans // 16) * 16
    found = _scan_sums(layout, metric, p, floor, arrays(block), padded, -(-block.count // CHUNK), most)
    return ScanSums(*(np.asarray(part)[:scans] for part in found))


@kept("layout", "metric", "scans")
def _scan_sums(
    layout: Layout, metric: Metric, p: Array, floor: Array, block: Arrays, label: Array, chunks: Array,
    scans: int,
) -> tuple[Array, Array]:  # fmt: skip
    t = len(layout.entries)

    def step(index: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        pair, y, w = chunk(block, index)
        here = jax.lax.dynamic_slice_in_dim(label, index * CHUNK, CHUNK)
        member = (here[:, None] == jnp.arange(scans)).astype(pair.dtype)

        def scores_of(p_: Array) -> tuple[Array, Array]:
            f, columns = values_and_columns(layout, p_[:t], p_[t:].reshape(-1, floor.shape[0]), pair)
            value, slope = residual(metric, f, y, w, floor)
            found = (of_entries(layout, columns(slope) * value[:, None, :]) @ member).T
            return found, found

        slopes, scores = jax.jacfwd(scores_of, has_aux=True)(p)
        return carry[0] + scores, carry[1] + slopes

    size = len(p)
    return jax.lax.fori_loop(0, chunks, step, (jnp.zeros((scans, size)), jnp.zeros((scans, size, size))))
