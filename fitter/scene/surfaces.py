"""Boxes of surface points times points of lamps, and the directions that they enclose.

A box is a rectangle (a, b) of coordinates on one primitive (of its frame on rectangles and triangles; on
spheres a = cos of the angle from the centre's direction to the camera, b = azimuth about it), times, of area
lamps, a rectangle (s, t) in [-1, 1]^2, and of an environment all directions (s = cos theta, t = azimuth).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from fitter.scene import kernels
from fitter.scene.assembly import Scene
from fitter.scene.intervals import Interval, cosine, increasing, sine, unit_component
from fitter.scene.lights import Lamp
from fitter.scene.regions import Region, Tiles

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
Vector = tuple[Interval, Interval, Interval]
T = TypeVar("T")

#: By how much coordinates that were turned into a primitive's frame are widened, relative to the scene's
#: size.
_TURNED = 1e-14
#: Boxes that a rectangle or sphere starts with, each way.
_START = 4


@dataclass(frozen=True)
class Boxes:
    """B boxes: of primitive and lamp (B,), low and high (B, 4) in a, b, s, t."""

    primitive: IntArray
    lamp: IntArray
    low: FloatArray
    high: FloatArray

    def __len__(self) -> int:
        return len(self.lamp)

    def take(self, index: NDArray[Any]) -> Boxes:
        return Boxes(self.primitive[index], self.lamp[index], self.low[index], self.high[index])

    def join(self, other: Boxes) -> Boxes:
        return Boxes(
            np.concatenate([self.primitive, other.primitive]), np.concatenate([self.lamp, other.lamp]),
            np.concatenate([self.low, other.low]), np.concatenate([self.high, other.high]),
        )  # fmt: skip

    def middle(self) -> Boxes:
        """The boxes' centres, as boxes of no size."""
        mid = 0.5 * (self.low + self.high)
        return replace(self, low=mid, high=mid)

    def side(self, k: int) -> Interval:
        return Interval(self.low[:, k], self.high[:, k])


@dataclass(frozen=True)
class Angles:
    """Enclosures of what a reflectance depends on, (B,) each: cosines of light and viewer with the normal,
    their dot product, their tangential components, and the irradiance on a surface facing the light over the
    lamp's level. ``seen``: neither unlit, nor turned away, nor outside the picture for certain."""

    lz: Interval
    vz: Interval
    dot: Interval
    l: tuple[Interval, Interval]
    v: tuple[Interval, Interval]
    arriving: Interval
    seen: NDArray[np.bool_]
    point: Vector
    kept: dict[Hashable, Any] = field(default_factory=dict[Hashable, Any], compare=False)

    def once(self, key: Hashable, make: Callable[[], T]) -> T:
        """What is made of these angles, kept: sets of effects have most of it in common."""
        if key not in self.kept:
            self.kept[key] = make()
        return cast(T, self.kept[key])

    def take(self, index: NDArray[Any]) -> Angles:
        def cut(i: Interval) -> Interval:
            return Interval(i.lo[index], i.hi[index])

        return Angles(
            cut(self.lz), cut(self.vz), cut(self.dot), (cut(self.l[0]), cut(self.l[1])),
            (cut(self.v[0]), cut(self.v[1])), cut(self.arriving), self.seen[index],
            (cut(self.point[0]), cut(self.point[1]), cut(self.point[2])),
        )  # fmt: skip


class Surfaces:
    """All primitives of a scene, as boxes see them; ``region`` : of the picture, all of it by default."""

    def __init__(self, scene: Scene, region: Region | None = None) -> None:
        g = scene.geometry
        self.scene = scene
        self.lamps = scene.lamps
        eye = np.array(scene.spec.camera.position)
        s = len(g.radius)
        away = eye - g.center
        self.distance = np.linalg.norm(away, axis=1)
        axis = away / self.distance[:, None]
        x = np.where(np.abs(axis[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
        x = x - (x * axis).sum(axis=1, keepdims=True) * axis
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        spheres = np.stack([x, np.cross(axis, x), axis], axis=1).reshape(s, 3, 3)
        self.origin = np.concatenate([g.center, g.origin, g.corner])
        self.frame = np.concatenate([spheres, g.frame, g.triangle_frame])
        self.radius = np.concatenate([g.radius, np.zeros(len(g.half) + len(g.corner))])
        self.spheres = s
        self.size = float(
            np.abs(np.concatenate([self.origin, eye[None]])).max() + self.distance.max(initial=0) + 1
        )
        corners = np.stack([g.corner, g.corner + g.edge_1, g.corner + g.edge_2], axis=1)
        local = np.einsum("tij,tkj->tki", g.triangle_frame, corners - g.corner[:, None])[..., :2]
        self.triangle = local
        low, high = local.min(axis=1), local.max(axis=1)
        rims = np.stack([g.radius / self.distance, np.zeros(s)], axis=1).reshape(s, 2)
        ends = np.tile([1.0, 2 * np.pi], (s, 1)).reshape(s, 2)
        self.low = np.concatenate([rims, -g.half, low])
        self.high = np.concatenate([ends, g.half, high])
        self.material = scene.of_shape[g.shape]
        self.eye = eye
        region = region or Region.whole(Tiles.of(scene.spec.camera, 1, 1))
        # Of all tiles only the picture's own edges count.
        everything = len(region.chosen) == len(region.tiles)
        self.tiles = (region.outer if everything else region).mask
        self.planes = self._edges((region.outer if everything else region).tiles)

    def _edges(self, tiles: Tiles) -> tuple[FloatArray, FloatArray]:
        """Normals of planes through the eye and the edges of columns and of rows, to the right and down."""
        basis = kernels.camera_basis(self.scene.spec.camera)
        found = [
            np.stack([along / (along @ along) - line * basis[2] for line in lines])
            for along, lines in zip(basis, tiles.lines, strict=False)
        ]
        return found[0], found[1]

    def coordinates(self, primitive: IntArray, point: FloatArray) -> tuple[IntArray, FloatArray]:
        """Points (P, 3) of primitives (P,) as coordinates (P, 2)."""
        frame = self.frame[primitive]
        local = np.einsum("bij,bj->bi", frame, point - self.origin[primitive])
        ball = primitive < self.spheres
        radius = np.where(ball, self.radius[primitive], 1.0)
        azimuth = np.arctan2(local[:, 1], local[:, 0]) % (2 * np.pi)
        on_ball = np.stack([local[:, 2] / radius, azimuth], axis=1)
        found = np.where(ball[:, None], on_ball, local[:, :2])
        return primitive, np.clip(found, self.low[primitive], self.high[primitive])

    def start(self, material: int, lamps: tuple[int, ...]) -> Boxes:
        """Boxes that together hold all points of shapes of one material, and of lamps."""
        parts: list[Boxes] = []
        for primitive in np.flatnonzero(self.material == material).tolist():
            n = _START if primitive < len(self.radius) - len(self.triangle) else 1
            low, high = self.low[primitive], self.high[primitive]
            edges = [np.linspace(low[k], high[k], n + 1) for k in (0, 1)]
            i, j = (index.reshape(-1) for index in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
            for k in lamps:
                least, most = self.extent(k)
                count = n * n
                parts.append(
                    Boxes(
                        np.full(count, primitive), np.full(count, k),
                        np.stack([edges[0][i], edges[1][j], *(np.full(count, x) for x in least)], axis=1),
                        np.stack([edges[0][i + 1], edges[1][j + 1], *(np.full(count, x) for x in most)],
                        axis=1),
                    )
                )  # fmt: skip
        found = parts[0]
        for part in parts[1:]:
            found = found.join(part)
        return found

    def extent(self, k: int) -> tuple[tuple[float, float], tuple[float, float]]:
        """Low and high (s, t) of a lamp."""
        kind = self.lamps[k].kind
        if kind == "area":
            return (-1.0, -1.0), (1.0, 1.0)
        return ((0.0, 0.0), (1.0, 2 * np.pi)) if kind == "environment" else ((0.0, 0.0), (0.0, 0.0))

    def halves(self, boxes: Boxes) -> Boxes:
        """Both halves of each box, cut across the side that is longest beside the primitive's or lamp's."""
        whole = np.empty_like(boxes.low)
        whole[:, :2] = (self.high - self.low)[boxes.primitive]
        for k in np.unique(boxes.lamp).tolist():
            least, most = self.extent(k)
            whole[boxes.lamp == k, 2:] = np.maximum(np.subtract(most, least), 1e-300)
        widths = (boxes.high - boxes.low) / whole
        cut = np.argmax(widths, axis=1)
        rows = np.arange(len(boxes))
        mid = 0.5 * (boxes.low[rows, cut] + boxes.high[rows, cut])
        high, low = boxes.high.copy(), boxes.low.copy()
        high[rows, cut] = mid
        low[rows, cut] = mid
        return replace(boxes, high=high).join(replace(boxes, low=low))

    def angles(self, boxes: Boxes) -> Angles:
        """Enclosures over boxes."""
        on_sphere = boxes.primitive < self.spheres
        frame, origin = self.frame[boxes.primitive], self.origin[boxes.primitive]
        a, b = boxes.side(0), boxes.side(1)
        radius = self.radius[boxes.primitive]
        # The point and the normal in the primitive's frame.
        s = ((1.0 - a.clip(-1, 1)) * (1.0 + a.clip(-1, 1))).sqrt()
        zero, one = Interval.of(np.zeros(len(boxes))), Interval.of(np.ones(len(boxes)))
        n_b = cosine(b), sine(b)
        n: Vector = (
            (s * n_b[0]).where(on_sphere, zero), (s * n_b[1]).where(on_sphere, zero), a.where(on_sphere, one),
        )  # fmt: skip
        r = Interval.of(radius)
        x: Vector = (
            (r * n[0]).where(on_sphere, a),
            (r * n[1]).where(on_sphere, b),
            (r * n[2]).where(on_sphere, zero),
        )
        eye = self._local(frame, self.eye - origin)
        v = _unit((eye[0] - x[0], eye[1] - x[1], eye[2] - x[2]))
        away = (
            Interval.of(self.distance[np.minimum(boxes.primitive, max(self.spheres - 1, 0))])
            if self.spheres
            else zero
        )
        vz = v[2]
        if self.spheres:
            # n.v of a sphere is monotone in the one coordinate a.
            vz = _seen_from(away, r, a).where(on_sphere, vz)
        l, arriving, local = self._light(boxes, frame, origin, x, on_sphere, vz)
        lz = _about(n[2], l[0] * n_b[0] + l[1] * n_b[1], l[2]).where(on_sphere, l[2])
        lz = local[2].where(self._sky(boxes), lz)
        dot = (l[0] * v[0] + l[1] * v[1] + l[2] * v[2]).clip(-1, 1)
        sky_sphere = self._sky(boxes) & on_sphere
        if sky_sphere.any():
            # Light and viewer about the normal, azimuths from the viewer's.
            across = ((1.0 - vz) * (1.0 + vz)).sqrt()
            dot = (local[0] * across + local[2] * vz).clip(-1, 1).where(sky_sphere, dot)
        world = self._world(frame, origin, x)
        seen = (lz.hi > 0) & (vz.hi > 0) & self._in_picture(world) & (arriving.hi > 0)
        lz, vz = lz.clip(0.0, 1.0), vz.clip(0.0, 1.0)
        l_t, v_t = (l[0], l[1]), (v[0], v[1])
        if on_sphere.any():
            l_t, v_t = (self._tangential(frame, n, w, z, on_sphere) for w, z in ((l, lz), (v, vz)))
        if sky_sphere.any():
            # Azimuths are from the viewer's, wherever the tangents are.
            any_ = Interval(np.full(len(boxes), -1.0), np.full(len(boxes), 1.0))
            l_t, v_t = ((any_.where(sky_sphere, w[0]), any_.where(sky_sphere, w[1])) for w in (l_t, v_t))
        return Angles(lz, vz, dot, l_t, v_t, arriving, seen, world)

    def _tangential(
        self, frame: FloatArray, n: Vector, w: Vector, z: Interval, on_sphere: NDArray[np.bool_]
    ) -> tuple[Interval, Interval]:
        """Components along the tangents of a sphere, of which x runs along circles of latitude: with the
        world's axis p, (p x n).w and p.w - (p.n)(n.w), over |p x n|."""
        p: Vector = (Interval.of(frame[:, 0, 2]), Interval.of(frame[:, 1, 2]), Interval.of(frame[:, 2, 2]))
        # The frame's rows are unit vectors to rounding.
        wide = Interval(np.array(-4 * _TURNED), np.array(4 * _TURNED))
        up = (p[0] * n[0] + p[1] * n[1] + p[2] * n[2] + wide).clip(-1, 1)
        scale = ((1.0 - up) * (1.0 + up)).clip(0, 1).sqrt().reciprocal()
        across = [p[(k + 1) % 3] * n[(k + 2) % 3] - p[(k + 2) % 3] * n[(k + 1) % 3] for k in range(3)]
        x = (across[0] * w[0] + across[1] * w[1] + across[2] * w[2] + wide) * scale
        y = (p[0] * w[0] + p[1] * w[1] + p[2] * w[2] + wide - up * z) * scale
        return x.clip(-1, 1).where(on_sphere, w[0]), y.clip(-1, 1).where(on_sphere, w[1])

    def _sky(self, boxes: Boxes) -> NDArray[np.bool_]:
        kinds = np.array([one.kind == "environment" for one in self.lamps])
        return kinds[boxes.lamp]

    def _local(self, frame: FloatArray, w: FloatArray) -> Vector:
        turned = np.einsum("bij,bj->bi", frame, w)
        wide = _TURNED * self.size
        x, y, z = (Interval(turned[:, k] - wide, turned[:, k] + wide) for k in range(3))
        return x, y, z

    def _world(self, frame: FloatArray, origin: FloatArray, x: Vector) -> Vector:
        found = [
            sum((Interval.of(frame[:, j, k]) * x[j] for j in range(3)), Interval.of(origin[:, k]))
            for k in range(3)
        ]
        return found[0], found[1], found[2]

    def _in_picture(self, world: Vector) -> NDArray[np.bool_]:
        """(B,) whether boxes may reach into a tile of the region."""
        return np.asarray((self._reached(world, self.planes) & self.tiles[..., None]).any(axis=(0, 1)))

    def reached(self, tiles: Tiles, rounds: int = 6, most: int = 8_000) -> NDArray[np.bool_]:
        """(rows, columns) the tiles that a shape may reach into, whichever side of it."""
        first, *others = (self.start(m, (0,)) for m in np.unique(self.material).tolist())
        boxes = reduce(Boxes.join, others, first)
        # Points of lamps don't matter.
        boxes = replace(boxes, low=boxes.low * [1, 1, 0, 0], high=boxes.high * [1, 1, 0, 0])
        for _ in range(rounds):
            if 2 * len(boxes) > most:
                break
            boxes = self.halves(boxes)
        return np.asarray(self._reached(self.angles(boxes).point, self._edges(tiles)).any(axis=2))

    def _reached(self, world: Vector, planes: tuple[FloatArray, FloatArray]) -> NDArray[np.bool_]:
        """(rows, columns, B) whether boxes may reach into tiles."""
        away = [world[k] - self.eye[k] for k in range(3)]
        wide = 1e-9 * self.size
        reach: list[NDArray[np.bool_]] = []
        for normals in planes:
            heights = [sum((away[k] * n[k] for k in range(3)), Interval.of(0.0)) for n in normals]
            right = np.stack([h.hi >= -wide for h in heights[:-1]])
            left = np.stack([h.lo <= wide for h in heights[1:]])
            reach.append(right & left)
        columns, rows = reach
        return rows[:, None] & columns[None]

    def shows(self, point: FloatArray) -> NDArray[np.bool_]:
        """(P,) whether points (P, 3) lie in a tile of the region."""
        away = point - self.eye
        inside: list[NDArray[np.bool_]] = []
        for normals in self.planes:
            heights = away @ normals.T
            inside.append((heights[:, :-1] >= 0) & (heights[:, 1:] <= 0))
        columns, rows = inside
        return np.any(rows[:, :, None] & columns[:, None] & self.tiles, axis=(1, 2))

    def _light(
        self, boxes: Boxes, frame: FloatArray, origin: FloatArray, x: Vector, on_sphere: NDArray[np.bool_],
        vz: Interval,
    ) -> tuple[Vector, Interval, Vector]:  # fmt: skip
        """Directions to the lamp in the primitive's frame, irradiance over level, and those of the sky about
        the normal."""
        count = len(boxes)
        full = lambda: Interval(np.full(count, -1.0), np.full(count, 1.0))  # noqa: E731
        l: Vector = (full(), full(), full())
        arriving = Interval.of(np.zeros(count))
        s, t = boxes.side(2), boxes.side(3)
        local: Vector = (full(), full(), full())
        for k in np.unique(boxes.lamp).tolist():
            mine = boxes.lamp == k
            one: Lamp = self.lamps[k]
            scale = Interval.of(np.ones(count))
            if one.kind == "directional":
                found = self._local(frame, np.broadcast_to(one.place, (count, 3)))
                found = (found[0].clip(-1, 1), found[1].clip(-1, 1), found[2].clip(-1, 1))
            elif one.kind == "environment":
                across = ((1.0 - s.clip(0, 1)) * (1.0 + s.clip(0, 1))).sqrt()
                found = (across * cosine(t), across * sine(t), s)
                local = (
                    found[0].where(mine, local[0]),
                    found[1].where(mine, local[1]),
                    found[2].where(mine, local[2]),
                )
                assert one.picture is not None
                # Radiance times the solid angle of the hemisphere bounds what one direction may stand for.
                scale = Interval.of(np.full(count, 2 * np.pi * float(one.picture.max())))
            else:
                place = self._local(frame, one.place - origin)
                if one.kind == "area":
                    assert one.frame is not None
                    assert one.half is not None
                    u = self._local(frame, np.broadcast_to(one.half[0] * one.frame[0], (count, 3)))
                    w = self._local(frame, np.broadcast_to(one.half[1] * one.frame[1], (count, 3)))
                    place = (
                        place[0] + s * u[0] + t * w[0], place[1] + s * u[1] + t * w[1],
                        place[2] + s * u[2] + t * w[2],
                    )  # fmt: skip
                d = (place[0] - x[0], place[1] - x[1], place[2] - x[2])
                found = _unit(d)
                squared = (d[0].squared() + d[1].squared() + d[2].squared()).maximum(Interval.of(1e-12))
                scale = squared.reciprocal()
                if one.kind == "area":
                    assert one.frame is not None
                    assert one.half is not None
                    normal = self._local(frame, np.broadcast_to(one.frame[2], (count, 3)))
                    faces = -(found[0] * normal[0] + found[1] * normal[1] + found[2] * normal[2])
                    scale = scale * faces.clip(0, 1) * (4.0 * float(one.half[0] * one.half[1]))
            l = (found[0].where(mine, l[0]), found[1].where(mine, l[1]), found[2].where(mine, l[2]))
            arriving = scale.where(mine, arriving)
        return l, arriving, local

    def inside(self, boxes: Boxes) -> NDArray[np.bool_]:
        """Whether centres lie on their primitive: a triangle fills half of its rectangle."""
        found = np.ones(len(boxes), bool)
        first = len(self.radius) - len(self.triangle)
        chosen = np.flatnonzero(boxes.primitive >= first)
        if len(chosen):
            corners = self.triangle[boxes.primitive[chosen] - first]
            p = 0.5 * (boxes.low + boxes.high)[chosen, :2]
            turns = []
            for k in range(3):
                u, w = corners[:, k], corners[:, (k + 1) % 3]
                turns.append(
                    (w[:, 0] - u[:, 0]) * (p[:, 1] - u[:, 1]) - (w[:, 1] - u[:, 1]) * (p[:, 0] - u[:, 0])
                )
            found[chosen] = np.min(turns, axis=0) >= 0
        return found


def _unit(d: Vector) -> Vector:
    squares = [one.squared() for one in d]
    found = [unit_component(d[k], squares[(k + 1) % 3] + squares[(k + 2) % 3]) for k in range(3)]
    return found[0], found[1], found[2]


def _about(a: Interval, c: Interval, z: Interval) -> Interval:
    """sin(theta) c + cos(theta) z of a = cos(theta), theta in [0, pi]: r cos(theta - phi), every variable
    once, at either end of c and of z, in which it is linear."""
    theta = Interval(np.arccos(np.clip(a.hi, -1, 1)), np.arccos(np.clip(a.lo, -1, 1)))
    found: Interval | None = None
    for x in (c.lo, c.hi):
        for y in (z.lo, z.hi):
            r, phi = np.hypot(x, y), np.arctan2(x, y)
            turned = cosine(Interval(theta.lo - phi - 1e-15, theta.hi - phi + 1e-15))
            one = Interval(turned.lo * r - 4e-15 * r, turned.hi * r + 4e-15 * r)
            found = one if found is None else Interval(
                np.minimum(found.lo, one.lo), np.maximum(found.hi, one.hi)
            )
    assert found is not None
    return found.clip(-1, 1)


def _seen_from(distance: Interval, radius: Interval, a: Interval) -> Interval:
    """n.v = (D a - r)/sqrt(D^2 + r^2 - 2 r D a) of a sphere seen from distance D: increasing in a."""
    big, r = distance.mid, radius.mid

    def at(c: FloatArray) -> FloatArray:
        height = big * c - r
        across = big * np.sqrt(np.maximum((1 - c) * (1 + c), 0.0))
        length = np.hypot(height, across)
        return height / np.where(length > 0, length, 1.0)

    wide = 1e-14 * (big + r) / np.maximum(big - r, 1e-300)
    found = increasing(at(a.lo), at(a.hi))
    return Interval(found.lo - wide, found.hi + wide).clip(-1, 1)
