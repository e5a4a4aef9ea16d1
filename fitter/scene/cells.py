"""Cells: rectangles of a primitive's coordinates, each with all points of the lamps, cut into pieces.

A cell is what an error is bounded over; the directions in it are enclosed by :mod:`fitter.scene.surfaces`, a
box for each piece of each lamp.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.scene.boxes import Boxes
from fitter.scene.surfaces import Surfaces

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]


@dataclass(frozen=True)
class Cells:
    """B cells: primitive (B,), low and high (B, 2), and how often lamps with extent are halved (B,)."""

    primitive: IntArray
    low: FloatArray
    high: FloatArray
    level: IntArray

    def __len__(self) -> int:
        return len(self.primitive)

    def take(self, index: NDArray[Any]) -> Cells:
        return Cells(self.primitive[index], self.low[index], self.high[index], self.level[index])

    def join(self, other: Cells) -> Cells:
        return Cells(
            np.concatenate([self.primitive, other.primitive]), np.concatenate([self.low, other.low]),
            np.concatenate([self.high, other.high]), np.concatenate([self.level, other.level]),
        )  # fmt: skip

    def middle(self) -> FloatArray:
        return 0.5 * (self.low + self.high)


@dataclass(frozen=True)
class Pieces:
    """I boxes; the cell and its piece each belongs to, and the share of the lamp that the piece is, (I,). The
    cells as boxes of no lamp."""

    cells: Boxes
    boxes: Boxes
    cell: IntArray
    piece: IntArray
    share: FloatArray


def start(surfaces: Surfaces, material: int) -> Cells:
    """All points of the shapes of a material."""
    found = surfaces.start(material, (0,))
    return Cells(found.primitive, found.low[:, :2], found.high[:, :2], np.zeros(len(found), np.intp))


def pieces(surfaces: Surfaces, cells: Cells, lamps: tuple[int, ...]) -> Pieces:
    """Every lamp's pieces, for every cell."""
    parts: list[tuple[IntArray, ...]] = []
    low, high, share = [], [], []
    first = np.zeros(len(cells), np.intp)
    for k in lamps:
        level = np.zeros_like(cells.level) if surfaces.lamps[k].is_delta else cells.level
        count = 1 << level
        cell = np.repeat(np.arange(len(cells)), count)
        own = np.arange(len(cell)) - np.repeat(np.cumsum(count) - count, count)
        least, most = np.array(surfaces.extent(k))
        # (s, t) of a lamp, halved in turn.
        rows = 1 << ((level[cell] + 1) // 2)
        at = np.stack([own % rows, own // rows], axis=1)
        size = np.stack([rows, count[cell] // rows], axis=1)
        low.append(np.concatenate([cells.low[cell], least + (most - least) * (at / size)], axis=1))
        high.append(np.concatenate([cells.high[cell], least + (most - least) * ((at + 1) / size)], axis=1))
        parts.append((cells.primitive[cell], np.full(len(cell), k), cell, first[cell] + own))
        share.append(1.0 / count[cell])
        first = first + count
    primitive, lamp, cell, piece = (np.concatenate(one) for one in zip(*parts, strict=True))
    boxes = Boxes(primitive, lamp, np.concatenate(low), np.concatenate(high))
    flat = np.zeros((len(cells), 2))
    alone = Boxes(
        cells.primitive, np.zeros(len(cells), np.intp), np.concatenate([cells.low, flat], axis=1),
        np.concatenate([cells.high, flat], axis=1),
    )  # fmt: skip
    return Pieces(alone, boxes, cell, piece, np.concatenate(share))


def halves(surfaces: Surfaces, cells: Cells) -> Cells:
    """Both halves of each cell, cut across the side that turns directions most; or the cell once, its lamps'
    pieces halved, where those span more."""
    turn = np.empty((len(cells), 3))
    wide = cells.high - cells.low
    ball = cells.primitive < surfaces.spheres
    a = np.clip(np.stack([cells.low[:, 0], cells.high[:, 0]]), -1, 1)
    theta = np.arccos(a)
    middle = cells.middle()
    frame = surfaces.frame[cells.primitive]
    point = surfaces.origin[cells.primitive] + np.einsum("bk,bki->bi", middle, frame[:, :2])
    normal = np.where(ball[:, None], surfaces.origin[cells.primitive], point)
    near = np.linalg.norm(surfaces.eye - normal, axis=1)
    span = np.zeros(len(cells))
    for one in surfaces.lamps:
        if one.kind == "environment":
            span = np.full(len(cells), np.pi)
        elif one.kind != "directional":
            away = np.linalg.norm(one.place - normal, axis=1)
            near = np.minimum(near, away)
            if one.half is not None:
                span = np.maximum(span, 2.0 * float(one.half.max()) / np.maximum(away, 1e-9))
    near = np.maximum(near, 1e-9)[:, None]
    turn[:, :2] = np.where(
        ball[:, None],
        np.stack([theta[0] - theta[1], wide[:, 1] * np.sin(theta[0])], axis=1), wide / near,
    )  # fmt: skip
    turn[:, 2] = 0.5 * span * 0.5 ** ((cells.level + 1) // 2)
    cut = np.argmax(turn, axis=1)
    lamps = cut == 2
    finer = cells.take(lamps)
    finer = Cells(finer.primitive, finer.low, finer.high, finer.level + 1)
    others, cut = cells.take(~lamps), cut[~lamps]
    rows = np.arange(len(others))
    mid = others.middle()[rows, cut]
    low, high = others.low.copy(), others.high.copy()
    high[rows, cut] = mid
    low[rows, cut] = mid
    first = Cells(others.primitive, others.low, high, others.level)
    return finer.join(first).join(Cells(others.primitive, low, others.high, others.level))
