"""Substitutes that no bound is known of, judged at random points of the picture: estimated, never bounded.

Of N points whose largest error is found, the probability that a share s of all points is further off is at
most (1 - s)^N; with N given the share is told that this makes 1 %.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitter.scene import kernels, lights, wording
from fitter.scene.assembly import Scene
from fitter.scene.integrate import Integrator, Points
from fitter.scene.kernels import Hit
from fitter.scene.materials import Material, ModelMaterial
from fitter.scene.regions import Region
from fitter.scene.settings import Settings

FloatArray = NDArray[np.float64]

#: Points of the picture that are tried, rays that may be spent to find them, and how sure the
#: share of points is that is told.
_POINTS, _RAYS, CONFIDENCE = 1024, 1 << 16, 0.99
#: Of fewer points too little follows.
_FEWEST = 200
#: Points each way and panels of a lamp that what stands for it is compared with.
_FINE = (2, 8)
#: Of the error that is left at most this share may be estimated: more than what was met may be elsewhere.
SHARE = 0.5
#: The share of the light that may come from one point's part of a lamp.
_CELL = 0.1
#: Points each way that may stand for an area lamp.
LADDER = (1, 2)
_REPLACED = {1: "its centre", 2: "four points"}


@dataclass(frozen=True)
class Estimate:
    """The largest error met at ``points`` random points of the picture."""

    found: float
    points: int

    @property
    def share(self) -> float:
        """Of the picture's points at most this many are further off, with CONFIDENCE."""
        return 1.0 - (1.0 - CONFIDENCE) ** (1.0 / self.points) if self.points else 1.0

    def words(self) -> str:
        return (
            f"at {self.points:,} random points the largest error is {wording.percent(self.found)}, and with "
            f"{CONFIDENCE:.0%} confidence at most {wording.percent(self.share)} of all points are further off"
        )

    def decision(self, effect: str, subject: str, gone: bool, sentence: str, **more: Any) -> dict[str, Any]:
        """The plan's entry."""
        return {
            "effect": effect, "subject": subject, "off": gone, "state": "estimated", "bound": None,
            "found": self.found, "boxes": 0, "points": self.points, "confidence": CONFIDENCE,
            "share": self.share, "sentence": f"{sentence}: {self.words()}", **more,
        }  # fmt: skip


class Probe:
    """Random points of the picture that show a shape, and the light that each lamp sends them straight.

    floor : the radiance that errors are relative to at least. rows : of all batches, those that pictures are
    rendered in, so that programs are compiled once. region : of the picture that the points are in.

    pixel (P,), places : of the points, and their primitives (P,) and positions (P, 3). tried : errors (P,) of
    points each way n in place of lamp k, by (k, n); alone : of leaving lamp k out, by k.
    """

    def __init__(
        self, scene: Scene, settings: Settings, floor: float, seed: int, rows: int, region: Region
    ) -> None:  # fmt: skip
        self.scene, self.floor, self.rows = scene, floor, rows
        self.tried: dict[tuple[int, int], FloatArray] = {}
        self.alone: dict[int, FloatArray] = {}
        self.pixel = np.zeros(0, np.intp)
        self.places = np.zeros(0, np.intp), np.zeros((0, 3))
        self.integrator = Integrator(scene, settings, np.dtype(np.float32))
        self.rng = np.random.default_rng([seed, 2**31 + 1])
        self.at, self.count = self._points(region, self.rng)
        self.lamps = settings.lit(0)
        self.materials = settings.direct

    def _points(self, region: Region, rng: np.random.Generator) -> tuple[Points | None, int]:
        one, rows = self.integrator, self.rows
        parts: list[list[NDArray[Any]]] = []
        found = 0
        wanted = min(_POINTS, rows)
        if not len(region.pixels):
            return None, 0
        for _ in range(max(_RAYS // rows, 1)):
            pixel = rng.choice(region.pixels, rows)
            u = jnp.asarray(rng.random((rows, 2)), one.dtype)
            o, d = kernels.camera_rays(one.basis, one.eye, one.size, jnp.asarray(pixel), u)
            hit = kernels.nearest(one.shapes, o, d, jnp.full(rows, -1))
            shown = np.flatnonzero(np.asarray(hit.primitive) >= 0)[: wanted - found]
            parts.append([np.asarray(part)[shown] for part in (*hit, d, pixel)])
            found += len(shown)
            if found == wanted:
                break
        if found < _FEWEST:
            return None, 0
        *joined, self.pixel = (np.concatenate(some) for some in zip(*parts, strict=True))
        self.places = joined[0], joined[2].astype(np.float64)
        each = rows // found
        filled = np.resize(np.repeat(np.arange(found), each), rows)
        *of_hit, d = (jnp.asarray(part[filled]) for part in joined)
        return one.points(Hit(*of_hit), d), found

    def light(
        self, k: int, materials: tuple[Material, ...], each_way: int, panels: int = 1
    ) -> FloatArray:  # fmt: skip
        """Radiance (P, C) that the points send back of lamp k, by :func:`fitter.scene.lights.points`."""
        assert self.at is not None
        count, each = self.count, self.rows // self.count
        if self.scene.lamps[k].is_delta:
            found = self.integrator.from_lamp(k, self.at, None, materials, 1.0)
            return np.asarray(found, np.float64)[: count * each : each]
        u, share = (np.array(part) for part in zip(*lights.points(each_way, panels), strict=True))
        total = np.zeros((count, self.integrator.count))
        for start in range(0, len(share), each):
            # What fills a batch up repeats its last point, and counts nothing.
            chosen = np.arange(start, start + each)
            weight = np.where(chosen < len(share), share[np.minimum(chosen, len(share) - 1)], 0.0)
            at = np.resize(u[np.minimum(chosen, len(share) - 1), 0], (self.rows, 2))
            found = np.asarray(self.integrator.from_lamp(k, self.at, at, materials, 1.0), np.float64)
            total += np.einsum("pqc,q->pc", found[: count * each].reshape(count, each, -1), weight)
        return total


    def resolved(self, k: int, materials: tuple[Material, ...], light: FloatArray) -> bool:
        """Whether the fine rule's points on lamp k see every lobe by which drawn directions meet it: no cell
        of one point may hold more than _CELL of the light (P, C)."""
        assert self.at is not None
        integrator = self.integrator
        if materials != integrator.settings.materials:
            settings = replace(integrator.settings, materials=materials)
            integrator = Integrator(self.scene, settings, np.dtype(np.float32))
        peak = np.asarray(integrator.peaks(k, self.at, self.rng), np.float64) / (_FINE[0] * _FINE[1]) ** 2
        owner = np.resize(np.repeat(np.arange(self.count), self.rows // self.count), self.rows)
        return bool((peak <= _CELL * np.maximum(light, self.floor)[owner]).all())


def lamps(probe: Probe, left: float) -> tuple[tuple[int, ...], list[dict[str, Any]], float]:
    """Of each lamp the points each way that stand for it (0: it is sampled), decisions, the joint error."""
    scene = probe.scene
    none: tuple[int, ...] = (0,) * len(scene.lamps)
    areas = [k for k in probe.lamps if scene.lamps[k].kind == "area"]
    if probe.at is None or not probe.lamps:
        return none, [], 0.0
    if any(isinstance(one, ModelMaterial) and one.has_ideal for one in scene.materials):
        return none, [_sampled(k, "mirrors show its shape") for k in areas], 0.0
    exact = _of_lamps(probe, probe.materials)
    whole = np.sum(list(exact.values()), axis=0)
    change = np.zeros_like(whole)
    probe.alone.update({k: _errors(light, whole, probe.floor) for k, light in exact.items()})
    chosen, decisions, error = list[int](none), list[dict[str, Any]](), 0.0
    for k in areas:
        if not probe.resolved(k, probe.materials, exact[k]):
            decisions.append(_sampled(k, "lobes are narrower than what a few points tell"))
            continue
        tried: list[Estimate] = []
        for each_way in LADDER:
            fewer = probe.light(k, probe.materials, each_way) - exact[k]
            probe.tried[k, each_way] = _errors(fewer, whole, probe.floor)
            tried.append(_largest(change + fewer, whole, probe.floor))
            if tried[-1].found <= SHARE * left:
                chosen[k], change, error = each_way, change + fewer, tried[-1].found
                break
        alone = wording.percent(tried[0].found)
        words = f"light {k} (area) " + (
            f"is {_REPLACED[chosen[k]]} where the camera looks" if chosen[k]
            else f"sampled (from its centre alone {alone} off), four points would not do"
        )  # fmt: skip
        one = tried[-1].decision("area light", str(k), bool(chosen[k]), words, points_each_way=chosen[k])
        if tried[-1].found > left:
            one["state"] = "needed"
        decisions.append(one)
    return tuple(chosen), decisions, error


def _sampled(k: int, why: str) -> dict[str, Any]:
    return wording.kept(str(k), "area light", f"light {k} (area) sampled, as {why}")


def stand_ins(
    probe: Probe, left: float
) -> tuple[tuple[Material, ...], list[dict[str, Any]], float]:  # fmt: skip
    """The materials with what may take their place, decisions, the error of all together."""
    scene, chosen, decisions, error = probe.scene, probe.materials, list[dict[str, Any]](), 0.0
    if probe.at is None or not any(scene.stand_ins):
        return chosen, [], 0.0
    exact = _of_lamps(probe, chosen)
    whole = np.sum(list(exact.values()), axis=0)
    for m, some in enumerate(scene.stand_ins):
        for source, other in some:
            changed = (*chosen[:m], other, *chosen[m + 1 :])
            lights = _of_lamps(probe, changed)
            found = _largest(np.sum(list(lights.values()), axis=0) - whole, whole, probe.floor)
            sharp = any(
                not probe.resolved(k, materials, light[k])
                for materials, light in ((chosen, exact), (changed, lights)) for k in light
                if scene.lamps[k].kind == "area"
            )  # fmt: skip
            gone = found.found <= SHARE * left and not sharp
            place = "in place of" if gone else "not in place of"
            words = f"{source} {place} the table of {scene.names[m]}"
            one = found.decision("raw table", scene.names[m], gone, words, stand_in=source)
            if found.found > left:
                one["state"] = "needed"
            decisions.append(one)
            if gone:
                chosen, error = changed, found.found
                break
    return chosen, decisions, error


def _of_lamps(probe: Probe, materials: tuple[Material, ...]) -> dict[int, FloatArray]:
    return {k: probe.light(k, materials, *_FINE) for k in probe.lamps}


def together(probe: Probe, direct: tuple[Material, ...], points: tuple[int, ...]) -> FloatArray:
    """The errors (P,) of all that a program does to light that comes straight from lamps."""
    if probe.at is None:
        return np.zeros(0)
    whole = np.sum(list(_of_lamps(probe, probe.materials).values()), axis=0)
    rules = {k: (points[k], 1) if points[k] else _FINE for k in probe.lamps}
    less = [probe.light(k, direct, *rule) for k, rule in rules.items()]
    return _errors(np.sum(less, axis=0) - whole, whole, probe.floor)


def precision(scene: Scene, floor: float, seed: int, rows: int) -> Estimate:
    """The error of float32 against float64: one sample of a pixel with everything on and the same random
    numbers, of pixels that show a shape."""
    total, everything = scene.spec.camera.width * scene.spec.camera.height, Settings.everything(scene)
    pixel = np.linspace(0, total - 1, rows).astype(np.intp)
    (single, _), (double, met) = (
        Integrator(scene, everything, np.dtype(kind)).batch(pixel, (seed, 2**31))
        for kind in (np.float32, np.float64)
    )
    single, double = (part[met].astype(np.float64) for part in (single, double))
    return _largest(single - double, double, floor)


def of_precision(found: Estimate, single: bool) -> dict[str, Any]:
    """The plan's entry."""
    words = "float32 in place of float64" if single else "float64: float32 would not do"
    one = found.decision("float64", "all", single, words)
    return one if single else {**one, "state": "needed"}


def _largest(change: FloatArray, whole: FloatArray, floor: float) -> Estimate:
    return Estimate(float(_errors(change, whole, floor).max(initial=0.0)), len(whole))


def _errors(change: FloatArray, whole: FloatArray, floor: float) -> FloatArray:
    """The errors (P,) of changes (P, C) of the light (P, C)."""
    against = np.maximum(whole, floor)
    error = np.where(against > 0, np.abs(change) / np.where(against > 0, against, 1.0), 0.0)
    return error.max(axis=1, initial=0.0)
