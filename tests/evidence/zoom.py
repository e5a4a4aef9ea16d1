"""The largest error of a plan's settings, by zooming: random points of the picture, then nearer to the worst.

Direct light only, which reflections between shapes add to: by the program's own rays, lamps and models in
float64, none of the plan's enclosures. Area lamps are summed by Gauss and Legendre's points.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from fitter.scene import kernels, lights
from fitter.scene.assembly import Scene
from fitter.scene.integrate import Integrator
from fitter.scene.materials import ModelMaterial
from fitter.scene.settings import Settings

FloatArray = NDArray[np.float64]

#: Points at once; rounds of random ones and of nearer ones; worst points that are gone on from, per setting.
_POINTS, _RANDOM, _ROUNDS, _BEST = 1_024, 2, 16, 4
#: Points of an area lamp, each way.
_LAMP = 4


class Zoom:
    """Errors of settings of one scene; ``floor`` is 0.01 F."""

    def __init__(self, found: Scene, floor: float) -> None:
        self.scene, self.floor = found, floor
        self.of = Integrator(found, Settings.everything(found), np.dtype(np.float64))
        self.lamp = lights.points(_LAMP)

    def largest(self, settings: Sequence[Settings], seed: int) -> FloatArray:
        """(N,) the largest errors met."""
        keys = [(one.first, *(getattr(m, "off", None) for m in one.direct)) for one in settings]
        apart = dict(zip(keys, settings, strict=True))
        met = dict(zip(apart, self._largest(list(apart.values()), seed).tolist(), strict=True))
        return np.array([met[key] for key in keys])

    def _largest(self, settings: Sequence[Settings], seed: int) -> FloatArray:
        rng = np.random.default_rng(seed)
        at = rng.random((_RANDOM * _POINTS, 2))
        parts = np.split(at, _RANDOM)
        met = np.concatenate([self.errors(part, settings) for part in parts], axis=1)
        each = _POINTS // (len(settings) * _BEST)
        for k in range(_ROUNDS):
            best = at[np.argsort(-met, axis=1)[:, :_BEST]].reshape(-1, 2)
            near = np.resize(np.repeat(best, each, axis=0), (_POINTS, 2))
            near = np.clip(near + (rng.random(near.shape) * 2 - 1) * 0.04 * 0.55**k, 0.0, 1.0 - 1e-12)
            at, met = np.concatenate([at, near]), np.concatenate([met, self.errors(near, settings)], axis=1)
        return met.max(axis=1)

    def errors(self, at: FloatArray, settings: Sequence[Settings]) -> FloatArray:
        """(N, P) at points of the picture, shares of its width and height."""
        of, scene, camera = self.of, self.scene, self.scene.spec.camera
        size = np.array([camera.width, camera.height])
        whole = np.floor(at * size)
        pixel = (whole[:, 1] * camera.width + whole[:, 0]).astype(np.intp)
        u = jnp.asarray(at * size - whole)
        o, d = kernels.camera_rays(of.basis, of.eye, of.size, jnp.asarray(pixel), u)
        hit = kernels.nearest(of.shapes, o, d, jnp.full(len(at), -1))
        v = kernels.to_local(hit.frame, -d)
        material = of.material_of[hit.primitive]
        every = [Settings.everything(scene), *settings]
        total = np.zeros((len(every), len(at), len(scene.spec.channels)))
        for k, lamp in enumerate(scene.lamps):
            for where, share in self.lamp if lamp.kind == "area" else [(np.zeros((1, 2)), 1.0)]:
                if lamp.kind == "area":
                    given = of.place[k], of.frame[k], of.half[k], of.level[k]
                    arriving = lights.from_area(*given, hit.point, jnp.asarray(where))
                else:
                    one = lights.from_directional if lamp.kind == "directional" else lights.from_point
                    arriving = one(of.place[k], of.level[k], hit.point)
                l = kernels.to_local(hit.frame, arriving.towards)
                dark = kernels.hidden(
                    of.shapes, hit.point, arriving.towards, hit.primitive, arriving.distance
                )
                light = np.where(np.asarray(dark)[:, None], 0.0, np.asarray(arriving.light)) * share
                values: dict[object, FloatArray] = {}
                for j, setting in enumerate(every):
                    if setting.first[k]:
                        total[j] += light * self._values(setting, material, l, v, values)
        error = np.abs(total[1:] - total[0]) / np.maximum(total[0], self.floor)
        return np.where(np.asarray(hit.primitive) >= 0, error.max(axis=2), 0.0)

    def _values(
        self, setting: Settings, material: Array, l: Array, v: Array, known: dict[object, FloatArray]
    ) -> FloatArray:
        total = np.zeros((len(l), len(self.scene.spec.channels)))
        for m, one in enumerate(setting.direct):
            assert isinstance(one, ModelMaterial)
            if (m, one.off) not in known:
                known[m, one.off] = np.asarray(one.value(l, v))
            total = np.where(np.asarray(material == m)[:, None], known[m, one.off], total)
        return total
