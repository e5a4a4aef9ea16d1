"""What the patches of a tensor tree say of directions, as Radiance reads the file: no interpolation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitter.formats.source import Source
from fitter.formats.tensor_tree import Tree, tree_of
from fitter.formats.window_xml import by_side, layers_of

FloatArray = NDArray[np.float64]


def reader(path: Path, isotropic: bool) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """f_r (M,) of wi, wo (M, 3) for a file that holds one reflection, its back."""
    source = Source(path)
    ((_, _, trees),) = by_side(
        source, layers_of(source)[0], lambda layer, block: tree_of(source, layer, block)
    )
    (tree,) = trees.values()

    def value(wi: FloatArray, wo: FloatArray) -> FloatArray:
        travel = -wi[:, :2]
        if isotropic:
            # Turned so that the light travels towards +x.
            sine = np.hypot(travel[:, 0], travel[:, 1])
            c, s = (travel / np.where(sine > 0, sine, 1.0)[:, None]).T
            c = np.where(sine > 0, c, 1.0)
            turned = np.stack([c * wo[:, 0] + s * wo[:, 1], c * wo[:, 1] - s * wo[:, 0]], axis=1)
            # The other half of the tree stands for no incidence.
            incident = np.minimum(0.5 - sine / 2, np.nextafter(0.5, 0.0))
            points = np.concatenate([incident[:, None], square_from_disk(turned)], axis=1)
        else:
            points = np.concatenate([square_from_disk(travel), square_from_disk(wo[:, :2])], axis=1)
        found = np.empty(len(points))
        _look(tree, points, np.arange(len(points)), found)
        return found

    return value


def square_from_disk(disk: FloatArray) -> FloatArray:
    """Points (n, 2) of the unit square of points of the unit disk: the inverse of ``disk_from_square``."""
    x, y = disk.T
    r = np.hypot(x, y)
    wide = np.abs(x) > np.abs(y)
    along, across = np.where(wide, x, y), np.where(wide, y, x)
    first = np.where(along < 0, -r, r)
    second = first * np.arctan(across / np.where(along == 0, 1.0, along)) * (4 / np.pi)
    return np.stack([np.where(wide, first, second), np.where(wide, second, first)], axis=1) / 2 + 0.5


def _look(tree: Tree, points: FloatArray, index: NDArray[np.intp], found: FloatArray) -> None:
    """Set ``found[index]`` to the values of the cells that the points (n, rank) lie in."""
    if isinstance(tree, np.ndarray):
        side = len(tree)
        at = np.clip((points * side).astype(np.intp), 0, side - 1)
        found[index] = tree[tuple(at.T)]
        return
    upper = points >= 0.5
    half = (upper << np.arange(points.shape[1])).sum(axis=1)
    for n in np.unique(half):
        here = half == n
        _look(tree[n], 2 * points[here] - upper[here], index[here], found)
