"""Exact reductions: a table whose samples enter a model through few functions, as a few pseudo-samples.

For many families the terms at one theta_h (or anywhere) are combinations a(pair) of their values at a few
reference pairs (:class:`fitter.models.span.Span`). Residuals are then linear in those few numbers, so that
one small matrix of sums tells the sum of squares of a whole slab of samples for all parameters: Ward's lobe
on a MERL grid becomes 90 slabs of two columns. A root of that matrix is as good as the samples themselves:
each of its rows is a pseudo-sample, and what no parameter can explain is one more. Searches and passes over
them cost nothing, and find the optimum of the full table.

Needs a metric that is a weighted sum of squares, and weights that don't depend on the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from fitter import directions
from fitter.fitting import rows
from fitter.fitting.blocks import BLOCK, Block, padded
from fitter.fitting.chunks import CHUNK, Arrays, arrays, over_blocks, summed
from fitter.fitting.layout import Layout
from fitter.fitting.metrics import QUADRATIC
from fitter.fitting.samples import Usable
from fitter.grid import Grid
from fitter.models.pair import Pair
from fitter.models.span import Span
from fitter.programs import kept
from fitter.spec import Metric
from fitter.table import Table

FloatArray = NDArray[np.float64]
#: Directions of a slab's matrix below this share of its largest are rounding.
SINGULAR = 1e-13


@dataclass(frozen=True)
class _Slabs:
    """How the cells lie in slabs: ``count`` of ``length`` cells each, theta_h of each (count,)."""

    count: int
    length: int
    theta_h: FloatArray


def reduce(layout: Layout, data: Usable, channels: Sequence[int]) -> Block | None:
    """The pseudo-samples of the channels as a block whose ``pair`` has J (6 + K) rows; None where the model,
    the metric or the table allows no reduction."""
    span = layout.family.span(layout.spec)
    if span is None or not applies(layout, data.metric, data.table, len(data)):
        return None
    slabs = _slabs(span, data.table.grid)
    grams = _grams(layout, span, data, tuple(channels), slabs)
    references = [_components(span, theta_h) for theta_h in slabs.theta_h]
    inverses = _inverses(layout, span, np.stack(references))
    return _pseudo(np.stack(references), inverses, grams, len(channels))


def applies(layout: Layout, metric: Metric, table: Table, samples: int) -> bool:
    """Whether a fit of this many samples of a table can be one of pseudo-samples."""
    span = layout.family.span(layout.spec)
    turned = table.symmetry == "isotropic" and not layout.family.isotropic(layout.spec)
    if span is None or metric not in QUADRATIC or layout.mixed or turned:
        return False
    if span.within == "all":
        return True
    grid = table.grid
    if grid is None or grid.system != "half_difference" or grid.size > 2 * samples:
        return False
    return grid.size // grid.shape[0] <= BLOCK


def _slabs(span: Span, grid: Grid | None) -> _Slabs:
    if span.within == "all":
        return _Slabs(1, 0, np.zeros(1))
    assert grid is not None
    return _Slabs(grid.shape[0], grid.size // grid.shape[0], grid.axes["theta_h"])


def _components(span: Span, theta_h: float) -> FloatArray:
    """(J, 6) the reference pairs of a slab."""
    own = span.within == "theta_h"
    return np.stack([
        np.array(directions.half_difference_components(theta_h if own else h, d, phi))
        for h, d, phi in span.references
    ])  # fmt: skip


def _nonlinear(span: Span) -> list[dict[str, Array]]:
    return [{name: jnp.asarray(value) for name, value in given} for given in span.parameters]


def _inverses(layout: Layout, span: Span, references: FloatArray) -> FloatArray:
    """(S, K, J, J) what turns the terms at the J sets of parameters into the combination a of references."""
    pair = Pair(*jnp.asarray(references.transpose(2, 0, 1)))  # (S, J) each
    terms = np.array([layout.family.terms(layout.spec, q, pair) for q in _nonlinear(span)])
    return np.linalg.pinv(terms.transpose(2, 1, 0, 3), rcond=1e-12)


def _grams(
    layout: Layout, span: Span, data: Usable, channels: tuple[int, ...], slabs: _Slabs
) -> FloatArray:
    """(S, G, Q, Q) sums of products of the weighted columns: the terms at the J sets of parameters, K J of
    them, and the values of the channels of one weight; G = 1 where all have the same."""
    if span.within == "all":
        (whole,) = summed(
            lambda block: [_sums(layout, span, 1, BLOCK, arrays(block))], data.blocks(channels)
        )
        return whole
    assert data.table.grid is not None
    per_block = BLOCK // slabs.length
    blocks = data.blocks_of_lines(channels, per_block * slabs.length // data.table.grid.shape[-1])
    parts = over_blocks(lambda block: [_sums(layout, span, per_block, slabs.length, arrays(block))], blocks)
    return np.concatenate([part for (part,) in parts])[: slabs.count]


@kept("layout", "span", "slabs", "length")
def _sums(layout: Layout, span: Span, slabs: int, length: int, block: Arrays) -> Array:
    cells = slabs * length
    pair, y, w = (jnp.asarray(part)[:, :cells] for part in block)
    terms = [layout.family.terms(layout.spec, q, Pair(*pair)) for q in _nonlinear(span)]
    columns = rows.settled(*(term for found in terms for term in found))
    # Channels of one weight share their columns, (1, n) each; others have their own.
    values = y[None] * w if len(w) == 1 else (y * w)[:, None]
    x = rows.joined([*((column * w)[:, None] for column in columns), values])
    x = x.reshape(*x.shape[:2], slabs, length)
    return jnp.einsum("gisn,gjsn->sgij", x, x)


def _pseudo(references: FloatArray, inverses: FloatArray, grams: FloatArray, channels: int) -> Block:
    """The block of pseudo-samples from references (S, J, 6), inverses (S, K, J, J) and sums (S, G, Q, Q)."""
    (s, k, j, _), g = inverses.shape, grams.shape[1]
    size = k * j
    # Columns come as (parameters, terms); a of term k for reference j is their combination.
    mix = np.zeros((s, k, j, j, k))
    for term in range(k):
        mix[:, term, :, :, term] = inverses[:, term]
    mix = mix.reshape(s, 1, size, size)
    a = mix @ grams[:, :, :size, :size] @ mix.swapaxes(2, 3)
    b = mix @ grams[:, :, :size, size:]
    squares = np.einsum("sgcc->gc", grams[:, :, size:, size:])
    scale = np.sqrt(np.maximum(np.einsum("sgii->sgi", a), 1e-300))
    values, vectors = np.linalg.eigh(a / (scale[..., :, None] * scale[..., None, :]))
    kept = values > SINGULAR * np.maximum(values[..., -1:], 1e-300)
    root = np.sqrt(np.where(kept, values, 0.0))
    rows = root[..., :, None] * vectors.swapaxes(2, 3) * scale[..., None, :]  # (S, G, size, size)
    inverse = np.where(kept, 1.0 / np.where(kept, root, 1.0), 0.0)
    z = inverse[..., :, None] * (vectors.swapaxes(2, 3) @ (b / scale[..., :, None]))  # (S, G, size, C or 1)
    rest = np.sqrt(np.maximum(squares - np.square(z).sum(axis=(0, 2)), 0.0))  # (G, C or 1)

    count = s * g * size + 1
    size_of_all = max(CHUNK, padded(count))
    pair = np.zeros((j, 6 + k, size_of_all))
    pair[:, 2] = pair[:, 5] = 1.0
    pair[:, :6, : count - 1] = np.repeat(references.transpose(1, 2, 0), g * size, axis=2)
    # Rows of the factor are (reference, term) of one pseudo-sample.
    weights = rows.reshape(s * g * size, k, j)
    pair[:, 6:, : count - 1] = weights.transpose(2, 1, 0)
    y, weight = np.zeros((channels, size_of_all)), np.zeros((1 if g == 1 else channels, size_of_all))
    if g == 1:
        y[:, : count - 1], y[:, count - 1] = z.reshape(-1, channels).T, rest[0]
        weight[:, :count] = 1.0
    else:
        own = np.tile(np.repeat(np.arange(g), size), s)
        y[own, np.arange(count - 1)] = z.reshape(-1)
        weight[own, np.arange(count - 1)] = 1.0
        y[:, count - 1], weight[:, count - 1] = rest[:, 0], 1.0
    return Block(pair.reshape(j * (6 + k), size_of_all), y, weight, count)

