"""The best chi-square that brute force finds, for :mod:`tests.evidence.global_optimum`."""

from __future__ import annotations

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray
from scipy.stats import qmc

from fitter import Table
from fitter.fitting import separable
from fitter.fitting.layout import Layout
from fitter.fitting.least_squares import solve
from tests.fitting.strd import Sums

FloatArray = NDArray[np.float64]
#: Samples are padded to one of these, so that few shapes are compiled.
SIZES = (256, 1024, 4096, 20_480)
#: Nodes of the scan by the number of nonlinear parameters; candidates and starts of more.
NODES = {1: 512, 2: 64}
CANDIDATES, STARTS, STEPS, PART = 4096, 200, 30, 1024
#: Ends, or minima of the grid, that go on to all samples.
ENDS = 12
#: Samples of which the brightest lobe is tried that has its peak there.
PEAKS = 100
EPS = 1e-12


@functools.partial(jax.jit, static_argnames="layout")
def _normal(layout: Layout, candidates: Array, pair: Array, y: Array, w: Array) -> tuple[Array, Array]:
    """Gram matrices (S, K, K) and right sides (S, K) of the weighted terms at candidates (S, T)."""

    def one(u: Array) -> tuple[Array, Array]:
        a = layout.terms(u, pair) * w
        return a @ a.T, a @ (w * y)

    return jax.lax.map(one, candidates)


@functools.partial(jax.jit, static_argnames="layout")
def _values(layout: Layout, p: Array, pair: Array) -> tuple[Array, Array]:
    """Values (n,) and derivatives (n, P) at p = [u, coefficients]."""
    t = len(layout.free)

    def value(p_: Array) -> Array:
        return p_[t:] @ layout.terms(p_[:t], pair)

    return value(p), jax.jacfwd(value)(p)


def _least(gram: FloatArray, rhs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """-(lowest b.gram b - 2 rhs.b) over b >= 0 and its b, of many: (S,), (S, K); by all supports."""
    count, k = rhs.shape
    scale = np.sqrt(np.maximum(np.diagonal(gram, axis1=1, axis2=2), 1e-300))
    g, r = gram / (scale[:, :, None] * scale[:, None, :]), rhs / scale
    best, chosen = np.zeros(count), np.zeros((count, k))
    for support in itertools.product((False, True), repeat=k):
        own = np.flatnonzero(support)
        if not len(own):
            continue
        matrix = g[:, own[:, None], own] + EPS * np.eye(len(own))
        b = np.linalg.solve(matrix, r[:, own, None])[..., 0]
        gain = 2 * (b * r[:, own]).sum(1) - np.einsum("si,sij,sj->s", b, g[:, own[:, None], own], b)
        better = (b >= 0).all(axis=1) & (gain > best)
        best[better] = gain[better]
        chosen[better] = 0.0
        chosen[np.ix_(better, own)] = b[better]
    return best, chosen / scale


def _padded(pair: FloatArray, y: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    size = next(s for s in SIZES if s >= len(y))
    missing = size - len(y)
    return np.pad(pair, ((0, 0), (0, missing)), mode="edge"), np.pad(y, (0, missing)), np.pad(w, (0, missing))


def chi_square(places: Layout, table: Table, truth: FloatArray, seed: int) -> float:
    """The lowest chi-square found for a table of one channel; ``truth`` (T,) is one start of it."""
    index = np.flatnonzero(table.mask)
    pair = np.concatenate([w.T for w in table.directions(index)])
    y, w = table.value[index, 0], 1.0 / table.sigma[index, 0]
    whole = _padded(pair, y, w)
    t = len(places.free)
    found = _scanned(places, whole) if t in NODES else _solved(places, pair, y, w, seed)
    if places.spec.family == "lafortune" and t == 2:
        found = np.concatenate([found, _peaks(places, pair, y, w)])
    starts = np.concatenate([np.clip(truth, *places.box)[None], found])
    gram, rhs = (np.asarray(a) for a in _normal(places, jnp.asarray(starts), *whole))
    gain, b = _least(gram, rhs)
    freedom = max(1, len(y) - len(starts[0]) - b.shape[1])
    order = np.argsort(-gain, kind="stable")[:ENDS]
    # The scan has its own minima only; of many starts the subset's order is not that of all samples.
    return min(
        _descended(places, np.concatenate([starts[k], b[k]]), whole, freedom)
        for k in {0, *order.tolist()}
    )  # fmt: skip


def _descended(
    places: Layout, p: FloatArray, data: tuple[FloatArray, FloatArray, FloatArray], freedom: int
) -> float:
    pair, y, w = data
    low, high = places.box
    rest = len(p) - len(low)

    def equations(at: FloatArray) -> Sums:
        f, slope = (np.asarray(a) for a in _values(places, at, pair))
        r, j = w * (f - y), w[:, None] * slope
        return Sums(j.T @ j, -j.T @ r, float(r @ r))

    lower = np.concatenate([low, np.zeros(rest)])
    upper = np.concatenate([high, np.full(rest, np.inf)])
    return solve(equations, p, lower, upper, freedom, 100, 1e-5).normal.objective


def _scanned(places: Layout, data: tuple[FloatArray, FloatArray, FloatArray]) -> FloatArray:
    """(S, T) the local minima of the reduced objective on a grid over the whole box, best first."""
    low, high = places.box
    t = len(low)
    axes = [np.linspace(a, b, NODES[t]) for a, b in zip(low, high, strict=True)]
    nodes = np.stack([axis.reshape(-1) for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
    gain, _ = _least(*(np.asarray(a) for a in _normal(places, jnp.asarray(nodes), *data)))
    field = np.pad(gain.reshape((NODES[t],) * t), 1, constant_values=-np.inf)
    centre = field[(slice(1, -1),) * t]
    lowest = np.ones(centre.shape, bool)
    for shift in itertools.product((0, 1, 2), repeat=t):
        if set(shift) != {1}:
            lowest &= centre >= field[tuple(slice(s, s + NODES[t]) for s in shift)]
    chosen = np.flatnonzero(lowest)
    return nodes[chosen[np.argsort(-gain[chosen], kind="stable")][: 4 * ENDS]]


def _peaks(places: Layout, pair: FloatArray, y: FloatArray, w: FloatArray) -> FloatArray:
    """(S, T) cosine lobes whose peak over gamma is at a sample that stands out above a constant."""
    constant = float((w * w) @ y / (w @ w))
    index = np.argsort(-w * (y - constant))[:PEAKS]
    gamma = -np.arctan2(pair[0] * pair[3] + pair[1] * pair[4], pair[2] * pair[5])[index]
    found = np.stack(np.meshgrid(gamma, np.log([1e2, 1e3, 1e4, 1e5]), indexing="ij"), axis=-1).reshape(-1, 2)
    return np.clip(found[:, [places.free.index("gamma"), places.free.index("n")]], *places.box)


def _solved(places: Layout, pair: FloatArray, y: FloatArray, w: FloatArray, seed: int) -> FloatArray:
    """(S, T) ends of many starts on a part of the samples, best first and distinct."""
    rng = np.random.default_rng([seed, 77])
    low, high = places.box
    # Half by chance, half the brightest: they decide where a narrow lobe is.
    part = np.arange(len(y))
    if len(y) > PART:
        bright = np.argsort(-np.abs(w * y))[: PART // 4]
        part = np.union1d(bright, rng.choice(len(y), PART - len(bright), replace=False))
    data = _padded(pair[:, part], y[part], w[part])
    tried = low + (high - low) * qmc.Sobol(len(low), rng=rng).random(CANDIDATES)
    gain, _ = _least(*(np.asarray(a) for a in _normal(places, jnp.asarray(tried), *data)))
    order = np.argsort(-gain)
    starts = tried[np.concatenate([order[: STARTS // 2], order[STARTS // 2 :: CANDIDATES // (STARTS // 2)]])]
    starts = np.resize(starts, (STARTS, len(low)))
    columns = (jnp.asarray(data[0]), jnp.asarray(data[1][:, None]), jnp.asarray(data[2][:, None]))
    u, cost, _ = separable.solve_many(places, jnp.asarray(starts), *columns, steps=STEPS)
    u, cost = np.asarray(u), np.asarray(cost)
    ok = np.isfinite(cost) & np.isfinite(u).all(axis=1)
    u, cost = u[ok], cost[ok]
    kept: list[int] = []
    for k in np.argsort(cost, kind="stable"):
        if all(abs(cost[k] - cost[j]) > 1e-6 * cost[j] for j in kept):
            kept.append(int(k))
        if len(kept) == 2 * ENDS:
            break
    return u[kept]
