"""View: what the camera shows of points, and may show of boxes, in the tiles of a region."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.scene import kernels
from fitter.scene.boxes import FloatArray, Vector
from fitter.scene.intervals import Interval
from fitter.scene.regions import Region, Tiles
from fitter.scene.spec import Camera

BoolArray = NDArray[np.bool_]


class View:
    """Of a camera; ``region`` : of the picture, all of it by default; ``size`` : of the scene."""

    def __init__(self, camera: Camera, region: Region | None, size: float) -> None:
        self._eye, self._basis, self._size = np.array(camera.position), kernels.camera_basis(camera), size
        region = region or Region.whole(Tiles.of(camera, 1, 1))
        # Of all tiles only the picture's own edges count.
        region = region.outer if len(region.chosen) == len(region.tiles) else region
        self._mask, self._planes = region.mask, self._edges(region.tiles)

    def shows(self, point: FloatArray) -> BoolArray:
        """(P,) whether points (P, 3) lie in a tile of the region."""
        away = point - self._eye
        inside: list[BoolArray] = []
        for normals in self._planes:
            heights = away @ normals.T
            inside.append((heights[:, :-1] >= 0) & (heights[:, 1:] <= 0))
        columns, rows = inside
        return np.asarray((rows[:, :, None] & columns[:, None] & self._mask).any(axis=(1, 2)))

    def may_show(self, world: Vector) -> BoolArray:
        """(B,) whether boxes may reach into a tile of the region."""
        return np.asarray((self._reached(world, self._planes) & self._mask[..., None]).any(axis=(0, 1)))

    def reached(self, world: Vector, tiles: Tiles) -> BoolArray:
        """(rows, columns) the tiles that boxes may reach into."""
        return np.asarray(self._reached(world, self._edges(tiles)).any(axis=2))

    def _edges(self, tiles: Tiles) -> tuple[FloatArray, FloatArray]:
        """Normals of planes through the eye and the edges of columns and of rows, to the right and down."""
        columns, rows = (
            np.stack([along / (along @ along) - line * self._basis[2] for line in lines])
            for along, lines in zip(self._basis, tiles.lines, strict=False)
        )
        return columns, rows

    def _reached(self, world: Vector, planes: tuple[FloatArray, FloatArray]) -> BoolArray:
        """(rows, columns, B) whether boxes may reach into tiles."""
        away = [world[k] - self._eye[k] for k in range(3)]
        wide = 1e-9 * self._size
        reach: list[BoolArray] = []
        for normals in planes:
            heights = [sum((away[k] * n[k] for k in range(3)), Interval.of(0.0)) for n in normals]
            right = np.stack([h.hi >= -wide for h in heights[:-1]])
            left = np.stack([h.lo <= wide for h in heights[1:]])
            reach.append(right & left)
        columns, rows = reach
        return rows[:, None] & columns[None]
