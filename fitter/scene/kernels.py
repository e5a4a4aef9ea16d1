"""Kernels of the renderer on batches of rays: rays, nearest hits, shadows. JAX, in the dtype of the rays."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from fitter.scene.shapes import Geometry
from fitter.scene.spec import Camera

#: Triangles that are tried at a time: what a batch of rays with all of a mesh would need is no memory to ask.
_TRIANGLES = 64
#: A ray that leaves a triangle ignores hits nearer than this share of its length scale.
_NEAR = 1e-5


class Shapes(NamedTuple):
    """:class:`fitter.scene.shapes.Geometry` in the dtype of the rays; triangles padded, what
    pads is never hit."""

    center: Array
    radius: Array
    origin: Array
    frame: Array
    half: Array
    corner: Array
    edge_1: Array
    edge_2: Array
    triangle_frame: Array

    @staticmethod
    def of(geometry: Geometry, dtype: np.dtype[np.floating]) -> Shapes:
        count = len(geometry.corner)
        padded = -(-count // _TRIANGLES) * _TRIANGLES - count if count > _TRIANGLES else 0

        def cast(a: np.ndarray, pad: int = 0) -> Array:
            return jnp.asarray(np.pad(a, [(0, pad), *[(0, 0)] * (a.ndim - 1)]), dtype)

        g = geometry
        return Shapes(
            cast(g.center), cast(g.radius), cast(g.origin), cast(g.frame), cast(g.half),
            *(cast(a, padded) for a in (g.corner, g.edge_1, g.edge_2, g.triangle_frame)),
        )  # fmt: skip


class Hit(NamedTuple):
    """Where rays end. primitive (N,) -1 for none; t (N,) infinite there; point (N, 3); frame (N, 3, 3): rows
    tangent, bitangent and outward normal."""

    primitive: Array
    t: Array
    point: Array
    frame: Array


@jax.jit
def camera_rays(basis: Array, eye: Array, size: Array, pixel: Array, u: Array) -> tuple[Array, Array]:
    """Origins and unit directions (N, 3) through random points u (N, 2) of pixels (N,), by rows from above.

    basis (3, 3) : rows right, down and forward, the first two over half a picture's width and height.
    """
    x = (pixel % size[0]).astype(u.dtype)
    y = (pixel // size[0]).astype(u.dtype)
    a = 2.0 * (x + u[:, 0]) / size[0].astype(u.dtype) - 1.0
    b = 2.0 * (y + u[:, 1]) / size[1].astype(u.dtype) - 1.0
    d = a[:, None] * basis[0] + b[:, None] * basis[1] + basis[2]
    d = d / jnp.sqrt(jnp.sum(d * d, axis=1, keepdims=True))
    return jnp.broadcast_to(eye, d.shape), d


def camera_basis(camera: Camera) -> np.ndarray:
    """The basis of :func:`camera_rays`."""
    forward = np.array(camera.look_at) - np.array(camera.position)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, np.array(camera.up))
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    high = np.tan(np.deg2rad(camera.fov_deg) / 2)
    return np.stack([right * high * camera.width / camera.height, down * high, forward])


@jax.jit
def nearest(shapes: Shapes, o: Array, d: Array, skip: Array) -> Hit:
    """The nearest hits of rays o + t d, t > 0, that leave primitives ``skip`` (N,) or, where -1, none."""
    t = _distances(shapes, o, d, skip)
    found = jnp.full(o.shape[:1], -1)
    best = jnp.full(o.shape[:1], jnp.inf, o.dtype)
    first = 0
    for part in t:
        if part is None:
            continue
        least, index, count = part
        nearer = least < best
        best = jnp.where(nearer, least, best)
        found = jnp.where(nearer, index + first, found)
        first += count
    point = o + jnp.where(jnp.isfinite(best), best, 0.0)[:, None] * d
    return Hit(found, best, *_surface(shapes, found, point))


@jax.jit
def hidden(shapes: Shapes, o: Array, d: Array, skip: Array, reach: Array) -> Array:
    """(N,) whether something lies between o and o + reach d."""
    t = _distances(shapes, o, d, skip)
    found = jnp.zeros(o.shape[:1], bool)
    for part in t:
        if part is not None:
            found = found | (part[0] < reach * (1.0 - 1e-4))
    return found


_Part = tuple[Array, Array, int] | None


def _distances(shapes: Shapes, o: Array, d: Array, skip: Array) -> tuple[_Part, _Part, _Part]:
    """The least distance (N,), its index and the count, of spheres, of rectangles and of triangles."""
    s, r, t = len(shapes.radius), len(shapes.half), len(shapes.corner)
    spheres = rectangles = triangles = None
    if s:
        spheres = _least(_spheres(shapes, o, d, skip), s)
    if r:
        rectangles = _least(_rectangles(shapes, o, d, skip, s), r)
    if 0 < t <= _TRIANGLES:
        triangles = _least(_triangles(shapes, o, d, skip, jnp.arange(t), s + r), t)
    elif t:

        def step(k: Array, so_far: tuple[Array, Array]) -> tuple[Array, Array]:
            index = k * _TRIANGLES + jnp.arange(_TRIANGLES)
            one = _triangles(shapes, o, d, skip, index, s + r)
            at = jnp.argmin(one, axis=1)
            least = jnp.min(one, axis=1)
            nearer = least < so_far[0]
            return jnp.where(nearer, least, so_far[0]), jnp.where(nearer, index[at], so_far[1])

        start = jnp.full(o.shape[:1], jnp.inf, o.dtype), jnp.zeros(o.shape[:1], jnp.int64)
        triangles = (*jax.lax.fori_loop(0, t // _TRIANGLES, step, start), t)
    return spheres, rectangles, triangles


def _least(t: Array, count: int) -> tuple[Array, Array, int]:
    return jnp.min(t, axis=1), jnp.argmin(t, axis=1), count


def _spheres(shapes: Shapes, o: Array, d: Array, skip: Array) -> Array:
    """(N, S) distances. A ray that leaves a sphere meets it again only on its way through the inside."""
    away = o[:, None] - shapes.center
    b = jnp.sum(away * d[:, None], axis=2)
    # The nearest point's distance from the centre, by components: no difference of squares.
    across = away - b[..., None] * d[:, None]
    rest = shapes.radius**2 - jnp.sum(across * across, axis=2)
    root = jnp.sqrt(jnp.maximum(rest, 0.0))
    own = skip[:, None] == jnp.arange(len(shapes.radius))
    near, far = -b - root, -b + root
    inside = jnp.where(b < 0, -2.0 * b, jnp.inf)
    t = jnp.where(near > 0, near, jnp.where(far > 0, far, jnp.inf))
    return jnp.where(own, inside, jnp.where(rest > 0, t, jnp.inf))


def _rectangles(shapes: Shapes, o: Array, d: Array, skip: Array, first: int) -> Array:
    away = o[:, None] - shapes.origin
    height = jnp.sum(away * shapes.frame[:, 2], axis=2)
    down = jnp.sum(d[:, None] * shapes.frame[:, 2], axis=2)
    t = jnp.where(down != 0, -height / jnp.where(down != 0, down, 1.0), jnp.inf)
    at = away + jnp.where(jnp.isfinite(t), t, 0.0)[..., None] * d[:, None]
    u = jnp.sum(at * shapes.frame[:, 0], axis=2)
    v = jnp.sum(at * shapes.frame[:, 1], axis=2)
    own = skip[:, None] == first + jnp.arange(len(shapes.half))
    ok = (t > 0) & (jnp.abs(u) <= shapes.half[:, 0]) & (jnp.abs(v) <= shapes.half[:, 1]) & ~own
    return jnp.where(ok, t, jnp.inf)


def _triangles(shapes: Shapes, o: Array, d: Array, skip: Array, index: Array, first: int) -> Array:
    """(N, T) distances (T. Moeller and B. Trumbore 1997)."""
    corner, e1, e2 = shapes.corner[index], shapes.edge_1[index], shapes.edge_2[index]
    p = jnp.cross(d[:, None], e2)
    det = jnp.sum(e1 * p, axis=2)
    some = det != 0
    scale = 1.0 / jnp.where(some, det, 1.0)
    away = o[:, None] - corner
    u = jnp.sum(away * p, axis=2) * scale
    q = jnp.cross(away, e1)
    v = jnp.sum(d[:, None] * q, axis=2) * scale
    t = jnp.sum(e2 * q, axis=2) * scale
    near = _NEAR * jnp.sqrt(jnp.sum(e1 * e1, axis=1))
    own = skip[:, None] == first + index
    ok = some & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > near) & ~own
    return jnp.where(ok, t, jnp.inf)


def _surface(shapes: Shapes, primitive: Array, point: Array) -> tuple[Array, Array]:
    """The points, put onto spheres exactly, and frames."""
    s, r, t = len(shapes.radius), len(shapes.half), len(shapes.corner)
    frame = jnp.broadcast_to(jnp.eye(3, dtype=point.dtype), (len(point), 3, 3))
    if s:
        k = jnp.clip(primitive, 0, s - 1)
        on = (primitive >= 0) & (primitive < s)
        n = point - shapes.center[k]
        n = n / jnp.sqrt(jnp.maximum(jnp.sum(n * n, axis=1, keepdims=True), 1e-30))
        point = jnp.where(on[:, None], shapes.center[k] + shapes.radius[k][:, None] * n, point)
        flat = n[:, 0] ** 2 + n[:, 1] ** 2
        pole = flat < 1e-12
        scale = 1.0 / jnp.sqrt(jnp.where(pole, 1.0, flat))
        x = jnp.stack(
            [jnp.where(pole, 1.0, -n[:, 1] * scale), jnp.where(pole, 0.0, n[:, 0] * scale), 0.0 * flat],
            axis=1,
        )
        x = x - jnp.sum(x * n, axis=1, keepdims=True) * n
        x = x / jnp.sqrt(jnp.sum(x * x, axis=1, keepdims=True))
        frame = jnp.where(on[:, None, None], jnp.stack([x, jnp.cross(n, x), n], axis=1), frame)
    if r:
        k = jnp.clip(primitive - s, 0, r - 1)
        on = (primitive >= s) & (primitive < s + r)
        frame = jnp.where(on[:, None, None], shapes.frame[k], frame)
    if t:
        k = jnp.clip(primitive - s - r, 0, t - 1)
        frame = jnp.where((primitive >= s + r)[:, None, None], shapes.triangle_frame[k], frame)
    return point, frame


@jax.jit
def to_local(frame: Array, w: Array) -> Array:
    """World directions (N, 3) in frames (N, 3, 3), of length 1 to rounding."""
    local = jnp.sum(frame * w[:, None], axis=2)
    return local / jnp.sqrt(jnp.sum(local * local, axis=1, keepdims=True))


@jax.jit
def to_world(frame: Array, w: Array) -> Array:
    """The inverse of :func:`to_local`."""
    world = jnp.sum(frame * w[..., None], axis=1)
    return world / jnp.sqrt(jnp.sum(world * world, axis=1, keepdims=True))
