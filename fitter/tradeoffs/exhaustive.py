"""An exhaustive scan of the reduced objective, for models of one or two nonlinear parameters.

The linear parameters are solved exactly at every node, so that a grid over the whole box of the others leaves
no basin wider than a cell unseen. The objective is the one that the search sees: for log and cbrt its
tangent.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitter.fitting import separable
from fitter.fitting.blocks import padded
from fitter.fitting.layout import Layout, channel_groups, layout
from fitter.fitting.result import FitResult
from fitter.fitting.solving import tangent
from fitter.fitting.usable import usable
from fitter.table import Table

FloatArray = NDArray[np.float64]
#: Nodes of each axis, by the number of parameters.
NODES = {1: 512, 2: 40}
#: Samples that the scan looks at.
SAMPLES = 4096


def scan(table: Table, reference: FitResult) -> dict[str, Any] | None:
    """What the scan says of a fit; None where the model has more parameters than can be scanned.

    nodes : evaluated. minima : nodes lower than all their neighbours. best_node : by what share the lowest
    node is above the objective at the reference; below 0 where it is lower: there is a better optimum.
    """
    spec, channels = reference.spec, len(reference.model.channels)
    places = layout(spec, channels)
    count = len(places.entries)
    if count not in NODES or places.mixed:
        return None
    metric = spec.metric or "cbrt"
    data = usable(table, metric, spec.select, anisotropic=not places.family.isotropic(spec.model))
    low, high = places.box
    axes = [np.linspace(a, b, NODES[count]) for a, b in zip(low, high, strict=True)]
    grid = np.stack([axis.reshape(-1) for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
    index, scale = data.subset(SAMPLES, spec.seed)
    best: list[float] = []
    minima = 0
    for group in channel_groups(spec, channels):
        part = data.part(group, index, padded(len(index)), scale)
        y, weight = tangent(metric, part, data.floor[group])
        candidates = jnp.asarray(np.concatenate([grid, _coordinates(places, reference, group[0])[None]]))
        cost = np.asarray(separable.screen(places, candidates, part.pair, y, weight)).sum(axis=1)
        found = np.where(np.isfinite(cost), cost, np.inf)
        best.append(float(found[:-1].min() / max(found[-1], 1e-300) - 1.0))
        minima += _minima(found[:-1].reshape([NODES[count]] * count))
    return {"nodes": len(grid) * len(best), "minima": minima, "best_node": min(best)}


def _coordinates(places: Layout, fit: FitResult, channel: int) -> FloatArray:
    """(T,) search coordinates of a fit, of one channel where each has its own."""
    values = [float(fit.parameters[name].value.reshape(-1)[channel if fit.parameters[name].value.ndim else 0])
              for name in places.free]  # fmt: skip
    return np.array([np.log(v) if log else v for v, log in zip(values, places.logs, strict=True)])


def _minima(objective: FloatArray) -> int:
    """Nodes of the grid that are lower than each neighbour along the axes, and finite."""
    lower = np.isfinite(objective)
    for axis in range(objective.ndim):
        edge = [(1, 1) if k == axis else (0, 0) for k in range(objective.ndim)]
        wide = np.pad(objective, edge, constant_values=np.inf)
        before, after = (np.take(wide, np.arange(objective.shape[axis]) + shift, axis) for shift in (0, 2))
        lower &= (objective < before) & (objective <= after)
    return int(lower.sum())
