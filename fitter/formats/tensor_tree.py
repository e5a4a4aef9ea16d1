"""WINDOW's BSDF XML with a tensor tree: values over patches that are small where the reflectance changes.

A tree halves every side of a unit cube (of three dimensions for isotropic samples, of four else) until a cell
holds one value or a grid of them. Each direction is a point of a unit square that maps to the disk of its x
and y (P. Shirley, K. Chiu 1997, "A low distortion map between disk and square"): a patch's area is its
projected solid angle. The incident direction is that of the light's travel. In three dimensions it is
1/2 - sin(theta_i)/2, and the outgoing one is turned so that the light travels towards +x (Radiance, bsdf_t).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from fitter.formats import geometry as geo
from fitter.formats.assemble import Reading, assemble, stated_quantity
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format
from fitter.formats.source import Source
from fitter.formats.text import number
from fitter.formats.window_xml import (
    MIRRORED,
    Block,
    Layer,
    Side,
    by_side,
    in_order,
    is_window,
    item_of,
    layers_of,
    provenance_of,
)
from fitter.metadata import Channel
from fitter.table import Table

FloatArray = NDArray[np.float64]
#: A grid of 2^k values on each side (one value for k = 0), or the 2^rank trees of the halves: bit d of its
#: number says that a half is the upper one in dimension d.
Tree: TypeAlias = "FloatArray | list[Tree]"

NAME = "tensor-tree"
_RANKS = {"tensortree3": 3, "tensortree4": 4}
_BASIS = "LBNL/Shirley-Chiu"
_TOKEN = re.compile(r"[{}]|[^\s{},]+")
#: Halvings of a side that no file has more of, and samples that no table may have more of.
_DEEPEST, MOST = 12, 20_000_000
#: Patches of the outgoing hemisphere are divided into at least 2^this on a side.
_FINE = 4


def sniff(head: bytes, size: int) -> float:
    """Sure of a WindowElement that names a tensor tree near its beginning."""
    return 0.99 if is_window(head) and b"tensortree" in head.lower() else 0.0


def read(source: Source, options: ReadOptions) -> list[Table]:
    """A table for each layer and side that reflects, its samples at the patches' centres."""
    layers, notes = layers_of(source)
    sides = by_side(source, layers, lambda layer, block: tree_of(source, layer, block))
    return [
        _table(source, options, layer, side, trees, item_of(layer, side, sides), notes)
        for layer, side, trees in sides
    ]


FORMAT = Format(NAME, "WINDOW BSDF XML, tensor trees (Radiance's bsdf2ttree)", (), sniff, read)


def tree_of(source: Source, layer: Layer, block: Block) -> Tree:
    """The tree of one block."""
    rank = _RANKS.get(layer.structure.lower())
    if rank is None:
        raise source.error(
            f"IncidentDataStructure is {layer.structure[:40]!r}", "table-header", row=layer.element.row,
            column="IncidentDataStructure", cause="a damaged header",
            remedy="write TensorTree3 or TensorTree4",
        )  # fmt: skip
    basis = block.element.words("AngleBasis")
    if basis.lower() != _BASIS.lower():
        raise source.error(
            f"AngleBasis is {basis[:40]!r}", "table-header", row=block.element.row, column="AngleBasis",
            cause="a damaged header", remedy=f"write {_BASIS}",
        )  # fmt: skip
    data = block.element.first("ScatteringData")
    text, row = ("", block.element.row) if data is None else (data.text, data.row)
    return _parsed(source, text, row, rank)


def _parsed(source: Source, text: str, row: int, rank: int) -> Tree:
    """The tree that nested braces write."""
    done: list[Tree] = []
    open_nodes: list[list[Tree]] = []
    values: list[float] = []
    for token in _TOKEN.finditer(text):
        word = token[0]
        if word == "{":
            if values or len(open_nodes) > _DEEPEST or (done and not open_nodes):
                raise _broken(source, row, "braces in the wrong place")
            open_nodes.append([])
        elif word != "}":
            value = number(word)
            if value is None:
                raise source.error(
                    f"{word[:40]!r} is not a number", "table-not-a-number", row=row, column="ScatteringData",
                    remedy="mend the value, or write nan where nothing was measured",
                )  # fmt: skip
            values.append(value)
        else:
            if not open_nodes:
                raise _broken(source, row, "a brace too many")
            halves = open_nodes.pop()
            node: Tree = halves
            if not halves:
                side = round(len(values) ** (1 / rank))
                if side**rank != len(values) or side & (side - 1):
                    raise _broken(source, row, f"a grid of {len(values)} values")
                node = np.asarray(values).reshape((side,) * rank)
                values = []
            elif values or len(halves) != 1 << rank:
                raise _broken(source, row, f"a branch of {len(halves)} halves")
            (open_nodes[-1] if open_nodes else done).append(node)
    if open_nodes or values or len(done) != 1:
        raise source.error(
            "ScatteringData ends within the tree" if open_nodes else "ScatteringData holds no tree",
            "table-truncated", row=row, column="ScatteringData", cause="the file is cut off or damaged",
            remedy="fetch the file again",
        )  # fmt: skip
    return done[0]


def _broken(source: Source, row: int, what: str) -> Exception:
    return source.error(
        f"ScatteringData has {what}, which is no tensor tree", "table-header", row=row,
        column="ScatteringData", cause="a damaged file, or a tree of another rank",
        remedy="fetch the file again, or correct IncidentDataStructure",
    )  # fmt: skip


class _Cells:
    """Cells of one or several trees of the same rank, all divided where any of them is.

    levels : level -> (coordinates (n, rank) in units of 2^-level, values (n, C)).
    """

    def __init__(self, trees: Sequence[Tree], rank: int) -> None:
        self._rank = rank
        self._corners = np.array([[n >> d & 1 for d in range(rank)] for n in range(1 << rank)])
        self._parts: dict[int, list[tuple[NDArray[np.intp], FloatArray]]] = {}
        self._collect(list(trees), 0, np.zeros(rank, np.intp))
        self.levels = {
            level: (np.concatenate([at for at, _ in parts]), np.concatenate([value for _, value in parts]))
            for level, parts in sorted(self._parts.items())
        }

    def _collect(self, trees: list[Tree], level: int, at: NDArray[np.intp]) -> None:
        if self._rank == 3 and 2 * at[0] >= 1 << level and level > 0:
            return  # the half of the cube that stands for no incidence
        grids = [tree for tree in trees if isinstance(tree, np.ndarray)]
        if len(grids) == len(trees):
            side = max(len(grid) for grid in grids)
            whole = [_repeated(grid, side) for grid in grids]
            place = np.stack(np.unravel_index(np.arange(side**self._rank), (side,) * self._rank), axis=1)
            value = np.stack([grid.reshape(-1) for grid in whole], axis=1)
            self._parts.setdefault(level + side.bit_length() - 1, []).append((at * side + place, value))
            return
        for n, corner in enumerate(self._corners):
            halves = [_half(tree, n, corner) for tree in trees]
            self._collect(halves, level + 1, 2 * at + corner)


def _half(tree: Tree, n: int, corner: NDArray[np.intp]) -> Tree:
    """One of the 2^rank halves of a tree."""
    if not isinstance(tree, np.ndarray):
        return tree[n]
    if len(tree) == 1:
        return tree
    middle = len(tree) // 2
    return tree[tuple(slice(middle, None) if upper else slice(middle) for upper in corner)]


def _repeated(grid: FloatArray, side: int) -> FloatArray:
    """A grid's values at ``side`` places on each axis."""
    for axis in range(grid.ndim):
        grid = np.repeat(grid, side // grid.shape[axis], axis=axis)
    return grid


def _samples(source: Source, cells: _Cells, rank: int) -> tuple[FloatArray, FloatArray, int]:
    """Points (n, rank) of the unit cube with values (n, C), in order, and how many cells there were.

    Every incidence of the finest level has samples, and outgoing cells wider than 2^-_FINE are divided: what
    a wide cell says holds for all of it.
    """
    incident = rank - 2
    finest = max(*cells.levels, 1)  # half a cube of three dimensions stands for no incidence
    steps_of = {
        level: [1 << finest - level] * incident + [1 << max(_FINE - level, 0)] * 2 for level in cells.levels
    }
    count = sum(
        len(at) * int(np.prod([float(n) for n in steps_of[level]])) for level, (at, _) in cells.levels.items()
    )
    if count > MOST or finest > _DEEPEST:
        raise source.error(
            f"the tree has {count:,} patches at its finest resolution, 2^{finest} on a side",
            "table-too-large", column="ScatteringData",
            remedy="write it with a lower resolution: bsdf2ttree -g 6, or convert it with bsdf2klems",
        )  # fmt: skip
    points: list[FloatArray] = []
    values: list[FloatArray] = []
    for level, (at, value) in cells.levels.items():
        step = np.asarray(steps_of[level])
        inner = np.stack(np.unravel_index(np.arange(int(step.prod())), tuple(step)), axis=1)
        places = (at[:, None, :] * step + inner + 0.5) / (step * (1 << level))
        points.append(places.reshape(-1, rank))
        values.append(np.repeat(value, len(inner), axis=0))
    every, measured = np.concatenate(points), np.concatenate(values)
    if rank == 3:
        kept = every[:, 0] < 0.5
        every, measured = every[kept], measured[kept]
    order = np.lexsort(every.T[::-1])
    return every[order], measured[order], sum(len(at) for at, _ in cells.levels.values())


def disk_from_square(square: FloatArray) -> FloatArray:
    """Points (n, 2) of the unit disk of points of the unit square (Shirley and Chiu 1997)."""
    a, b = 2 * square[:, 0] - 1, 2 * square[:, 1] - 1
    wide = np.abs(a) > np.abs(b)
    r = np.where(wide, a, b)
    share = np.where(wide, b, a) / np.where(r == 0, 1.0, r)
    phi = np.pi / 4 * np.where(wide, share, 2 - share)
    return np.stack([r * np.cos(phi), r * np.sin(phi)], axis=1)


def _vectors(disk: FloatArray) -> FloatArray:
    z = np.sqrt(np.maximum(1 - (disk * disk).sum(axis=1), 0.0))
    return np.concatenate([disk, z[:, None]], axis=1)


def _table(
    source: Source, options: ReadOptions, layer: Layer, side: Side, trees: Mapping[Channel, Tree],
    item: str | None, notes: list[str],
) -> Table:  # fmt: skip
    channels, found, said = in_order(trees)
    rank = _RANKS[layer.structure.lower()]
    points, value, count = _samples(source, _Cells(found, rank), rank)
    if rank == 3:
        travel = np.stack([1 - 2 * points[:, 0], np.zeros(len(points))], axis=1)
    else:
        travel = disk_from_square(points[:, :2])
    wi, wo = _vectors(-travel), _vectors(disk_from_square(points[:, rank - 2 :]))
    if side == "front":  # from outside, the file's frame is seen in a mirror
        wi, wo = wi * [1, -1, 1], wo * [1, -1, 1]
    quantity, words = stated_quantity(options, "brdf", "BRDF")
    words += [
        *notes,
        f"Values are averages over the tree's {count:,} patches: directions are their centres. A wide patch "
        f"is there at every incidence it covers, and in parts of 1/{1 << _FINE} of the outgoing side.",
        *([MIRRORED] if side == "front" else []), *said,
    ]  # fmt: skip
    reading = Reading(
        NAME, quantity, value, channels, name=layer.element.words("Material", "Name"), item=item,
        symmetry="isotropic" if rank == 3 else "anisotropic", notes=tuple(words),
        provenance={**provenance_of(layer, side), "rank": rank},
    )  # fmt: skip
    geometry = geo.from_directions(wi, wo, "vectors", symmetric=rank == 3)
    return assemble(source, options, reading, geometry)
