"""Covariance of the estimates: the curvature where the metric is the likelihood, the sandwich elsewhere.

Sandwich (Huber 1967, White 1980): H^-1 (sum of score outer products) H^-1, scores summed over the
channels of a sample first, since the channels of one sample share its errors, and freed of the samples' own
pull on the fit, see :func:`fitter.fitting.sums.scores`.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from fitter.directions import vector_from_spherical
from fitter.fitting import separable
from fitter.fitting.candidates import sobol
from fitter.fitting.layout import Layout
from fitter.fitting.order import azimuths
from fitter.fitting.polish import Normal, bounds
from fitter.fitting.sums import Scores

FloatArray = NDArray[np.float64]
#: A direction whose scaled curvature is below this share of the largest is not identified.
SINGULAR = 1e-10
#: An entry that moves the fitted values by less than this share of their norm does nothing.
NOTHING = 1e-7
#: Samples a term has to live on, at least, for its parameters to be more than those samples' values.
SUPPORT = 3.0
#: Standard uncertainties that an anisotropy e has to differ from none for its azimuth psi to mean anything:
#: (e cos 2 psi, e sin 2 psi) is what is measured, so that u(psi) = u(e)/(2 e).
SIGNIFICANT = 3.0


@dataclass(frozen=True)
class Natural:
    """The estimates in the parameters' own units.

    labels : flat, "ks[1]" with the channel's position; a bare name when shared.
    values, at_bound : (Q,). covariance : (Q, Q), NaN where none is stated. degrees : (Q,) of freedom of its
    variances. unidentified : labels whose values the data leave open.
    """

    labels: tuple[tuple[str, int | None], ...]
    values: FloatArray
    covariance: FloatArray
    degrees: FloatArray
    at_bound: tuple[str | None, ...]
    unidentified: tuple[int, ...]


@dataclass(frozen=True)
class Curvature:
    """What the normal equations tell of an end.

    p : (P,) the vector, with what is on a bound put exactly there. free : (P,) what is not. inverse : (P, P)
    of the curvature, zero for what is not free. open : (P, m) directions that the data leave open.
    values, jacobian : (Q,) the parameters in their own units and their derivatives (Q, P).
    """

    p: FloatArray
    free: NDArray[np.bool_]
    inverse: FloatArray
    open: FloatArray
    values: FloatArray
    jacobian: FloatArray


def curvature(layout: Layout, p: FloatArray, normal: Normal, c: int) -> Curvature:
    """The curvature at the vector p of a group of c channels, from its normal equations."""
    p, matrix, free = settled(layout, p, normal, c)
    values, jacobian = (np.asarray(a) for a in to_natural(layout, c, p))
    return Curvature(p, free, *_inverse(matrix, free), values, jacobian)


def natural(
    layout: Layout, curve: Curvature, scores: Scores, channels: Sequence[int], likelihood: bool
) -> Natural:
    """Estimates and covariance of one group from the curvature at its end.

    scores : of the samples, see :func:`fitter.fitting.sums.scores`.
    likelihood : whether the metric is the likelihood; the sandwich is used where it is not.
    """
    t, c = len(layout.entries), len(channels)
    linear = [q for q in layout.linear for _ in channels]
    count = len(linear)
    alone = None if c > 1 else channels[0]
    labels: list[tuple[str, int | None]] = [
        *((q.name, channel) for q in layout.linear for channel in channels),
        *((layout.free[k], alone if own is None else channels[own]) for k, own in layout.entries),
    ]

    p, free, values, jacobian, open_directions = curve.p, curve.free, curve.values, curve.jacobian, curve.open
    cov = curve.inverse if likelihood else curve.inverse @ scores.outer @ curve.inverse
    spread = jacobian @ cov @ jacobian.T
    degrees = np.full(len(labels), np.inf) if likelihood else scores.degrees
    low, high = layout.box
    at_bound: list[str | None] = [
        "lower" if value <= q.lower else "upper" if value >= q.upper else None
        for q, value in zip(linear, values, strict=False)
    ]
    for k in range(t):
        at_bound.append(None if free[k] else "lower" if 2 * p[k] < low[k] + high[k] else "upper")
    # A parameter is open if any of the directions that the data leave open moves it.
    moved = np.abs(jacobian @ open_directions)
    size = np.linalg.norm(jacobian, axis=1, keepdims=True) + 1e-300
    unidentified = [k for k in range(len(labels)) if (moved[k] > 1e-3 * size[k]).any()]
    # A lobe between the samples fits any one of them: its curvature says nothing of its uncertainty.
    thin = (scores.support < SUPPORT).reshape(-1) & (p[t:] > 0)
    reached = np.abs(jacobian[:, t:][:, thin]) * p[t:][thin] > 1e-3 * np.abs(values)[:, None]
    narrow = [k for k in range(count) if reached[k].any()]
    for k, (_, own) in enumerate(layout.entries):
        if any(own is None or labels[n][1] == channels[own] for n in narrow):
            narrow.append(count + k)
    # The azimuth of a surface without a direction is anybody's.
    directed = 1.0 / (2.0 * SIGNIFICANT)
    turning = [count + int(e) for e in azimuths(layout) if not spread[count + e, count + e] < directed**2]
    unidentified = sorted({*unidentified, *narrow, *turning})
    for k, bound in enumerate(at_bound):
        if bound is not None or k in unidentified:
            spread[k, :] = spread[:, k] = np.nan
    return Natural(tuple(labels), values, spread, degrees, tuple(at_bound), tuple(unidentified))


def settled(
    layout: Layout, p: FloatArray, normal: Normal, c: int
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """The vector with what is on a bound put exactly there, the matrix (P, P) with flat parameters exactly
    flat, and which entries are free.

    "On" and "flat" are judged by what the entry does to the fitted values, relative to their norm in its
    channel: coefficients have no scale of their own.
    """
    t = len(layout.entries)
    p, matrix = p.copy(), normal.matrix.copy()
    lower, upper = bounds(layout, len(p))
    effect = np.sqrt(np.maximum(np.diagonal(matrix), 0.0))
    share = (np.abs(p[t:]) * effect[t:]).reshape(-1, c)
    nothing = np.tile(NOTHING * np.maximum(share.max(axis=0), 1e-300), len(share))
    # There is no upper bound to be on where it is infinite, even where the effect is 0.
    bounded = np.isfinite(upper[t:])
    beyond = np.where(bounded, upper[t:], p[t:]) - p[t:]
    p[t:] = np.where(bounded & (beyond * effect[t:] <= nothing), upper[t:], p[t:])
    p[t:] = np.where((p[t:] - lower[t:]) * effect[t:] <= nothing, lower[t:], p[t:])
    span = upper[:t] - lower[:t]
    inside = (p[:t] > lower[:t] + 1e-5 * span) & (p[:t] < upper[:t] - 1e-5 * span)
    flat = np.concatenate([effect[:t] * span <= nothing.max(), np.zeros(len(p) - t, bool)])
    # What does nothing may have come to lie anywhere: that it is on a bound means nothing either. What only
    # stands still there, as an even function of its parameter does at 0, is on it.
    idle = flat[:t]
    if (idle & ~inside).any():
        idle = idle & (inside | ~_stirs(layout, p, c))
    free = np.concatenate([inside | idle, (p[t:] > lower[t:]) & (p[t:] < upper[t:])])
    matrix[flat, :] = matrix[:, flat] = 0.0
    return p, matrix, free


def _stirs(layout: Layout, p: FloatArray, c: int) -> NDArray[np.bool_]:
    """(T,) whether putting an entry into the middle of its range changes the values at all."""
    t = len(layout.entries)
    inner = jnp.asarray(p[t:].reshape(-1, c))
    here = separable.values(layout, jnp.asarray(p[:t]), inner, _some_pairs())
    middle, found = np.mean(layout.box, axis=0), np.zeros(t, bool)
    for k in range(t):
        moved = p[:t].copy()
        moved[k] = middle[k]
        there = separable.values(layout, jnp.asarray(moved), inner, _some_pairs())
        found[k] = bool(np.any(np.abs(there - here) > NOTHING * np.abs(here)))
    return found


def _some_pairs() -> FloatArray:
    """(6, n) components of pairs of directions all over the hemispheres."""
    angles = sobol(4, 256, seed=0) * np.array([0.5, 2.0, 0.5, 2.0]) * np.pi
    w = [vector_from_spherical(*angles[:, k : k + 2].T) for k in (0, 2)]
    return np.concatenate([part.T for part in w])


@functools.partial(jax.jit, static_argnames=("layout", "c"))
def to_natural(layout: Layout, c: int, p: Array) -> tuple[Array, Array]:
    """The parameters in their own units (Q,), linear ones first, and their derivatives (Q, P).

    c : channels of the group.
    """
    t = len(layout.entries)
    logs = np.array([layout.logs[k] for k, _ in layout.entries], bool)

    def convert(vector: Array) -> tuple[Array, Array]:
        u, inner = vector[:t], vector[t:].reshape(-1, c)
        found = layout.linear_values(u, inner)
        nonlinear = jnp.where(logs, jnp.exp(jnp.where(logs, u, 0.0)), u)
        values = jnp.concatenate([*(found[q.name] for q in layout.linear), nonlinear])
        return values, values

    jacobian, values = jax.jacfwd(convert, has_aux=True)(p)
    return values, jacobian


def _inverse(whole: FloatArray, free: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Pseudo-inverse (P, P) of the curvature, zero for what sits on a bound, and open directions (P, m)."""
    size = len(free)
    inverse = np.zeros((size, size))
    where = np.flatnonzero(free)
    matrix = whole[np.ix_(where, where)]
    scale = np.sqrt(np.maximum(np.diagonal(matrix), 0.0))
    flat = scale <= 0
    scale = np.where(flat, 1.0, scale)
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    weak = values < SINGULAR * max(values.max(initial=0.0), 1e-300)
    inverse[np.ix_(where, where)] = (
        (vectors[:, ~weak] / values[~weak]) @ vectors[:, ~weak].T / np.outer(scale, scale)
    )
    directions = np.zeros((size, int(weak.sum())))
    directions[where] = vectors[:, weak] / scale[:, None]
    lengths = np.linalg.norm(directions, axis=0)
    return inverse, directions / np.where(lengths > 0, lengths, 1.0)
