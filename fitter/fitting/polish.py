"""Safeguarded Gauss-Newton passes over the full table, accumulated in chunks on all cores.

One pass evaluates the model and its derivatives once and keeps only the normal equations: no N x P
Jacobian ever exists. The vector is p = [u (T,), coefficients (K, C) flattened].
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from fitter.fitting import metrics
from fitter.fitting.layout import Layout
from fitter.fitting.samples import Block
from fitter.spec import Metric

FloatArray = NDArray[np.float64]
CHUNK = 2_048
#: Passes stop when the objective can fall by less than this many units of its value per degree of
#: freedom: 1e-6 is a thousandth of a standard error.
TOLERANCE = 1e-6
MAX_PASSES = 60


class Normal(NamedTuple):
    """Sums over samples. Gauss-Newton matrix (P, P), gradient side (P,), objective, and for the report
    the plain squared error, the relative one, and where asked the outer products of scores (P, P)."""

    matrix: FloatArray
    rhs: FloatArray
    objective: float
    squared_error: float
    relative_error: float
    scores: FloatArray


@functools.partial(jax.jit, static_argnames=("layout", "metric", "with_scores"))
def _accumulate(
    layout: Layout, metric: Metric, u: Array, b: Array, floor: Array, block_pair: Array, y: Array, w: Array,
    with_scores: bool,
) -> tuple[Array, ...]:  # fmt: skip
    t, (k, c) = len(layout.free), b.shape
    chunk = min(CHUNK, y.shape[0])
    count = y.shape[0] // chunk

    def step(carry: tuple[Array, ...], item: tuple[Array, Array, Array]) -> tuple[tuple[Array, ...], None]:
        pair, y_, w_ = item
        terms = layout.terms(u, pair)
        slopes = jax.jacfwd(lambda v: layout.terms(v, pair))(u) if t else jnp.zeros((*terms.shape, 0))
        f = jnp.einsum("kn,kc->nc", terms, b)
        r = metrics.residual(metric, f, y_, w_, floor)
        used = w_ != 0
        value, slope = jnp.where(used, r.value, 0.0), jnp.where(used, r.slope, 0.0)

        def columns(b_c: Array, slope_c: Array) -> Array:
            return jnp.concatenate([jnp.einsum("knt,k->tn", slopes, b_c), terms]) * slope_c

        x = jax.vmap(columns, in_axes=(1, 1))(b, slope)  # (C, T + K, n)
        matrix = jnp.einsum("cin,cjn->cij", x, x)
        rhs = -jnp.einsum("cin,nc->ci", x, value)
        plain = jnp.where(used, f - y_, 0.0)
        relative = plain / (jnp.abs(y_) + 10.0 * floor)
        parts = [matrix, rhs, jnp.sum(value**2), jnp.sum(plain**2), jnp.sum(relative**2)]
        if with_scores:
            s = x * value.T[:, None, :]
            flat = jnp.concatenate([s[:, :t].sum(0), s[:, t:].transpose(1, 0, 2).reshape(k * c, chunk)])
            parts.append(flat @ flat.T)
        return tuple(a + p for a, p in zip(carry, parts, strict=True)), None

    p = t + k
    zero = [jnp.zeros((c, p, p)), jnp.zeros((c, p)), jnp.zeros(()), jnp.zeros(()), jnp.zeros(())]
    if with_scores:
        zero.append(jnp.zeros((t + k * c, t + k * c)))
    items = (
        block_pair.reshape(6, count, chunk).transpose(1, 0, 2),
        y.reshape(count, chunk, c),
        w.reshape(count, chunk, c),
    )
    return jax.lax.scan(step, tuple(zero), items)[0]


def normal_equations(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, blocks: Sequence[Block],
    with_scores: bool = False,
) -> Normal:  # fmt: skip
    """The sums over all blocks at the vector p. Compiled programs release the GIL: blocks run on threads."""
    t, c = len(layout.free), blocks[0].y.shape[1]
    u, b = jnp.asarray(p[:t]), jnp.asarray(p[t:].reshape(-1, c))
    floor_ = jnp.asarray(floor)

    def one(block: Block) -> list[FloatArray]:
        found = _accumulate(layout, metric, u, b, floor_, block.pair, block.y, block.weight, with_scores)
        return [np.asarray(part) for part in found]

    if len(blocks) == 1:
        parts = [one(blocks[0])]
    else:
        with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            parts = list(pool.map(one, blocks))
    sums = [np.sum([part[i] for part in parts], axis=0) for i in range(len(parts[0]))]
    k = b.shape[0]
    size = t + k * c
    matrix, rhs = np.zeros((size, size)), np.zeros(size)
    for channel in range(c):
        where = np.concatenate([np.arange(t), t + np.arange(k) * c + channel])
        matrix[np.ix_(where, where)] += sums[0][channel]
        rhs[where] += sums[1][channel]
    scores = sums[5] if with_scores else np.zeros((0, 0))
    return Normal(matrix, rhs, float(sums[2]), float(sums[3]), float(sums[4]), scores)


@dataclass(frozen=True)
class Polished:
    """The end of the passes: the vector p, its sums, how many passes, whether the tolerance was met."""

    p: FloatArray
    normal: Normal
    passes: int
    converged: bool


def polish(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, blocks: Sequence[Block],
    max_passes: int = MAX_PASSES, on_pass: Callable[[int], None] | None = None,
) -> Polished:  # fmt: skip
    """Levenberg-Marquardt on [u, coefficients] with bounds kept by an active set in every step.

    A step is taken only if the objective falls, whatever approximation made it.
    """
    lower, upper = bounds(layout, len(p))
    p = np.clip(p, lower, upper)
    now = normal_equations(layout, metric, floor, p, blocks)
    freedom = max(1, sum(block.count for block in blocks) * blocks[0].y.shape[1] - len(p))
    damping, passes = 0.0, 1
    while passes < max_passes:
        if on_pass is not None:
            on_pass(passes)
        step, predicted = _step(now, p, lower, upper, damping)
        if predicted <= TOLERANCE * now.objective / freedom:
            return Polished(p, now, passes, True)
        trial = np.clip(p + step, lower, upper)
        then = normal_equations(layout, metric, floor, trial, blocks)
        passes += 1
        if np.isfinite(then.objective) and then.objective < now.objective:
            p, now = trial, then
            damping = 0.0 if damping < 1e-6 else damping / 10
        elif np.max(np.abs(step) / (np.abs(p) + 1e-12)) < 1e-13:
            # The step is rounding: the objective is flat to the last digit.
            return Polished(p, now, passes, True)
        else:
            damping = max(damping * 10, 1e-4)
            if damping > 1e12:
                return Polished(p, now, passes, False)
    return Polished(p, now, passes, False)


def bounds(layout: Layout, size: int) -> tuple[FloatArray, FloatArray]:
    """Bounds of the whole vector: the box of u, and coefficients >= 0."""
    low, high = layout.box
    rest = size - len(layout.free)
    return np.concatenate([low, np.zeros(rest)]), np.concatenate([high, np.full(rest, np.inf)])


def _step(
    normal: Normal, p: FloatArray, lower: FloatArray, upper: FloatArray, damping: float
) -> tuple[FloatArray, float]:
    """The bounded damped Gauss-Newton step and by how much the model of the objective falls along it."""
    scale = np.sqrt(np.maximum(np.diagonal(normal.matrix), 1e-300))
    g = normal.matrix / np.outer(scale, scale)
    g[np.diag_indices_from(g)] += 1e-14 + damping
    r = normal.rhs / scale
    # min d.g.d/2 - r.d as least squares on the eigenvectors of g, which survives a singular g.
    values, vectors = np.linalg.eigh(g)
    root = np.sqrt(np.maximum(values, 1e-14))
    a = root[:, None] * vectors.T
    target = (vectors.T @ r) / root
    room = (np.minimum((lower - p) * scale, 0.0), np.maximum((upper - p) * scale, 0.0))
    fixed = room[1] - room[0] <= 0
    d = np.zeros_like(p)
    if not fixed.all():
        free = ~fixed
        found = lsq_linear(a[:, free], target, bounds=(room[0][free], room[1][free]), method="bvls")
        d[free] = found.x
    undamped = normal.matrix / np.outer(scale, scale)
    return d / scale, float(2.0 * r @ d - d @ undamped @ d)
