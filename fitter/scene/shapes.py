"""Geometry: shapes as arrays of spheres, rectangles and triangles, checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitter.errors import SpecError
from fitter.scene import obj
from fitter.scene.spec import AreaLight, Mesh, Plane, Plate, SceneSpec, Sphere

FloatArray = NDArray[np.float64]

#: Every ray is tried with every triangle.
MOST_TRIANGLES = 20_000
#: A triangle whose area is below this share of its longest side squared is degenerate.
_FLAT = 1e-12


@dataclass(frozen=True)
class Geometry:
    """All primitives, spheres first, then rectangles, then triangles; ``shape`` (P,) says whose each is.

    center (S, 3), radius (S,) : spheres. origin (R, 3), frame (R, 3, 3) rows tangent, bitangent, normal, half
    (R, 2) half sizes : rectangles. corner, edge_1, edge_2 (T, 3), triangle_frame (T, 3, 3) : triangles.
    """

    center: FloatArray
    radius: FloatArray
    origin: FloatArray
    frame: FloatArray
    half: FloatArray
    corner: FloatArray
    edge_1: FloatArray
    edge_2: FloatArray
    triangle_frame: FloatArray
    shape: NDArray[np.int32]

    @property
    def counts(self) -> tuple[int, int, int]:
        return len(self.radius), len(self.half), len(self.corner)


def geometry(spec: SceneSpec, folder: Path | None) -> Geometry:
    """The shapes of a scene. ``folder`` is what paths of meshes start from; None allows none.

    Raises SpecError: degenerate triangles, too many of them, a mesh that can't be read.
    """
    spheres = [(k, s) for k, s in enumerate(spec.shapes) if isinstance(s, Sphere)]
    planes = [(k, s) for k, s in enumerate(spec.shapes) if isinstance(s, Plane)]
    corners: list[FloatArray] = []
    owners: list[int] = [k for k, _ in spheres] + [k for k, _ in planes]
    tangents: list[FloatArray] = []
    for k, one in enumerate(spec.shapes):
        if isinstance(one, Plate | Mesh):
            found = _plate(one) if isinstance(one, Plate) else _mesh(one, k, folder)
            corners.append(found)
            owners += [k] * len(found)
            tangent = flat_frame(one)[0] if isinstance(one, Plate) else np.array([1.0, 0.0, 0.0])
            tangents.append(np.broadcast_to(tangent, (len(found), 3)))
    triangles = np.concatenate(corners) if corners else np.zeros((0, 3, 3))
    if len(triangles) > MOST_TRIANGLES:
        raise SpecError(
            f"the meshes have {len(triangles):,} triangles, and at most {MOST_TRIANGLES:,} are rendered",
            code="too-many-triangles", parameter="shapes", remedy="simplify the meshes",
        )  # fmt: skip
    e1, e2 = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normals = _unit(np.cross(e1, e2))
    wanted = np.concatenate(tangents) if tangents else np.zeros((0, 3))
    return Geometry(
        center=np.array([s.center for _, s in spheres], float).reshape(-1, 3),
        radius=np.array([s.radius for _, s in spheres], float),
        origin=np.array([s.center for _, s in planes], float).reshape(-1, 3),
        frame=np.array([flat_frame(s) for _, s in planes], float).reshape(-1, 3, 3),
        half=0.5 * np.array([s.size for _, s in planes], float).reshape(-1, 2),
        corner=triangles[:, 0], edge_1=e1, edge_2=e2, triangle_frame=frames(normals, wanted),
        shape=np.array(owners, np.int32),
    )  # fmt: skip


def flat_frame(one: Plane | Plate | AreaLight) -> FloatArray:
    """Rows tangent, bitangent, normal (3, 3) of a flat rectangle."""
    normal = _unit(np.array(one.normal, float))
    tangent = np.array([1.0, 0.0, 0.0] if one.tangent is None else one.tangent)
    return frames(normal[None], tangent[None])[0]


def frames(normal: FloatArray, tangent: FloatArray) -> FloatArray:
    """Right-handed frames (N, 3, 3) of unit normals and wished tangents (N, 3), y taken where x is none."""
    across = tangent - np.sum(tangent * normal, axis=-1, keepdims=True) * normal
    lost = np.linalg.norm(across, axis=-1) < 1e-6
    other = np.array([0.0, 1.0, 0.0]) - normal[:, 1:2] * normal
    x = _unit(np.where(lost[:, None], other, across))
    return np.stack([x, np.cross(normal, x), normal], axis=1)


def _unit(v: FloatArray) -> FloatArray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _plate(one: Plate) -> FloatArray:
    heights = np.array(one.heights, float)
    rows, columns = heights.shape
    x, y, z = flat_frame(one)
    u = one.size[0] * (np.arange(columns) / (columns - 1) - 0.5)
    v = one.size[1] * (np.arange(rows) / (rows - 1) - 0.5)
    points = np.array(one.center) + u[None, :, None] * x + v[:, None, None] * y + heights[..., None] * z
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    lower, upper = np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)
    return np.concatenate([lower.reshape(-1, 3, 3), upper.reshape(-1, 3, 3)])


def _mesh(one: Mesh, k: int, folder: Path | None) -> FloatArray:
    rows = None
    if one.obj is not None:
        if folder is None:
            raise SpecError(
                "a mesh can't be a file here", code="no-files", parameter=f"shapes.{k}.obj",
                remedy="give vertices and triangles",
            )  # fmt: skip
        vertices, triangles, rows = obj.read(folder / one.obj)
    else:
        vertices = np.array(one.vertices, float).reshape(-1, 3)
        triangles = np.array(one.triangles, np.int64).reshape(-1, 3)
        if not len(triangles) or triangles.min() < 0 or triangles.max() >= len(vertices):
            raise SpecError(
                f"triangles name vertices that are not among the {len(vertices)} there are",
                code="bad-mesh", parameter=f"shapes.{k}.triangles", remedy="count vertices from 0",
            )  # fmt: skip
    found = vertices[triangles]
    sides = found - np.roll(found, 1, axis=1)
    longest = (sides**2).sum(axis=2).max(axis=1)
    area = np.linalg.norm(np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0]), axis=1)
    bad = np.flatnonzero(~(area > _FLAT * longest))
    if len(bad):
        first = int(bad[0]) if rows is None else int(rows[bad[0]])
        raise SpecError(
            f"{len(bad)} of {len(found)} triangles are degenerate (of no area), the first is "
            f"{'number' if rows is None else 'that of row'} {first}",
            code="degenerate-triangles", parameter=f"shapes.{k}", file=one.obj,
            row=None if rows is None else first, cause="vertices that coincide or lie on a line",
            remedy="remove these faces",
        )  # fmt: skip
    return found


def check_camera(spec: SceneSpec, shapes: Geometry) -> None:
    """Raises SpecError where the camera is inside a sphere or a closed mesh, or on a surface."""
    eye = np.array(spec.camera.position)
    inside = np.flatnonzero(np.linalg.norm(shapes.center - eye, axis=1) <= shapes.radius)
    shape = int(shapes.shape[inside[0]]) if len(inside) else None
    local = np.einsum("rij,rj->ri", shapes.frame, eye - shapes.origin)
    on = (np.abs(local[:, :2]) <= shapes.half).all(axis=1) & (
        np.abs(local[:, 2]) <= 1e-9 * shapes.half.max(1)
    )
    if shape is None and on.any():
        shape = int(shapes.shape[len(shapes.radius) + int(np.flatnonzero(on)[0])])
    if shape is None:
        first = len(shapes.radius) + len(shapes.half)
        of = shapes.shape[first:]
        turns = winding(shapes, eye)
        for k in np.unique(of).tolist():
            # A closed mesh seen from inside covers the whole sphere of directions, an open one at most half.
            if turns[of == k].sum() > 0.75:
                shape = int(k)
    if shape is not None:
        raise SpecError(
            f"the camera is inside shape {shape}, a {spec.shapes[shape].kind}, or on its surface",
            code="camera-inside", parameter="camera.position", remedy="move the camera outside",
        )  # fmt: skip


def winding(shapes: Geometry, eye: FloatArray) -> FloatArray:
    """(T,) solid angle of each triangle over 4 pi, positive where its back is seen (A. Van Oosterom and
    J. Strackee 1983)."""
    a = shapes.corner - eye
    b, c = a + shapes.edge_1, a + shapes.edge_2
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    numerator = np.sum(a * np.cross(b, c), axis=1)
    dots = [np.sum(x * y, axis=1) for x, y in ((a, b), (b, c), (c, a))]
    denominator = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
    return np.arctan2(numerator, denominator) / (2 * np.pi)
