"""Wavefront OBJ: vertices and faces; polygons are cut into fans, all else is left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitter.errors import SpecError


def read(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Vertices (V, 3), triangles (T, 3) from 0, and the file's row (T,) of each. Raises SpecError."""
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SpecError(
            f"the mesh can't be read: {error}", code="mesh-unreadable", file=str(path),
            remedy="give the path of a Wavefront OBJ file, as seen from the scene file",
        ) from error  # fmt: skip
    vertices: list[list[float]] = []
    triangles: list[list[int]] = []
    rows: list[int] = []
    for row, line in enumerate(lines, 1):
        words = line.split("#", 1)[0].split()
        if not words or words[0] not in ("v", "f"):
            continue
        try:
            if words[0] == "v":
                vertices.append([float(word) for word in words[1:4]])
                if len(vertices[-1]) < 3 or not np.isfinite(vertices[-1]).all():
                    raise ValueError("a vertex needs three finite numbers")
                continue
            corners = [_index(word, len(vertices)) for word in words[1:]]
            if len(corners) < 3:
                raise ValueError("a face needs three vertices")
        except ValueError as error:
            raise SpecError(
                f"{line.strip()[:80]!r}: {error}", code="bad-mesh", file=str(path), row=row,
                remedy="write vertices as `v x y z` and faces as `f i j k`",
            ) from error  # fmt: skip
        for k in range(1, len(corners) - 1):
            triangles.append([corners[0], corners[k], corners[k + 1]])
            rows.append(row)
    if not triangles:
        raise SpecError("there is no face in it", code="bad-mesh", file=str(path))
    return np.array(vertices), np.array(triangles, np.int64), np.array(rows, np.int64)


def _index(word: str, count: int) -> int:
    """The vertex, from 0, that a face's word names: ``7``, ``7/1/2`` or, counted back, ``-1``."""
    given = int(word.split("/", 1)[0])
    index = given - 1 if given > 0 else count + given
    if given == 0 or not 0 <= index < count:
        raise ValueError(f"there is no vertex {given} yet")
    return index
