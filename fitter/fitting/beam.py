"""Starts for models of several lobes: a beam search through a library of single lobes.

For given nonlinear parameters a model of L lobes is a sum of L columns, each of which depends on its own
lobe alone. So the columns of a few hundred single lobes are made once, all pairs of them are tried with the
exact linear solve, and the best pairs are extended by every third column. Random starts in the product space
find the global optimum of three lobes in two cases of three; this looks where it must be.
"""

from __future__ import annotations

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from fitter.fitting.layout import Layout
from fitter.fitting.order import interchangeable
from fitter.models.pair import Pair
from fitter.spec import ModelSpec

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
#: Nodes of the library by parameter of a lobe.
NODES = {"gamma": 36, "n": 14}
#: The lobes of the library are isotropic. What starts from them is slightly not, (psi, delta), since where
#: delta is 45 deg the azimuth has no slope.
ISOTROPIC = {"psi": 0.0, "delta": 0.25 * math.pi}
LEANINGS = ((0.0, -0.2), (0.0, 0.2), (0.25 * math.pi, -0.2), (0.25 * math.pi, 0.2))
BEAM = 40


def candidates(
    layout: Layout, pair: FloatArray, y: FloatArray, weight: FloatArray, count: int
) -> FloatArray | None:
    """(S, T) promising starts, at most ``count``, best first; None where the lobes are not interchangeable.

    ``layout`` is one whose channels share all parameters. The order of the azimuths in it is the same for all
    tables, so that the starts of several channels go together.
    """
    lobes = interchangeable(layout)
    if lobes is None:
        return None
    stems = [layout.free[k].rpartition("_")[0] for k in lobes[0]]
    rest = set(range(len(layout.free))).difference(*lobes)
    if {"gamma", "n"} - set(stems) or set(stems) - {"gamma", "n", "delta"}:
        return None
    if any(layout.free[k] != "psi" for k in rest):
        return None
    own = [[k for k, stem in zip(ks, stems, strict=True) if stem in NODES] for ks in lobes]
    low, high = layout.box
    nodes = [NODES[stem] for stem in stems if stem in NODES]
    axes = [
        low[k] + (high[k] - low[k]) * (np.arange(m) + 0.5) / m for k, m in zip(own[0], nodes, strict=True)
    ]
    library = np.stack([axis.reshape(-1) for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
    place = np.stack(
        [axis.reshape(-1) for axis in np.meshgrid(*(np.arange(m) for m in nodes), indexing="ij")], axis=1
    )
    grams, sides = (np.asarray(a) for a in _normal(layout, tuple(own[0]), library, pair, y, weight))
    first = grams.shape[1] - len(library)  # 1 where there is a diffuse column
    lobes = np.arange(first, grams.shape[1])
    pairs = np.stack(np.triu_indices(len(lobes), 1), axis=1)
    sets = lobes[pairs]
    gain = _gain(grams, sides, sets, first)
    for size in range(2, layout.spec.lobes + 1):
        if size > 2:
            kept = sets[_apart(gain, sets - first, place, BEAM)]
            third = np.tile(lobes, len(kept))[:, None]
            sets = np.concatenate([np.repeat(kept, len(lobes), axis=0), third], axis=1)
            sets = sets[(sets[:, :-1] != sets[:, -1:]).all(axis=1)]
            gain = _gain(grams, sides, sets, first)
    leanings = LEANINGS if rest else LEANINGS[:2] if "delta" in stems else LEANINGS[:1]
    chosen = sets[_apart(gain, sets - first, place, count)] - first
    u = np.empty((len(chosen), len(layout.free)))
    for lobe, columns in enumerate(own):
        u[:, columns] = library[chosen[:, lobe]]
    # Without a free azimuth only the first two differ.
    leanings = np.array(LEANINGS[: len(LEANINGS) if rest else 2])
    leanings = leanings[np.arange(len(u)) % len(leanings)]
    u[:, sorted(rest)] = leanings[:, :1]
    leaning = [k for k, name in enumerate(layout.free) if name.startswith("delta_")]
    u[:, leaning] = ISOTROPIC["delta"] + leanings[:, 1:]
    return np.clip(u, low, high)


@functools.partial(jax.jit, static_argnames=("layout", "names"))
def _normal(
    layout: Layout, names: tuple[int, ...], library: Array, pair: Array, y: Array, weight: Array
) -> tuple[Array, Array]:
    """Normal matrices (C, M, M) and right sides (C, M) of the diffuse column and the library's."""
    spec = ModelSpec(
        family=layout.spec.family, diffuse=layout.spec.diffuse, anisotropic=layout.spec.anisotropic
    )  # fmt: skip
    held = {name: jnp.asarray(value, library.dtype) for name, value in ISOTROPIC.items()}
    single = [layout.free[k].rpartition("_")[0] for k in names]
    logs = [layout.logs[k] for k in names]

    def column(values: Array) -> Array:
        nonlinear = {
            name: jnp.exp(value) if log else value
            for name, value, log in zip(single, values, logs, strict=True)
        }
        return layout.family.terms(spec, held | nonlinear, Pair(*pair))[-1]

    columns = jax.lax.map(column, library, batch_size=16)
    if spec.diffuse == "lambert":
        flat = layout.terms(jnp.asarray(layout.lower), pair)[:1]
        columns = jnp.concatenate([flat, columns])

    def one(y_c: Array, w_c: Array) -> tuple[Array, Array]:
        a = columns * w_c
        return a @ a.T, a @ (w_c * y_c)

    return jax.vmap(one, in_axes=1)(y, weight)


def _gain(grams: FloatArray, sides: FloatArray, sets: IntArray, first: int) -> FloatArray:
    """(S,) by how much the objective falls with each set of columns; -inf where a lobe would be negative."""
    total = np.zeros(len(sets))
    for gram, side in zip(grams, sides, strict=True):
        scale = 1.0 / np.sqrt(np.maximum(np.diagonal(gram), 1e-300))
        g, r = gram * np.outer(scale, scale), side * scale
        best = np.full(len(sets), -np.inf)
        for with_diffuse in {0, first}:
            columns = np.concatenate([np.zeros((len(sets), with_diffuse), np.intp), sets], axis=1)
            matrix = g[columns[:, :, None], columns[:, None, :]] + 1e-9 * np.eye(columns.shape[1])
            b = np.linalg.solve(matrix, r[columns][:, :, None])[:, :, 0]
            found = (b * r[columns]).sum(axis=1)
            best = np.where((b >= 0).all(axis=1), np.maximum(best, found), best)
        total += best
    return total


def _apart(gain: FloatArray, sets: IntArray, place: IntArray, count: int) -> IntArray:
    """The best sets of which no two have all their lobes within two nodes of each other's."""
    order = np.argsort(-gain)[: 200 * count]
    chosen: list[int] = []
    for k in order:
        if len(chosen) == count or not np.isfinite(gain[k]):
            break
        here = np.sort(sets[k])
        if all(np.abs(place[here] - place[np.sort(sets[j])]).max() > 2 for j in chosen):
            chosen.append(int(k))
    return np.array(chosen, dtype=np.intp)
