"""The directions that boxes (:mod:`fitter.scene.boxes`) enclose, of all primitives of a scene."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from fitter.scene.assembly import Scene
from fitter.scene.boxes import Angles, Boxes, FloatArray, IntArray, Vector, taken
from fitter.scene.intervals import Interval, about, cosine, increasing, sine, unit, unit_component
from fitter.scene.lights import Lamp
from fitter.scene.regions import Region, Tiles
from fitter.scene.views import View

#: By how much coordinates that were turned into a primitive's frame are widened, relative to the scene's
#: size.
_TURNED = 1e-14
#: Boxes that a rectangle or sphere starts with, each way.
_START = 4


@dataclass(frozen=True)
class _Spots:
    """What rectangles of surfaces have in common, whatever lights them: n.v, directions to the viewer, points
    in the primitive's frame and the world's, (cos, sin) of azimuths on spheres, and the sample's axis."""

    boxes: Boxes
    x: Vector
    v: Vector
    vz: Interval
    around: tuple[Interval, Interval]
    axis: tuple[Interval, Interval]
    world: Vector
    inside: NDArray[np.bool_]

    def take(self, index: IntArray) -> _Spots:
        names = (one.name for one in fields(self) if one.name != "boxes")
        return _Spots(self.boxes.take(index), **{name: taken(getattr(self, name), index) for name in names})


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
        corners = np.stack([g.corner, g.corner + g.edge_1, g.corner + g.edge_2], axis=1)
        #: More than any coordinate of a shape, a lamp or the camera.
        self.size = 1.0 + max(
            float(np.abs(part).max(initial=0.0))
            for part in (
                np.abs(g.center) + g.radius[:, None], np.abs(g.origin) + g.half.sum(axis=1)[:, None], corners,
                eye, *(np.abs(one.place) for one in self.lamps),
                *(np.abs(one.place) + one.half.sum() for one in self.lamps if one.half is not None),
            )
        )  # fmt: skip
        local = np.einsum("tij,tkj->tki", g.triangle_frame, corners - g.corner[:, None])[..., :2]
        self.triangle = local
        low, high = local.min(axis=1), local.max(axis=1)
        rims = np.stack([g.radius / self.distance, np.zeros(s)], axis=1).reshape(s, 2)
        ends = np.tile([1.0, 2 * np.pi], (s, 1)).reshape(s, 2)
        self.low = np.concatenate([rims, -g.half, low])
        self.high = np.concatenate([ends, g.half, high])
        self.material = scene.of_shape[g.shape]
        self.eye = eye
        self.view = View(scene.spec.camera, region, self.size)

    def coordinates(self, primitive: IntArray, point: FloatArray) -> FloatArray:
        """Points (P, 3) of primitives (P,) as coordinates (P, 2)."""
        frame = self.frame[primitive]
        local = np.einsum("bij,bj->bi", frame, point - self.origin[primitive])
        ball = primitive < self.spheres
        radius = np.where(ball, self.radius[primitive], 1.0)
        azimuth = np.arctan2(local[:, 1], local[:, 0]) % (2 * np.pi)
        on_ball = np.stack([local[:, 2] / radius, azimuth], axis=1)
        found = np.where(ball[:, None], on_ball, local[:, :2])
        return np.clip(found, self.low[primitive], self.high[primitive])

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

    def angles(self, boxes: Boxes, shared: tuple[Boxes, IntArray] | None = None) -> Angles:
        """Enclosures over boxes; ``shared`` are rectangles (lamps do not matter) and which of them each box
        is over."""
        spots = self._spots(boxes) if shared is None else self._spots(shared[0]).take(shared[1])
        on_sphere = boxes.primitive < self.spheres
        frame, origin = self.frame[boxes.primitive], self.origin[boxes.primitive]
        l, arriving = self._light(boxes, frame, origin, spots.x)
        sky = self._sky(boxes)
        vz, v = spots.vz, spots.v
        lz, l_t, v_t = l[2], (l[0], l[1]), (v[0], v[1])
        dot = (l[0] * v[0] + l[1] * v[1] + l[2] * v[2]).clip(-1, 1)
        if self.spheres and on_sphere.any():
            # Tangents along the meridian and the parallel: the viewer is on the axis.
            c, s = spots.around
            across = ((1.0 - vz) * (1.0 + vz)).clip(0, 1).sqrt()
            outward = l[0] * c + l[1] * s
            up, along = (about(boxes.side(0), outward, l[2], turn) for turn in (0.0, 0.5 * np.pi))
            turned = up, along, l[1] * c - l[0] * s
            # The sky's directions are about the normal already, from the viewer's side.
            up, along, aside = (
                one.where(sky, other) for one, other in zip((l[2], -l[0], -l[1]), turned, strict=True)
            )
            lz = up.clip(-1, 1).where(on_sphere, lz)
            l_t = along.where(on_sphere, l_t[0]), aside.where(on_sphere, l_t[1])
            level = Interval(np.full(len(boxes), -_TURNED), np.full(len(boxes), _TURNED))
            v_t = (-across).where(on_sphere, v_t[0]), level.where(on_sphere, v_t[1])
            inner = (lz * vz - along * across).clip(-1, 1)
            dot = inner.where(sky & on_sphere, inner.meet(dot).where(on_sphere, dot))
        seen = (lz.hi > 0) & (vz.hi > 0) & spots.inside & (arriving.hi > 0)
        return Angles(
            lz.clip(0.0, 1.0), vz.clip(0.0, 1.0), dot, l_t, v_t, spots.axis, arriving, seen, spots.world
        )

    def _spots(self, boxes: Boxes) -> _Spots:
        on_sphere = boxes.primitive < self.spheres
        frame, origin = self.frame[boxes.primitive], self.origin[boxes.primitive]
        a, b = boxes.side(0), boxes.side(1)
        zero, one = Interval.of(np.zeros(len(boxes))), Interval.of(np.ones(len(boxes)))
        x: Vector = (a, b, zero)
        around = axis = zero, one
        if self.spheres and on_sphere.any():
            # The point in the primitive's frame.
            c, s = around = cosine(b), sine(b)
            across = ((1.0 - a.clip(-1, 1)) * (1.0 + a.clip(-1, 1))).sqrt()
            r = Interval.of(self.radius[boxes.primitive])
            n = across * c, across * s, a
            x = (r * n[0]).where(on_sphere, a), (r * n[1]).where(on_sphere, b), (r * a).where(on_sphere, zero)
            # The sample's y axis is the world's z, projected.
            p, q, z = (Interval.of(frame[:, k, 2]) for k in range(3))
            out = p * c + q * s
            slack = Interval(np.array(-8 * _TURNED), np.array(8 * _TURNED))
            along, aside = a * out - across * z + slack, q * c - p * s + slack
            axis = (
                unit_component(along, aside.squared()).where(on_sphere, zero),
                unit_component(aside, along.squared()).where(on_sphere, one),
            )
        eye = self._local(frame, self.eye - origin)
        v = unit((eye[0] - x[0], eye[1] - x[1], eye[2] - x[2]))
        vz = v[2]
        if self.spheres and on_sphere.any():
            # n.v of a sphere is monotone in the one coordinate a.
            away = Interval.of(self.distance[np.minimum(boxes.primitive, self.spheres - 1)])
            vz = _seen_from(away, Interval.of(self.radius[boxes.primitive]), a).where(on_sphere, vz)
        world = self._world(frame, origin, x)
        return _Spots(boxes, x, v, vz, around, axis, world, self.view.may_show(world))

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
        return self.view.reached(self.angles(boxes).point, tiles)

    def _light(
        self, boxes: Boxes, frame: FloatArray, origin: FloatArray, x: Vector
    ) -> tuple[Vector, Interval]:  # fmt: skip
        """Directions to the lamp in the primitive's frame (the sky's: about the normal), and irradiance over
        level."""
        present = np.unique(boxes.lamp).tolist()
        if len(present) == 1:
            return self._from(self.lamps[present[0]], boxes, frame, origin, x)
        low, high = np.zeros((2, 4, len(boxes)))
        for k in present:
            mine = np.flatnonzero(boxes.lamp == k)
            l, arriving = self._from(
                self.lamps[k], boxes.take(mine), frame[mine], origin[mine], taken(x, mine)
            )
            for row, one in enumerate((*l, arriving)):
                low[row, mine], high[row, mine] = one.lo, one.hi
        found = [Interval(a, b) for a, b in zip(low, high, strict=True)]
        return (found[0], found[1], found[2]), found[3]

    def _from(
        self, one: Lamp, boxes: Boxes, frame: FloatArray, origin: FloatArray, x: Vector
    ) -> tuple[Vector, Interval]:
        count = len(boxes)
        s, t = boxes.side(2), boxes.side(3)
        if one.kind == "directional":
            found = self._local(frame, np.broadcast_to(one.place, (count, 3)))
            near = (found[0].clip(-1, 1), found[1].clip(-1, 1), found[2].clip(-1, 1))
            return near, Interval.of(np.ones(count))
        if one.kind == "environment":
            across = ((1.0 - s.clip(0, 1)) * (1.0 + s.clip(0, 1))).sqrt()
            assert one.picture is not None
            # Radiance times the solid angle of the hemisphere bounds what one direction may stand for; of its
            # other directions a picture may be dark.
            least, most = (2 * np.pi * float(end) for end in (one.picture.min(), one.picture.max()))
            level = Interval(np.full(count, least), np.full(count, most))
            return (across * cosine(t), across * sine(t), s), level
        place = self._local(frame, one.place - origin)
        if one.frame is None or one.half is None:
            d = (place[0] - x[0], place[1] - x[1], place[2] - x[2])
            return unit(d), _closeness(d)
        u = self._local(frame, np.broadcast_to(one.half[0] * one.frame[0], (count, 3)))
        w = self._local(frame, np.broadcast_to(one.half[1] * one.frame[1], (count, 3)))
        d = (
            place[0] + s * u[0] + t * w[0] - x[0], place[1] + s * u[1] + t * w[1] - x[1],
            place[2] + s * u[2] + t * w[2] - x[2],
        )  # fmt: skip
        l = unit(d)
        normal = self._local(frame, np.broadcast_to(one.frame[2], (count, 3)))
        faces = -(l[0] * normal[0] + l[1] * normal[1] + l[2] * normal[2])
        return l, _closeness(d) * faces.clip(0, 1) * (4.0 * float(one.half[0] * one.half[1]))

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


def _closeness(d: Vector) -> Interval:
    """1/d^2, of lamps no nearer than a millionth."""
    squared = (d[0].squared() + d[1].squared() + d[2].squared()).maximum(Interval.of(1e-12))
    return squared.reciprocal()


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
