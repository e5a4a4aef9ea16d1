"""Safeguarded Gauss-Newton passes over the full table, accumulated in chunks on all cores.

One pass evaluates the model and its derivatives once and keeps only the normal equations: no N x P
Jacobian ever exists. The vector is p = [u (T,), inner (M, C) flattened], see :class:`Layout`.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from fitter.fitting import metrics, separable
from fitter.fitting.layout import Layout
from fitter.fitting.samples import Block
from fitter.spec import Metric

FloatArray = NDArray[np.float64]
T = TypeVar("T")
CHUNK = 2_048
#: Passes stop when the objective can fall by less than this many units of its value per degree of
#: freedom: 1e-6 is a thousandth of a standard error.
TOLERANCE = 1e-6
MAX_PASSES = 60


class Normal(NamedTuple):
    """Sums over samples: Gauss-Newton matrix (P, P), descent side -gradient/2 (P,), objective, plain and
    relative squared error for the report, outer products of the samples' scores (P, P)."""

    matrix: FloatArray
    rhs: FloatArray
    objective: float
    squared_error: float
    relative_error: float
    scores: FloatArray


@functools.partial(jax.jit, static_argnames=("layout", "metric"))
def _accumulate(
    layout: Layout, metric: Metric, u: Array, inner: Array, floor: Array, block_pair: Array, y: Array,
    goal: Array, w: Array, chunks: Array,
) -> tuple[Array, ...]:  # fmt: skip
    """Sums over the first ``chunks`` chunks of a block: a traced count, so that one program serves all."""
    (m, c), own = inner.shape, len(layout.free)

    def step(index: Array, carry: tuple[Array, ...]) -> tuple[Array, ...]:
        start = index * CHUNK
        pair = jax.lax.dynamic_slice_in_dim(block_pair, start, CHUNK, axis=1)
        y_ = jax.lax.dynamic_slice_in_dim(y, start, CHUNK)
        goal_ = jax.lax.dynamic_slice_in_dim(goal, start, CHUNK)
        w_ = jax.lax.dynamic_slice_in_dim(w, start, CHUNK)
        f, columns = _columns(layout, u, inner, pair)
        r = metrics.residual(metric, f, goal_, w_, floor)
        used = w_ != 0
        value, slope = jnp.where(used, r.value, 0.0), jnp.where(used, r.slope, 0.0)
        x = columns(slope)  # (C, F + M, n)
        scores = x * value.T[:, None, :]
        flat = jnp.concatenate(
            [_gathered(layout, scores[:, :own]), scores[:, own:].transpose(1, 0, 2).reshape(m * c, CHUNK)]
        )
        plain = jnp.where(used, f - y_, 0.0)
        relative = plain / (jnp.abs(y_) + 10.0 * floor)
        parts = (
            jnp.einsum("cin,cjn->cij", x, x), -scores.sum(axis=2), jnp.sum(value**2), jnp.sum(plain**2),
            jnp.sum(relative**2), flat @ flat.T,
        )  # fmt: skip
        return tuple(a + p for a, p in zip(carry, parts, strict=True))

    p, size = own + m, len(layout.entries) + m * c
    zero = (
        jnp.zeros((c, p, p)), jnp.zeros((c, p)), jnp.zeros(()), jnp.zeros(()), jnp.zeros(()),
        jnp.zeros((size, size)),
    )  # fmt: skip
    return jax.lax.fori_loop(0, chunks, step, zero)


def _columns(
    layout: Layout, u: Array, inner: Array, pair: Array, by_u: bool = True
) -> tuple[Array, Callable[[Array], Array]]:
    """The values (n, C) at pairs (6, n), and what makes of slopes (n, C) the derivatives (C, F + M, n) of
    each channel by its own F nonlinear parameters, where ``by_u``, and by its M inner entries."""
    t, alone = len(layout.free) if by_u else 0, layout.alone
    terms = layout.terms(u, pair)
    b = layout.coefficients(u, inner)
    f = separable.model(layout, terms, b)
    local = u[layout.where] if layout.mixed else u  # (C, F), or (F,) the same for all
    each = 0 if layout.mixed else None

    def by_parameters(v: Array) -> Array:
        return jax.jacfwd(lambda v_: alone.terms(v_, pair))(v)

    if not t:
        slopes = jnp.zeros((*terms.shape, 0))
    else:
        slopes = jax.vmap(by_parameters)(local) if layout.mixed else by_parameters(local)

    def free(terms_c: Array, slopes_c: Array, b_c: Array, slope_c: Array) -> Array:
        return jnp.concatenate([jnp.einsum("knt,k->tn", slopes_c, b_c), terms_c]) * slope_c

    def bound(terms_c: Array, slopes_c: Array, b_c: Array, slope_c: Array, v: Array, l_c: Array) -> Array:
        by_v, by_l = jax.jacfwd(lambda v_, l_: alone.coefficients(v_, l_[:, None])[:, 0], (0, 1))(v, l_c)
        through = jnp.einsum("kn,kt->tn", terms_c, jnp.concatenate([by_v[:, :t], by_l], axis=1))
        return through.at[:t].add(jnp.einsum("knt,k->tn", slopes_c, b_c)) * slope_c

    def columns(slope: Array) -> Array:
        if layout.coefficients_are_free:
            return jax.vmap(free, in_axes=(each, each, 1, 1))(terms, slopes, b, slope)
        return jax.vmap(bound, in_axes=(each, each, 1, 1, each, 1))(terms, slopes, b, slope, local, inner)

    return f, columns


def _gathered(layout: Layout, scores: Array) -> Array:
    """(T, n) scores of the entries of u, from those of the channels' parameters (C, F, n)."""
    if not layout.mixed:
        return scores.sum(0)
    rows = jnp.zeros((len(layout.entries), scores.shape[2]))
    return rows.at[layout.where].add(scores)


def normal_equations(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, blocks: Sequence[Block]
) -> Normal:
    """The sums over all blocks at the vector p."""
    t, c = len(layout.entries), blocks[0].y.shape[1]
    u, inner = p[:t], p[t:].reshape(-1, c)

    def one(block: Block) -> list[FloatArray]:
        chunks = -(-block.count // CHUNK)
        data = (block.pair, block.y, block.goal, block.weight)
        found = _accumulate(layout, metric, u, inner, floor, *data, chunks)
        return [np.asarray(part) for part in found]

    parts = _each(one, blocks)
    sums = [np.sum([part[i] for part in parts], axis=0) for i in range(len(parts[0]))]
    size = len(p)
    matrix, rhs = np.zeros((size, size)), np.zeros(size)
    for channel in range(c):
        own = layout.where[channel if layout.mixed else 0]
        where = np.concatenate([own, t + np.arange(len(inner)) * c + channel])
        matrix[np.ix_(where, where)] += sums[0][channel]
        rhs[where] += sums[1][channel]
    return Normal(matrix, rhs, float(sums[2]), float(sums[3]), float(sums[4]), sums[5])


@functools.partial(jax.jit, static_argnames=("layout", "metric"))
def _moments(
    layout: Layout, metric: Metric, u: Array, inner: Array, floor: Array, pair: Array, goal: Array, w: Array
) -> Array:
    """(2, M, C) sums of the second and fourth powers of the weighted derivatives by the inner vector."""

    def one(item: tuple[Array, Array, Array]) -> Array:
        pair_, goal_, w_ = item
        f, columns = _columns(layout, u, inner, pair_, by_u=False)
        slope = metrics.residual(metric, f, goal_, w_, floor).slope
        energy = jnp.square(columns(jnp.where(w_ != 0, slope, 0.0)))
        return jnp.stack([energy.sum(axis=2).T, jnp.square(energy).sum(axis=2).T])

    count = w.shape[0] // CHUNK
    pairs = pair.reshape(6, count, CHUNK).transpose(1, 0, 2)
    goals, weights = goal.reshape(count, CHUNK, -1), w.reshape(count, CHUNK, -1)
    return jax.lax.map(one, (pairs, goals, weights)).sum(axis=0)


def _each(work: Callable[[Block], T], blocks: Sequence[Block]) -> list[T]:
    """``work`` of every block, on threads: compiled programs release the GIL."""
    if len(blocks) == 1:
        return [work(blocks[0])]
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        return list(pool.map(work, blocks))


def support(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, blocks: Sequence[Block]
) -> FloatArray:
    """(M, C) on how many samples each inner entry effectively lives: (sum x^2)^2 / sum x^4 of the weighted
    derivative x, 1 where one sample carries it all. In a pass of its own: in every pass it would cost two
    thirds more."""
    t, c = len(layout.entries), blocks[0].y.shape[1]
    u, inner = p[:t], p[t:].reshape(-1, c)

    def one(block: Block) -> FloatArray:
        found = _moments(layout, metric, u, inner, floor, block.pair, block.goal, block.weight)
        return np.asarray(found)

    second, fourth = np.sum(_each(one, blocks), axis=0)
    return second**2 / np.maximum(fourth, 1e-300)


@dataclass(frozen=True)
class Polished:
    """The end of the passes: the vector p, its sums, how many passes, whether the tolerance was met."""

    p: FloatArray
    normal: Normal
    passes: int
    converged: bool


def polish(
    layout: Layout, metric: Metric, floor: FloatArray, p: FloatArray, blocks: Sequence[Block],
    max_passes: int = MAX_PASSES,
) -> Polished:  # fmt: skip
    """Levenberg-Marquardt on p = [u, inner] with bounds kept by an active set in every step.

    The part of the Hessian that Gauss-Newton leaves out is learned from the gradients (Dennis, Gay and
    Welsch 1981, NL2SOL): without it a model that fits badly takes fifty passes instead of eight. A step
    is taken only if the objective falls, whatever approximation made it.
    """
    lower, upper = bounds(layout, len(p))
    p = np.clip(p, lower, upper)
    now = normal_equations(layout, metric, floor, p, blocks)
    freedom = max(1, sum(block.count for block in blocks) * blocks[0].y.shape[1] - len(p))
    damping, passes = 0.0, 1
    rest = np.zeros_like(now.matrix)
    while passes < max_passes:
        step, predicted = _step(now.matrix + rest, now.rhs, p, lower, upper, damping)
        if predicted <= TOLERANCE * now.objective / freedom:
            return Polished(p, now, passes, True)
        trial = np.clip(p + step, lower, upper)
        then = normal_equations(layout, metric, floor, trial, blocks)
        passes += 1
        if np.isfinite(then.objective) and then.objective < now.objective:
            rest = _second_order(rest, now, then, trial - p)
            p, now = trial, then
            damping = 0.0 if damping < 1e-6 else damping / 10
        elif np.max(np.abs(step) / (np.abs(p) + 1e-12)) < 1e-13:
            # The step is rounding: the objective is flat to the last digit.
            return Polished(p, now, passes, True)
        else:
            rest = np.zeros_like(rest)
            damping = max(damping * 10, 1e-4)
            if damping > 1e12:
                return Polished(p, now, passes, False)
    return Polished(p, now, passes, False)


def further_fall(layout: Layout, end: Polished) -> float:
    """By how much the objective would fall with one more step, by its quadratic model."""
    lower, upper = bounds(layout, len(end.p))
    return _step(end.normal.matrix, end.normal.rhs, end.p, lower, upper, 0.0)[1]


def _second_order(rest: FloatArray, before: Normal, after: Normal, step: FloatArray) -> FloatArray:
    """NL2SOL's update of the second-order part S so that (J^T J + S) step matches the gradients' change."""
    change = before.rhs - after.rhs  # of the half gradient, which is -rhs
    along = float(change @ step)
    if along <= 0:
        return np.zeros_like(rest)
    wanted = change - after.matrix @ step
    have = float(step @ rest @ step)
    # Sizing: S must not outlive the residuals it was learned from.
    sized = rest * min(1.0, abs(float(step @ wanted)) / abs(have)) if have != 0 else rest
    missing = wanted - sized @ step
    outer = np.outer(missing, change) / along
    return sized + outer + outer.T - float(missing @ step) / along**2 * np.outer(change, change)


def bounds(layout: Layout, size: int) -> tuple[FloatArray, FloatArray]:
    """Bounds of the whole vector: the box of u, and coefficients >= 0 or the box of what they depend on."""
    low, high = layout.box
    rest = size - len(low)
    if layout.coefficients_are_free:
        return np.concatenate([low, np.zeros(rest)]), np.concatenate([high, np.full(rest, np.inf)])
    sides = [np.repeat(side, rest // len(side)) for side in layout.inner_box]
    return np.concatenate([low, sides[0]]), np.concatenate([high, sides[1]])


def _step(
    matrix: FloatArray, rhs: FloatArray, p: FloatArray, lower: FloatArray, upper: FloatArray, damping: float
) -> tuple[FloatArray, float]:
    """The bounded damped step of the quadratic model and by how much the objective falls along it."""
    diagonal = np.diagonal(matrix)
    # A parameter that moves nothing (the roughness of a lobe of no strength) has no curvature.
    scale = np.sqrt(np.where(diagonal > 1e-200, diagonal, 1.0))
    g = matrix / np.outer(scale, scale)
    r = rhs / scale
    # min d.g.d/2 - r.d as least squares on the eigenvectors of g, which survives a singular g.
    values, vectors = np.linalg.eigh(g)
    root = np.sqrt(np.maximum(values, 1e-14) + damping)
    a = root[:, None] * vectors.T
    target = (vectors.T @ r) / root
    room = (np.minimum((lower - p) * scale, 0.0), np.maximum((upper - p) * scale, 0.0))
    free = room[1] - room[0] > 0
    d = np.zeros_like(p)
    if free.any():
        found = lsq_linear(a[:, free], target, bounds=(room[0][free], room[1][free]), method="bvls")
        d[free] = found.x
    return d / scale, float(2.0 * r @ d - np.square(np.sqrt(np.maximum(values, 0.0)) * (vectors.T @ d)).sum())
