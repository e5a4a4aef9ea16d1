"""One sample of every ray of a batch: direct light by two strategies, and reflections between shapes.

Light sources with extent are met both by sampling them and by following the material's own directions,
weighted by the balance heuristic (E. Veach and L. Guibas 1995); sources without extent are summed.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from fitter.scene import kernels, lights
from fitter.scene.assembly import Scene
from fitter.scene.kernels import Hit, Shapes
from fitter.scene.lights import Arriving, Lamp, Sky
from fitter.scene.materials import Drawn, Material, ModelMaterial
from fitter.scene.settings import Settings


class Points(NamedTuple):
    """Where rays met surfaces: towards the viewer in the surfaces' frames (N, 3), indices of materials (N,),
    -1 for none, and which there are."""

    hit: Hit
    v: Array
    of: Array
    present: list[int]


class Integrator:
    """A scene's arrays in one dtype, and the sum over paths."""

    def __init__(self, scene: Scene, settings: Settings, dtype: np.dtype[np.floating]) -> None:
        self.scene, self.settings, self.dtype = scene, settings, dtype
        cast = partial(jnp.asarray, dtype=dtype)
        self.shapes = Shapes.of(scene.geometry, dtype)
        # One more shape for rays that meet none.
        owner = np.append(scene.of_shape[scene.geometry.shape], -1)
        self.material_of = jnp.asarray(owner)
        merged = settings.channels
        self.lamps = scene.lamps if merged is None else tuple(map(merged.lamp, scene.lamps))
        #: Channels that are computed.
        self.count = len(scene.spec.channels) if merged is None else len(merged.columns)
        self.place = [cast(one.place) for one in self.lamps]
        self.level = [cast(one.level) for one in self.lamps]
        self.frame = [None if one.frame is None else cast(one.frame) for one in self.lamps]
        self.half = [None if one.half is None else cast(one.half) for one in self.lamps]
        self.skies = {k: Sky.of(one, dtype) for k, one in enumerate(self.lamps) if one.kind == "environment"}
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
        lamps = list(range(len(self.lamps)))
        if self.settings.blank:
            total = self._seen(o, d, jnp.full(len(pixel), jnp.inf, self.dtype), None, lamps)
            return self._apart(total), np.zeros(len(pixel), bool)
        hit = self.call(kernels.nearest, self.shapes, o, d, jnp.full(len(pixel), -1))
        met = hit.primitive >= 0
        total = self._seen(o, d, hit.t, None, lamps)
        throughput = jnp.ones_like(total)
        for depth in range(self.settings.bounces + 1):
            more, o, d, throughput, drawn, hit_next = self._scatter(hit, d, throughput, depth, seed)
            total = total + more
            if drawn is None:
                break
            met_lamps = [k for k in self.settings.lit(depth) if not self.settings.points_at(k, depth)]
            total = total + throughput * self._seen(o, d, hit_next.t, drawn, met_lamps)
            hit = hit_next
        return self._apart(total), np.asarray(met)

    def _apart(self, total: Array) -> NDArray[Any]:
        """All channels of those computed."""
        merged, radiance = self.settings.channels, np.asarray(total)
        return radiance if merged is None else merged.apart(radiance)

    def _seen(self, o: Array, d: Array, reach: Array, drawn: Drawn | None, lamps: list[int]) -> Array:
        """Radiance of the lamps that rays meet, weighted against having been sampled at the rays' start."""
        total = jnp.zeros((len(o), self.count), self.dtype)
        for k in lamps:
            one, samples = self.lamps[k], self.settings.samples[k]
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

    def points(self, hit: Hit, d: Array) -> Points:
        """What rays of directions d met."""
        of = self.material_of[hit.primitive]
        present = [m for m in range(len(self.settings.materials)) if bool((of == m).any())]
        return Points(hit, self.call(kernels.to_local, hit.frame, -d), of, present)

    def from_lamp(
        self,
        k: int,
        at: Points,
        u: NDArray[np.float64] | None,
        materials: tuple[Material, ...],
        share: float,
        *,
        mis: bool = False,
    ) -> Array:
        """Radiance (N, C) that points send back of lamp k, from where u (N or 1, 2) says on lamps with
        extent: of ``share``, one over the samples that there are; ``mis`` : weighted against the materials'
        own directions."""
        one = self.lamps[k]
        arriving = self._arriving(k, one, at.hit.point, u)
        l = self.call(kernels.to_local, at.hit.frame, arriving.towards)
        f, pdf = self._values(materials, at, l, mis=mis)
        part = self.call(_direct, f, arriving, pdf, 1.0 / share)
        if not self.settings.shadows[k]:
            return part
        dark = self.call(
            kernels.hidden, self.shapes, at.hit.point, arriving.towards, at.hit.primitive, arriving.distance
        )
        return jnp.where(dark[:, None], 0.0, part)

    def _arriving(self, k: int, one: Lamp, point: Array, u: NDArray[np.float64] | None) -> Arriving:
        if one.kind == "directional":
            return self.call(lights.from_directional, self.place[k], self.level[k], point)
        if one.kind == "point":
            return self.call(lights.from_point, self.place[k], self.level[k], point)
        drawn = jnp.asarray(u, self.dtype)
        if one.kind == "area":
            lamp = self.place[k], self.frame[k], self.half[k], self.level[k]
            return self.call(lights.from_area, *lamp, point, drawn)
        return self.call(lights.from_sky, self.skies[k], drawn)

    def _scatter(
        self, hit: Hit, d: Array, throughput: Array, depth: int, seed: tuple[int, ...]
    ) -> tuple[Array, Array, Array, Array, Drawn | None, Hit]:
        """Light that one scattering sends back along rays, and the rays that go on: their origin, direction,
        throughput, how they were drawn and what they meet."""
        settings, n = self.settings, len(d)
        materials = settings.direct if depth == 0 else settings.materials
        at = self.points(hit, d)
        total, sampled = jnp.zeros_like(throughput), False
        for k in settings.lit(depth):
            if self.lamps[k].is_delta:
                total = total + self.from_lamp(k, at, None, materials, 1.0)
            elif each_way := settings.points_at(k, depth):
                for u, share in lights.points(each_way):
                    total = total + self.from_lamp(k, at, u, materials, share)
            else:
                rng, sampled = _random(seed, depth + 1, k + 1), True
                for _ in range(settings.samples[k]):
                    u, share = rng.random((n, 2)), 1.0 / settings.samples[k]
                    total = total + self.from_lamp(k, at, u, materials, share, mis=True)
        total = throughput * total
        if depth == settings.bounces and not sampled:
            return total, hit.point, d, throughput, None, hit
        out, drawn, onward = self._onward(at, _random(seed, depth + 1, 0))
        throughput = throughput * jnp.asarray(drawn.weight, self.dtype)
        return total, hit.point, out, throughput, drawn, onward

    def _onward(self, at: Points, rng: np.random.Generator) -> tuple[Array, Drawn, Hit]:
        """Directions that the materials draw, how, and what they meet."""
        drawn = self._draw(at, rng)
        out = self.call(kernels.to_world, at.hit.frame, jnp.asarray(drawn.towards, self.dtype))
        return out, drawn, self.call(kernels.nearest, self.shapes, at.hit.point, out, at.hit.primitive)

    def peaks(self, k: int, at: Points, rng: np.random.Generator) -> Array:
        """Radiance (N, C) that points would send back of area lamp k, were all of it as bright as in the one
        direction that the materials draw; 0 where that misses the lamp."""
        out, drawn, onward = self._onward(at, rng)
        lamp = self.place[k], self.frame[k], self.half[k], self.level[k]
        light, density = lights.seen_area(*lamp, at.hit.point, out, onward.t)  # pyright: ignore[reportArgumentType]
        value = jnp.asarray(drawn.weight, self.dtype) * jnp.asarray(drawn.pdf, self.dtype)[:, None]
        met = density > 0
        return jnp.where(met[:, None], value * light / jnp.where(met, density, 1.0)[:, None], 0.0)

    def _values(
        self, materials: tuple[Material, ...], at: Points, l: Array, *, mis: bool
    ) -> tuple[Array, Array]:
        """f |cos| (N, C) and the density of drawing l (of what is drawn from), 0 where it isn't wanted."""
        v = at.v
        total = jnp.zeros((len(l), self.count), self.dtype)
        density = jnp.zeros(len(l), self.dtype)
        for m in at.present:
            lanes = at.of == m
            chosen = np.flatnonzero(np.asarray(lanes))

            def of_some(
                verb: Any, rest: tuple[int, ...] = (), chosen: NDArray[np.intp] = chosen
            ) -> NDArray[Any]:  # fmt: skip
                found = np.zeros((len(l), *rest))
                found[chosen] = verb(np.asarray(l)[chosen], np.asarray(v)[chosen])
                return found.astype(self.dtype)

            one, drawn_by = materials[m], self.settings.materials[m]
            if isinstance(one, ModelMaterial):
                kernel, given = one.value_call(l, v)
                total = jnp.where(lanes[:, None], self.call(kernel, *given), total)
            else:
                total = total + of_some(one.value, total.shape[1:])
            if not mis:
                continue
            if isinstance(drawn_by, ModelMaterial):
                kernel, given = drawn_by.pdf_call(l, v)
                density = jnp.where(lanes, self.call(kernel, *given), density)
            else:
                density = density + of_some(drawn_by.pdf)
        return total, density

    def _draw(self, at: Points, rng: np.random.Generator) -> Drawn:
        v, n = at.v, len(at.v)
        towards = jnp.zeros((n, 3), self.dtype).at[:, 2].set(1.0)
        weight = jnp.zeros((n, self.count), self.dtype)
        pdf, ideal = jnp.zeros(n, self.dtype), jnp.zeros(n, bool)
        for m in at.present:
            one, lanes = self.settings.materials[m], at.of == m
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
def _direct(f: Array, arriving: Arriving, pdf: Array, samples: float) -> Array:
    """The share (N, C) of one of ``samples`` of a lamp; ``pdf`` is the material's density there."""
    some = arriving.pdf > 0
    weight = jnp.where(some, 1.0 / (samples + pdf / jnp.where(some, arriving.pdf, 1.0)), 1.0 / samples)
    return f * arriving.light * weight[:, None]
