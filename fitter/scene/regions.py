"""Regions of a picture: tiles that share a program."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.scene.spec import Camera

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]


@dataclass(frozen=True)
class Tiles:
    """A picture cut into columns x rows tiles of whole pixels, counted by rows from above."""

    columns: int
    rows: int
    width: int
    height: int

    @staticmethod
    def of(camera: Camera, columns: int, rows: int) -> Tiles:
        """No more of them than there are pixels each way."""
        return Tiles(min(columns, camera.width), min(rows, camera.height), camera.width, camera.height)

    def __len__(self) -> int:
        return self.columns * self.rows

    @cached_property
    def edges(self) -> tuple[IntArray, IntArray]:
        """Pixels where columns (columns + 1,) and rows (rows + 1,) start and end."""
        return tuple(
            np.round(np.linspace(0, size, count + 1)).astype(np.intp)
            for size, count in ((self.width, self.columns), (self.height, self.rows))
        )  # pyright: ignore[reportReturnType]

    @property
    def lines(self) -> tuple[FloatArray, FloatArray]:
        """The edges of columns and rows in [-1, 1], left to right and down."""
        x, y = self.edges
        return 2.0 * x / self.width - 1.0, 2.0 * y / self.height - 1.0

    def of_pixel(self, pixel: IntArray) -> IntArray:
        """(N,) the tiles of pixels, which are counted by rows from above."""
        x, y = self.edges
        column = np.searchsorted(x, pixel % self.width, side="right") - 1
        row = np.searchsorted(y, pixel // self.width, side="right") - 1
        return row * self.columns + column


@dataclass(frozen=True)
class Region:
    """Some of the tiles of a picture."""

    tiles: Tiles
    chosen: frozenset[int]

    @staticmethod
    def whole(tiles: Tiles) -> Region:
        """All of them."""
        return Region(tiles, frozenset(range(len(tiles))))

    @property
    def outer(self) -> Region:
        """The whole picture as one tile."""
        return Region.whole(Tiles(1, 1, self.tiles.width, self.tiles.height))

    def rest(self, others: Iterable[Region]) -> Region:
        """What of it others leave."""
        return Region(self.tiles, self.chosen.difference(*(one.chosen for one in others)))

    @cached_property
    def pixels(self) -> IntArray:
        """(N,) in order."""
        of = self.tiles.of_pixel(np.arange(self.tiles.width * self.tiles.height))
        return np.flatnonzero(np.isin(of, sorted(self.chosen)))

    @property
    def mask(self) -> NDArray[np.bool_]:
        """(rows, columns) which tiles."""
        found = np.zeros(len(self.tiles), bool)
        found[sorted(self.chosen)] = True
        return found.reshape(self.tiles.rows, self.tiles.columns)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready: tiles as [column, row]."""
        return {
            "tiles": [[t % self.tiles.columns, t // self.tiles.columns] for t in sorted(self.chosen)],
            "of": [self.tiles.columns, self.tiles.rows], "pixels": len(self.pixels),
        }  # fmt: skip
