"""One sample of every ray of a batch: direct light by two strategies, and reflections between shapes.

Light sources with extent are met both by sampling them and by following the material's own directions,
weighted by the balance heuristic (E. Veach and L. Guibas 1995); sources without extent are summed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from fitter.scene import kernels, lights
from fitter.scene.assembly import Scene
from fitter.scene.kernels import Hit, Shapes
from fitter.scene.lights import Arriving, Lamp, Sky
from fitter.scene.materials import Drawn, Material, ModelMaterial, TableMaterial


@dataclass(frozen=True)
class Settings:
    """What a plan leaves of a scene.

    samples, first, shadows : of each lamp how many samples (with extent), whether it lights what the camera
    sees (reflections are lit by all), whether shapes may hide it. direct : the materials for light that comes
    straight from a lamp to what the camera sees; materials : those for all else.
    """

    bounces: int
    samples: tuple[int, ...]
    first: tuple[bool, ...]
    shadows: tuple[bool, ...]
    direct: tuple[Material, ...]
    materials: tuple[Material, ...]

    @staticmethod
    def everything(scene: Scene) -> Settings:
        count = len(scene.lamps)
        return Settings(
            bounces=scene.spec.bounces, samples=(scene.spec.light_samples,) * count, first=(True,) * count,
            shadows=(True,) * count, direct=scene.materials, materials=scene.materials,
        )  # fmt: skip

    def lit(self, depth: int) -> list[int]:
        """The lamps that light surfaces at this depth."""
        return [k for k, on in enumerate(self.first) if on or depth > 0]


class Integrator:
    """A scene's arrays in one dtype, and the sum over paths."""

    def __init__(self, scene: Scene, settings: Settings, dtype: np.dtype[np.floating]) -> None:
        self.scene, self.settings, self.dtype = scene, settings, dtype
        cast = partial(jnp.asarray, dtype=dtype)
        self.shapes = Shapes.of(scene.geometry, dtype)
        # One more shape for rays that meet none.
        owner = np.append(scene.of_shape[scene.geometry.shape], -1)
        self.material_of = jnp.asarray(owner)
        self.place = [cast(one.place) for one in scene.lamps]
        self.level = [cast(one.level) for one in scene.lamps]
        self.frame = [None if one.frame is None else cast(one.frame) for one in scene.lamps]
        self.half = [None if one.half is None else cast(one.half) for one in scene.lamps]
        self.skies = {k: Sky.of(one, dtype) for k, one in enumerate(scene.lamps) if one.kind == "environment"}
        camera = scene.spec.camera
        self.basis, self.eye = cast(kernels.camera_basis(camera)), cast(np.array(camera.position))
        self.size = jnp.asarray([camera.width, camera.height])

    def call(self, kernel: Any, *given: Any) -> Any:
        """Run a kernel. Where operations are counted (:mod:`fitter.scene.operations`), its calls are, too."""
        return kernel(*given)

    def batch(
        self, pixel: NDArray[np.intp], seed: tuple[int, ...]
    ) -> tuple[NDArray[Any], NDArray[np.bool_]]:  # fmt: skip
        """Radiance (N, C) of one random ray through each pixel, and which met a shape (N,).

        What is drawn for one purpose does not depend on what else is drawn: pictures of other settings and
        the same seed differ by their settings alone.
        """
        rng = _random(seed, 0, 0)
        u = jnp.asarray(rng.random((len(pixel), 2)), self.dtype)
        o, d = self.call(kernels.camera_rays, self.basis, self.eye, self.size, jnp.asarray(pixel), u)
        skip = jnp.full(len(pixel), -1)
        hit = self.call(kernels.nearest, self.shapes, o, d, skip)
        met = hit.primitive >= 0
        total = self._seen(o, d, hit.t, None, list(range(len(self.scene.lamps))))
        throughput = jnp.ones_like(total)
        for depth in range(self.settings.bounces + 1):
            more, o, d, skip, throughput, drawn, hit_next = self._scatter(hit, d, throughput, depth, seed)
            total = total + more
            if drawn is None:
                break
            total = total + throughput * self._seen(o, d, hit_next.t, drawn, self.settings.lit(depth))
            hit = hit_next
        return np.asarray(total), np.asarray(met)

    def _seen(self, o: Array, d: Array, reach: Array, drawn: Drawn | None, lamps: list[int]) -> Array:
        """Radiance of the lamps that rays meet, weighted against having been sampled at the rays' start."""
        total = jnp.zeros((len(o), len(self.scene.spec.channels)), self.dtype)
        for k in lamps:
            one, samples = self.scene.lamps[k], self.settings.samples[k]
            if one.is_delta:
                continue
            if one.kind == "area":
                lamp = self.place[k], self.frame[k], self.half[k], self.level[k]
                light, pdf = self.call(lights.seen_area, *lamp, o, d, reach)
            else:
                light, pdf = self.call(lights.seen_sky, self.skies[k], d)
                light = jnp.where(jnp.isinf(reach)[:, None], light, 0.0)
            if drawn is not None:
                own, ideal = jnp.asarray(drawn.pdf), jnp.asarray(drawn.is_delta)
                light = light * self.call(_share, own, pdf, samples, ideal)[:, None]
            total = total + light
        return total

    def _arriving(self, k: int, one: Lamp, point: Array, rng: np.random.Generator) -> Arriving:
        if one.kind == "directional":
            return self.call(lights.from_directional, self.place[k], self.level[k], point)
        if one.kind == "point":
            return self.call(lights.from_point, self.place[k], self.level[k], point)
        u = jnp.asarray(rng.random((len(point), 2)), self.dtype)
        if one.kind == "area":
            return self.call(
                lights.from_area, self.place[k], self.frame[k], self.half[k], self.level[k], point, u
            )
        return self.call(lights.from_sky, self.skies[k], u)

    def _scatter(
        self, hit: Hit, d: Array, throughput: Array, depth: int, seed: tuple[int, ...]
    ) -> tuple[Array, Array, Array, Array, Array, Drawn | None, Hit]:
        """Light that one scattering sends back along rays, and the rays that go on: their origin, direction,
        primitive, throughput, how they were drawn and what they meet."""
        settings, n = self.settings, len(d)
        materials = settings.direct if depth == 0 else settings.materials
        of = self.material_of[hit.primitive]
        v = self.call(kernels.to_local, hit.frame, -d)
        present = [m for m in range(len(materials)) if bool((of == m).any())]
        total = jnp.zeros_like(throughput)
        for k in settings.lit(depth):
            one, samples, shadow = self.scene.lamps[k], settings.samples[k], settings.shadows[k]
            rng = _random(seed, depth + 1, k + 1)
            for _ in range(1 if one.is_delta else samples):
                arriving = self._arriving(k, one, hit.point, rng)
                l = self.call(kernels.to_local, hit.frame, arriving.towards)
                f, pdf = self._values(materials, present, of, l, v, mis=not one.is_delta)
                part = self.call(_direct, throughput, f, arriving, pdf, 1 if one.is_delta else samples)
                if shadow:
                    dark = self.call(
                        kernels.hidden,
                        self.shapes,
                        hit.point,
                        arriving.towards,
                        hit.primitive,
                        arriving.distance,
                    )
                    part = jnp.where(dark[:, None], 0.0, part)
                total = total + part
        last = depth == settings.bounces
        if last and all(self.scene.lamps[k].is_delta for k in settings.lit(depth)):
            return total, hit.point, d, hit.primitive, throughput, None, hit
        drawn = self._draw(settings.materials, present, of, v, _random(seed, depth + 1, 0), n)
        out = self.call(kernels.to_world, hit.frame, jnp.asarray(drawn.towards, self.dtype))
        throughput = throughput * jnp.asarray(drawn.weight, self.dtype)
        onward = self.call(kernels.nearest, self.shapes, hit.point, out, hit.primitive)
        return total, hit.point, out, hit.primitive, throughput, drawn, onward

    def _values(
        self, materials: tuple[Material, ...], present: list[int], of: Array, l: Array, v: Array, *, mis: bool
    ) -> tuple[Array, Array]:
        """f |cos| (N, C) and the density of drawing l, 0 where it isn't wanted."""
        total = jnp.zeros((len(l), len(self.scene.spec.channels)), self.dtype)
        density = jnp.zeros(len(l), self.dtype)
        for m in present:
            one, lanes = materials[m], of == m
            if isinstance(one, TableMaterial):
                chosen = np.flatnonzero(np.asarray(lanes))
                found, some = np.zeros(total.shape), np.zeros(len(l))
                ll, vv = np.asarray(l)[chosen], np.asarray(v)[chosen]
                found[chosen] = one.value(ll, vv)
                if mis:
                    some[chosen] = one.pdf(ll, vv)
                total, density = total + found.astype(self.dtype), density + some.astype(self.dtype)
                continue
            assert isinstance(one, ModelMaterial)
            kernel, given = one.value_call(l, v)
            total = jnp.where(lanes[:, None], self.call(kernel, *given), total)
            if mis:
                kernel, given = one.pdf_call(l, v)
                density = jnp.where(lanes, self.call(kernel, *given), density)
        return total, density

    def _draw(
        self, materials: tuple[Material, ...], present: list[int], of: Array, v: Array,
        rng: np.random.Generator, n: int,
    ) -> Drawn:  # fmt: skip
        towards = jnp.zeros((n, 3), self.dtype).at[:, 2].set(1.0)
        weight = jnp.zeros((n, len(self.scene.spec.channels)), self.dtype)
        pdf, ideal = jnp.zeros(n, self.dtype), jnp.zeros(n, bool)
        for m in present:
            one, lanes = materials[m], of == m
            if isinstance(one, ModelMaterial):
                kernel, given = one.draw_call(v, rng)
                drawn = self.call(kernel, *given)
            else:
                # Of as many lanes as there are, so that draws don't depend on what else is in the picture.
                chosen = np.flatnonzero(np.asarray(lanes))
                few = one.draw(np.asarray(v)[chosen], rng)  # pyright: ignore[reportArgumentType]
                drawn = Drawn(*(_spread(part, chosen, n) for part in few))
            towards = jnp.where(lanes[:, None], jnp.asarray(drawn.towards, self.dtype), towards)
            weight = jnp.where(lanes[:, None], jnp.asarray(drawn.weight, self.dtype), weight)
            pdf = jnp.where(lanes, jnp.asarray(drawn.pdf, self.dtype), pdf)
            ideal = jnp.where(lanes, jnp.asarray(drawn.is_delta), ideal)
        return Drawn(towards, weight, pdf, ideal)


def _random(seed: tuple[int, ...], depth: int, purpose: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(np.random.SeedSequence([*seed, depth, purpose])))


def _spread(part: NDArray[Any], chosen: NDArray[np.intp], n: int) -> NDArray[Any]:
    whole = np.zeros((n, *part.shape[1:]), part.dtype)
    whole[chosen] = part
    return whole


@jax.jit
def _share(own: Array, other: Array, samples: int, ideal: Array) -> Array:
    """The balance heuristic's weight of a draw of density ``own`` against ``samples`` of ``other``."""
    safe = jnp.where(own > 0, own, 1.0)
    return jnp.where(ideal, 1.0, jnp.where(own > 0, 1.0 / (1.0 + samples * (other / safe)), 0.0))


@jax.jit
def _direct(throughput: Array, f: Array, arriving: Arriving, pdf: Array, samples: int) -> Array:
    """The share (N, C) of one of ``samples`` of a lamp; ``pdf`` is the material's density there."""
    some = arriving.pdf > 0
    weight = jnp.where(some, 1.0 / (samples + pdf / jnp.where(some, arriving.pdf, 1.0)), 1.0 / samples)
    return throughput * f * arriving.light * weight[:, None]
