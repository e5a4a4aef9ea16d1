"""What stands between points: tried at single points, and proved over boxes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.scene.boxes import Angles, Boxes, Vector
from fitter.scene.intervals import Interval
from fitter.scene.lights import Lamp
from fitter.scene.surfaces import Surfaces

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: Boxes that a proof may take, pieces that a segment is cut into for it, and primitives that are tried at
#: most.
_BUDGET, _PIECES, _MOST = 4_000, 8, 200
#: So many hidden points are enough to give up a proof.
_WITNESSES = 8
#: Directions of a sky, by height and by azimuth.
_SKY = 16, 32


def spread(lamp: Lamp) -> list[tuple[float, float, float]]:
    """Points (s, t) of a lamp and the share of its light that each stands for."""
    if lamp.kind == "environment":
        n, m = _SKY
        return [((i + 0.5) / n, 2 * np.pi * (j + 0.5) / m, 1 / (n * m)) for i in range(n) for j in range(m)]
    if lamp.kind != "area":
        return [(0.0, 0.0, 1.0)]
    ends = (-2 / 3, 0.0, 2 / 3)
    return [(s, t, 1 / 9) for s in ends for t in ends]


def shown(surfaces: Surfaces, boxes: Boxes, angles: Angles) -> BoolArray:
    """Whether the camera sees the points (boxes of no size), within the picture."""
    point = np.stack([one.mid for one in angles.point], axis=1)
    away = surfaces.eye - point
    distance = np.linalg.norm(away, axis=1)
    towards = away / distance[:, None]
    return surfaces.view.shows(point) & ~_blocked(surfaces, point, towards, distance, boxes.primitive)


def shaded(surfaces: Surfaces, boxes: Boxes, angles: Angles) -> BoolArray:
    """Whether something stands between the points and those of their lamps."""
    point = np.stack([one.mid for one in angles.point], axis=1)
    towards, reach = np.zeros_like(point), np.full(len(point), np.inf)
    for k in np.unique(boxes.lamp).tolist():
        one, mine = surfaces.lamps[k], boxes.lamp == k
        if one.kind == "directional":
            towards[mine] = one.place
            continue
        place = np.broadcast_to(one.place, point.shape)
        if one.kind == "area" and one.frame is not None and one.half is not None:
            s, t = boxes.low[:, 2:3], boxes.low[:, 3:4]
            place = place + s * one.half[0] * one.frame[0] + t * one.half[1] * one.frame[1]
        away = (place - point)[mine]
        reach[mine] = np.linalg.norm(away, axis=1)
        towards[mine] = away / np.maximum(reach[mine], 1e-300)[:, None]
    return _blocked(surfaces, point, towards, reach, boxes.primitive)


def _blocked(
    surfaces: Surfaces, o: FloatArray, d: FloatArray, reach: FloatArray, skip: NDArray[np.intp]
) -> BoolArray:
    """(P,) whether a ray meets a primitive other than its own before ``reach``."""
    g = surfaces.scene.geometry
    s, r, _ = g.counts
    found = np.zeros(len(o), bool)
    near = 1e-9 * surfaces.size
    if s:
        away = o[:, None] - g.center
        b = (away * d[:, None]).sum(axis=2)
        rest = g.radius**2 - ((away - b[..., None] * d[:, None]) ** 2).sum(axis=2)
        t = -b - np.sqrt(np.maximum(rest, 0.0))
        hit = (rest > 0) & (t > near) & (t < reach[:, None]) & (skip[:, None] != np.arange(s))
        found |= hit.any(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        if r:
            away = o[:, None] - g.origin
            t = -(away * g.frame[:, 2]).sum(axis=2) / (d @ g.frame[:, 2].T)
            at = away + np.where(np.isfinite(t), t, 0.0)[..., None] * d[:, None]
            on = [np.abs((at * g.frame[:, k]).sum(axis=2)) <= g.half[:, k] for k in (0, 1)]
            hit = on[0] & on[1] & (t > near) & (t < reach[:, None]) & (skip[:, None] != s + np.arange(r))
            found |= hit.any(axis=1)
        if len(g.corner):
            p = np.cross(d[:, None], g.edge_2)
            scale = 1.0 / (g.edge_1 * p).sum(axis=2)
            away = o[:, None] - g.corner
            u = (away * p).sum(axis=2) * scale
            q = np.cross(away, g.edge_1)
            v, t = (d[:, None] * q).sum(axis=2) * scale, (g.edge_2 * q).sum(axis=2) * scale
            own = skip[:, None] == s + r + np.arange(len(g.corner))
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > near) & (t < reach[:, None]) & ~own
            found |= hit.any(axis=1)
    return found


def clear(surfaces: Surfaces, k: int) -> tuple[bool, int, Boxes]:
    """Whether nothing can stand between lamp k and any lit point of any surface, proved; boxes it took;
    points where something does."""
    count = len(surfaces.radius)
    boxes = _whole(surfaces, k)
    none = boxes.take(np.zeros(0, np.intp))
    # Light through a surface comes from behind it, and meets what lies there: itself, too.
    if any(one.transmits for one in surfaces.scene.materials):
        return False, 0, none
    if count == 1:
        return True, 0, none
    lamp = surfaces.lamps[k]
    if lamp.kind == "environment" or count > _MOST:
        return False, 0, none
    used = len(boxes)
    while len(boxes):
        angles = surfaces.angles(boxes)
        boxes = boxes.take(_lit(surfaces, angles) & doubtful(surfaces, boxes, angles.point, k))
        if not len(boxes):
            return True, used, none
        middle = boxes.middle()
        angles = surfaces.angles(middle)
        dark = shaded(surfaces, middle, angles) & _lit(surfaces, angles)
        if used > _BUDGET or dark.sum() >= _WITNESSES:
            return False, used, middle.take(dark)
        boxes = surfaces.halves(boxes)
        used += len(boxes)
    return True, used, none


def _whole(surfaces: Surfaces, k: int) -> Boxes:
    """All points of all primitives, the sides of spheres that the camera does not see, too."""
    found: Boxes | None = None
    for m in range(len(surfaces.scene.materials)):
        part = surfaces.start(m, (k,))
        found = part if found is None else found.join(part)
    assert found is not None
    sphere = found.primitive < surfaces.spheres
    first = sphere & (found.low[:, 0] == surfaces.low[found.primitive, 0])
    back = found.take(first)
    low, high = back.low.copy(), back.high.copy()
    high[:, 0], low[:, 0] = low[:, 0], -1.0
    return found.join(Boxes(back.primitive, back.lamp, low, high))


def _lit(surfaces: Surfaces, angles: Angles) -> BoolArray:
    """Where shadows count: without reflections only where the camera looks."""
    return (angles.lz.hi > 0) & (angles.seen | (surfaces.scene.spec.bounces > 0))


def doubtful(surfaces: Surfaces, boxes: Boxes, x: Vector, k: int) -> BoolArray:
    """(B,) whether a segment from a box, of points x, to the lamp may meet another primitive."""
    lamp = surfaces.lamps[k]
    if lamp.kind == "directional":
        far = 4.0 * surfaces.size
        d: Vector = (
            Interval.of(far * lamp.place[0]),
            Interval.of(far * lamp.place[1]),
            Interval.of(far * lamp.place[2]),
        )
    else:
        y = [Interval.of(np.full(len(boxes), c)) for c in lamp.place]
        if lamp.kind == "area" and lamp.frame is not None and lamp.half is not None:
            s, t = boxes.side(2), boxes.side(3)
            y = [
                y[c] + s * float(lamp.half[0] * lamp.frame[0, c]) + t * float(lamp.half[1] * lamp.frame[1, c])
                for c in range(3)
            ]
        d = (y[0] - x[0], y[1] - x[1], y[2] - x[2])
    # Shares of the way (rows), more of them near the surface, where other things are near in proportion.
    edges = ((np.arange(_PIECES + 1) / _PIECES) ** 2)[:, None]
    share = Interval(edges[:-1], edges[1:])
    p = [x[c] + share * d[c] for c in range(3)]
    found = np.zeros(len(boxes), bool)
    g = surfaces.scene.geometry
    for j in range(len(surfaces.radius)):
        other = boxes.primitive != j
        if j < surfaces.spheres:
            squared = sum(((p[c] - g.center[j, c]).squared() for c in range(3)), Interval.of(0.0))
            found |= other & (squared.lo <= g.radius[j] ** 2).any(axis=0)
            continue
        frame, low, high = surfaces.frame[j], surfaces.low[j], surfaces.high[j]
        local = [
            sum(((p[c] - surfaces.origin[j, c]) * float(frame[i, c]) for c in range(3)), Interval.of(0.0))
            for i in range(3)
        ]
        wide = 1e-9 * surfaces.size
        touches = (local[2].lo <= wide) & (local[2].hi >= -wide)
        for i in (0, 1):
            touches &= (local[i].lo <= high[i] + wide) & (local[i].hi >= low[i] - wide)
        found |= other & touches.any(axis=0)
    return found


def nothing_faces(surfaces: Surfaces) -> bool:
    """Whether no point of a surface sees one of another: one primitive, or flat ones with all else behind."""
    g = surfaces.scene.geometry
    if len(surfaces.radius) == 1:
        return True
    if surfaces.spheres or len(surfaces.radius) > _MOST:
        return False
    corners: list[FloatArray] = []
    for origin, frame, half in zip(g.origin, g.frame, g.half, strict=True):
        signs = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
        corners.append(origin + (signs * half) @ frame[:2])
    for corner, one, two in zip(g.corner, g.edge_1, g.edge_2, strict=True):
        corners.append(np.stack([corner, corner + one, corner + two]))
    wide = 1e-12 * surfaces.size
    for i in range(len(corners)):
        for j in range(len(corners)):
            if i == j:
                continue
            height = (corners[j] - surfaces.origin[i]) @ surfaces.frame[i, 2]
            back = (corners[i] - surfaces.origin[j]) @ surfaces.frame[j, 2]
            if (height > wide).any() and (back > wide).any():
                return False
    return True
