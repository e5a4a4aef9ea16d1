"""Lights: what arrives at points, sampled, and what rays that end nowhere or pass a lamp see."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from fitter.errors import SpecError
from fitter.scene.shapes import flat_frame
from fitter.scene.spec import AreaLight, DirectionalLight, Environment, Light, PointLight

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Lamp:
    """A light in numbers: level (C,) irradiance, intensity or radiance.

    place (3,) : direction towards it, position, or centre. frame (3, 3), half (2,) : of area lights.
    picture (H, W, C) : of environments, radiance over ``level``.
    """

    kind: str
    level: FloatArray
    place: FloatArray
    frame: FloatArray | None = None
    half: FloatArray | None = None
    picture: FloatArray | None = None

    @property
    def is_delta(self) -> bool:
        """Whether it has no extent: no random ray ever meets it."""
        return self.kind in ("directional", "point")


def lamp(one: Light, channels: tuple[str, ...], folder: Path | None, k: int) -> Lamp:
    """Light ``k`` of a scene. Raises SpecError where an environment's file is not one."""

    def level(given: float | tuple[float, ...]) -> FloatArray:
        return np.broadcast_to(np.asarray(given, np.float64), (len(channels),)).copy()

    if isinstance(one, DirectionalLight):
        towards = np.array(one.direction, float)
        return Lamp("directional", level(one.irradiance), towards / np.linalg.norm(towards))
    if isinstance(one, PointLight):
        return Lamp("point", level(one.intensity), np.array(one.position, float))
    if isinstance(one, AreaLight):
        half = 0.5 * np.array(one.size)
        return Lamp("area", level(one.radiance), np.array(one.center, float), flat_frame(one), half)
    assert isinstance(one, Environment)
    if one.radiance is not None:
        return Lamp(
            "environment",
            one.scale * level(one.radiance),
            np.zeros(3),
            picture=np.ones((1, 1, len(channels))),
        )
    if folder is None:
        raise SpecError(
            "an environment can't be a file here", code="no-files", parameter=f"lights.{k}.file",
            remedy="give its radiance",
        )  # fmt: skip
    from fitter.scene.environment import read

    picture = read(folder / str(one.file), channels)
    return Lamp("environment", level(one.scale), np.zeros(3), picture=picture)


class Arriving(NamedTuple):
    """Light at points (N,): unit directions towards it, distances, radiance over density or irradiance
    (N, C) before the cosine, and the density pdf (N,) of the direction (0 of lights without extent)."""

    towards: Array
    distance: Array
    light: Array
    pdf: Array


@jax.jit
def from_directional(place: Array, level: Array, point: Array) -> Arriving:
    n = len(point)
    far = jnp.full((n,), jnp.inf, point.dtype)
    return Arriving(
        jnp.broadcast_to(place, point.shape), far, jnp.broadcast_to(level, (n, len(level))), 0.0 * point[:, 0]
    )


@jax.jit
def from_point(place: Array, level: Array, point: Array) -> Arriving:
    away = place - point
    # A point that lies in the lamp is as bright as one a millionth away.
    squared = jnp.maximum(jnp.sum(away * away, axis=1), 1e-12)
    distance = jnp.sqrt(squared)
    return Arriving(away / distance[:, None], distance, level / squared[:, None], 0.0 * distance)


@jax.jit
def from_area(place: Array, frame: Array, half: Array, level: Array, point: Array, u: Array) -> Arriving:
    """Uniform on the rectangle, u (N or 1, 2)."""
    at = (2.0 * u - 1.0) * half
    away = place + at[:, :1] * frame[0] + at[:, 1:] * frame[1] - point
    squared = jnp.maximum(jnp.sum(away * away, axis=1), 1e-12)
    distance = jnp.sqrt(squared)
    towards = away / distance[:, None]
    cosine = jnp.maximum(-jnp.sum(towards * frame[2], axis=1), 0.0)
    faces = cosine > 0
    density = jnp.where(faces, squared / (jnp.where(faces, cosine, 1.0) * 4.0 * half[0] * half[1]), 0.0)
    light = jnp.where(faces, 1.0 / jnp.where(faces, density, 1.0), 0.0)[:, None] * level
    return Arriving(towards, distance, light, density)


def points(each_way: int, panels: int = 1) -> list[tuple[FloatArray, float]]:
    """Points (1, 2) of a rectangle, in place of random u, and the share of its light each stands for: the
    product rule of Gauss and Legendre, on panels x panels parts of it."""
    x, w = np.polynomial.legendre.leggauss(each_way)
    x = ((0.5 * (1.0 + x) + np.arange(panels)[:, None]) / panels).reshape(-1)
    w = np.tile(0.5 * w / panels, panels)
    ends = list(zip(x, w, strict=True))
    return [(np.array([[a, b]]), float(p * q)) for a, p in ends for b, q in ends]


@jax.jit
def seen_area(
    place: Array, frame: Array, half: Array, level: Array, o: Array, d: Array, reach: Array
) -> tuple[Array, Array]:
    """Radiance (N, C) that rays see of the rectangle nearer than ``reach``, and the density of drawing it."""
    down = -jnp.sum(d * frame[2], axis=1)
    faces = down > 0
    safe = jnp.where(faces, down, 1.0)
    t = jnp.sum((o - place) * frame[2], axis=1) / safe
    at = o + t[:, None] * d - place
    inside = (jnp.abs(jnp.sum(at * frame[0], axis=1)) <= half[0]) & (
        jnp.abs(jnp.sum(at * frame[1], axis=1)) <= half[1]
    )
    seen = faces & (t > 0) & (t < reach) & inside
    density = jnp.where(seen, t * t / (safe * 4.0 * half[0] * half[1]), 0.0)
    return jnp.where(seen[:, None], level, 0.0), density


class Sky(NamedTuple):
    """An environment: radiance (H, W, C), and what directions are drawn by: a density of pixels, constant in
    each, as running sums over rows (H,) and within them (H, W), and per unit solid angle (H, W)."""

    picture: Array
    rows: Array
    columns: Array
    density: Array

    @staticmethod
    def of(one: Lamp, dtype: np.dtype[np.floating]) -> Sky:
        assert one.picture is not None
        picture = one.picture * one.level
        height, width = picture.shape[:2]
        edges = np.cos(np.pi * np.arange(height + 1) / height)
        size = (edges[:-1] - edges[1:])[:, None] * (2 * math.pi / width)
        mean = picture.mean(axis=2)
        # Interpolated between pixels, radiance reaches into neighbours that are black themselves.
        up = np.pad(mean, ((1, 1), (0, 0)), mode="edge")
        wide = np.pad(up, ((0, 0), (1, 1)), mode="wrap")
        around = sum(
            wide[1 + a : 1 + a + height, 1 + b : 1 + b + width] for a in (-1, 0, 1) for b in (-1, 0, 1)
        )
        mass = np.asarray(around) * size
        if not mass.sum() > 0:
            mass = size + 0.0 * mass
        rows = mass.sum(axis=1)
        within = np.cumsum(mass, axis=1) / np.where(rows > 0, rows, 1.0)[:, None]
        return Sky(
            jnp.asarray(picture, dtype), jnp.asarray(np.cumsum(rows) / rows.sum(), dtype),
            jnp.asarray(within, dtype), jnp.asarray(mass / (size * rows.sum()), dtype),
        )  # fmt: skip


@jax.jit
def from_sky(sky: Sky, u: Array) -> Arriving:
    """Directions drawn by the sky's density, u (N, 2)."""
    height, width = sky.density.shape
    row = jnp.minimum(jnp.searchsorted(sky.rows, u[:, 0], side="right"), height - 1)
    low = jnp.where(row > 0, sky.rows[row - 1], 0.0)
    v = (u[:, 0] - low) / jnp.maximum(sky.rows[row] - low, 1e-30)
    sums = sky.columns[row]
    column = jnp.minimum(jnp.sum(sums <= u[:, 1:], axis=1), width - 1)
    start = jnp.where(
        column > 0, jnp.take_along_axis(sums, jnp.maximum(column - 1, 0)[:, None], 1)[:, 0], 0.0
    )
    end = jnp.take_along_axis(sums, column[:, None], 1)[:, 0]
    w = (u[:, 1] - start) / jnp.maximum(end - start, 1e-30)
    top, below = jnp.cos(math.pi * row / height), jnp.cos(math.pi * (row + 1) / height)
    z = (top + jnp.clip(v, 0.0, 1.0) * (below - top)).astype(u.dtype)
    phi = 2 * math.pi * (column + jnp.clip(w, 0.0, 1.0)).astype(u.dtype) / width
    s = jnp.sqrt(jnp.maximum((1.0 - z) * (1.0 + z), 0.0))
    towards = jnp.stack([s * jnp.cos(phi), s * jnp.sin(phi), z], axis=1)
    # By the look-up, so that rounding at pixels' edges gives no other density than a ray finds there.
    radiance, pdf = seen_sky(sky, towards)
    some = pdf > 0
    light = jnp.where(some[:, None], radiance / jnp.where(some, pdf, 1.0)[:, None], 0.0)
    return Arriving(towards, jnp.full(z.shape, jnp.inf, u.dtype), light, pdf)


@jax.jit
def seen_sky(sky: Sky, d: Array) -> tuple[Array, Array]:
    """Radiance (N, C) of directions, bilinear between pixels' centres, and the density of drawing them."""
    height, width = sky.density.shape
    theta = jnp.arctan2(jnp.sqrt(d[:, 0] ** 2 + d[:, 1] ** 2), d[:, 2])
    phi = jnp.arctan2(d[:, 1], d[:, 0])
    y = theta * (height / math.pi)
    x = jnp.where(phi < 0, phi + 2 * math.pi, phi) * (width / (2 * math.pi))
    row = jnp.clip(y.astype(int), 0, height - 1)
    column = jnp.clip(x.astype(int), 0, width - 1)
    pdf = sky.density[row, column]
    y, x = jnp.clip(y - 0.5, 0.0, height - 1.0), x - 0.5
    j, i = jnp.clip(jnp.floor(y).astype(int), 0, height - 1), jnp.floor(x).astype(int)
    b, a = (y - j)[:, None].astype(d.dtype), (x - i)[:, None].astype(d.dtype)
    below, left, right = jnp.minimum(j + 1, height - 1), i % width, (i + 1) % width
    p = sky.picture
    radiance = (1 - b) * ((1 - a) * p[j, left] + a * p[j, right]) + b * (
        (1 - a) * p[below, left] + a * p[below, right]
    )
    return radiance, pdf
