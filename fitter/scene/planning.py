"""Plan: which effects of a scene can be left out, proved or measured, and what that saves."""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.progress import Progress, ignore
from fitter.scene import effects, fresnel, occlusion, operations, wording
from fitter.scene.assembly import Scene
from fitter.scene.boxes import Angles, Boxes
from fitter.scene.criteria import Criteria
from fitter.scene.effects import Off
from fitter.scene.integrate import Integrator, Settings
from fitter.scene.intervals import Interval
from fitter.scene.materials import Material, ModelMaterial
from fitter.scene.rendering import BATCH, padded, reference
from fitter.scene.search import Decision, hull
from fitter.scene.surfaces import Surfaces

FloatArray = NDArray[np.float64]

KIND = "brdf-fitter/plan"
#: Share of F below which radiance counts as that much.
FLOOR = 0.01
#: Effects of a material that all sets are tried of.
_MOST = 12


@dataclass(frozen=True)
class Plan:
    """The settings that a picture is rendered with, and the document that explains them."""

    settings: Settings
    document: Mapping[str, Any]


def plan(scene: Scene, *, tolerance: float | None = None, seed: int = 0, progress: Progress = ignore) -> Plan:
    """Which effects of the scene stay below ``tolerance`` (default: the scene's) together, everywhere.

    The error of a point of the picture is |L - L'| / max(L, 0.01 F), the largest of its channels.
    """
    began = time.perf_counter()
    progress(0.0, "pre-pass")
    floor = prepass(scene, seed)
    after = time.perf_counter()
    planner = _Planner(scene, scene.spec.tolerance if tolerance is None else tolerance, floor)
    settings, decisions, bound = planner.run(progress)
    planned = time.perf_counter()
    everything = Settings.everything(scene)
    progress(0.9, "counting operations")
    counted = {
        "all": operations.of_picture(scene, everything),
        "planned": operations.of_picture(scene, settings),
    }
    counts = {**counted, "saved": counted["all"] / max(counted["planned"], 1.0)}
    document = {
        "kind": KIND, "tolerance": planner.tolerance, "bound": bound, "reference": floor, "floor": FLOOR,
        "seed": seed, "decisions": decisions, "operations": counts,
        "seconds": {
            "prepass": after - began, "planning": planned - after, "counting": time.perf_counter() - planned,
        },
    }  # fmt: skip
    return Plan(settings, document)


def prepass(scene: Scene, seed: int) -> float:
    """F: the mean over pixels that show a shape of the radiance, of one sample each, clipped at its 99th
    percentile."""
    total = scene.spec.camera.width * scene.spec.camera.height
    size = min(BATCH, padded(total))
    pixel = np.linspace(0, total - 1, size).astype(np.intp)
    found, met = Integrator(scene, Settings.everything(scene), np.dtype(np.float32)).batch(
        pixel, (seed, 2**31)
    )
    return reference(found[None].astype(np.float64), met[None].astype(np.float64))


def constants_of(scene: Scene, m: int, surfaces: Surfaces | None = None) -> dict[str, Any]:
    """What replaces the Fresnel term of a material: per channel the value whose largest relative error over
    the scene is least."""
    one = scene.materials[m]
    if not isinstance(one, ModelMaterial) or "fresnel" not in effects.effects(one.model):
        return {}
    surfaces = surfaces or Surfaces(scene)

    def cosines(angles: Angles) -> tuple[FloatArray, FloatArray]:
        c = fresnel.facet_cosine(angles)
        return c.lo, c.hi

    low, high = hull(surfaces, surfaces.start(m, tuple(range(len(scene.lamps)))), cosines)
    low, high = min(max(low, 0.0), 1.0), min(max(high, 0.0), 1.0)
    c = Interval.of(np.linspace(min(low, high), max(low, high), 65))
    found: list[float] = []
    for k in range(len(one.model.channels)):
        f = fresnel.reflectance(one.model.spec, effects.of_channel(one.model, k), c).mid
        least, most = float(f.min()), float(f.max())
        found.append(2 * least * most / (least + most) if most > 0 else 0.0)
    # As the kernels hold it.
    return {"fresnel": np.asarray(found, np.float32).astype(np.float64)}


class _Planner:
    def __init__(self, scene: Scene, tolerance: float, floor: float) -> None:
        self.scene, self.tolerance, self.floor = scene, tolerance, floor * FLOOR
        self.surfaces = Surfaces(scene)
        self.lamps = tuple(range(len(scene.lamps)))
        #: Of each lamp whether nothing can stand before it, the boxes it took, points where it does.
        self.proofs = [occlusion.clear(self.surfaces, k) for k in self.lamps]
        self.clear = [found for found, *_ in self.proofs]
        self.criteria = Criteria(scene, self.surfaces, self.floor, self.clear)

    def run(self, progress: Progress) -> tuple[Settings, list[dict[str, Any]], float]:
        decisions: list[dict[str, Any]] = []
        everything = Settings.everything(self.scene)
        # Lamps first: each costs a whole evaluation of every material.
        dark, spent = self._dark(decisions)
        progress(0.2, "materials")
        direct: list[Material] = []
        worst = 0.0
        for m, one in enumerate(self.scene.materials):
            chosen, bound = self._material(m, one, self.tolerance - spent, decisions)
            direct.append(chosen)
            worst = max(worst, bound)
        progress(0.7, "shadows and bounces")
        shadows = tuple(self._shadow(k, decisions) for k in self.lamps)
        bounces = self._bounces(decisions)
        settings = replace(
            everything, first=tuple(k not in dark for k in self.lamps), shadows=shadows, bounces=bounces,
            direct=tuple(direct),
        )  # fmt: skip
        return settings, decisions, spent + worst

    # Materials --------------------------------------------------------------------------------------

    def _material(
        self, m: int, one: Material, left: float, decisions: list[dict[str, Any]]
    ) -> tuple[Material, float]:
        """The material with the cheapest set of effects whose joint bound is within what is ``left``."""
        name = self.scene.names[m]
        if not isinstance(one, ModelMaterial):
            decisions.append(wording.kept(name, "all", "a raw table has no effects to leave out"))
            return one, 0.0
        why = effects.unbounded(one.model)
        if why is not None:
            decisions.append(wording.kept(name, "all", why))
            return one, 0.0
        start = self.surfaces.start(m, self.lamps)
        constants = constants_of(self.scene, m, self.surfaces)
        full = operations.of_material(one)
        names = effects.effects(one.model)[:_MOST]
        alone = [frozenset({effect}) for effect in names]
        saved = {
            effect: full - operations.of_material(replace(one, off=off, constants=constants))
            for effect, off in zip(names, alone, strict=True)
        }
        single = dict(zip(names, self.criteria.decide(m, one, alone, constants, left), strict=True))
        free = [effect for effect, found in single.items() if found.state == "bounded" and saved[effect] > 0]
        chosen, bound = frozenset[str](), 0.0
        sets = self._sets(free, one, constants)
        known = dict(zip(alone, single.values(), strict=True))
        for off, found in zip(sets, self.criteria.first(m, one, sets, constants, left, known), strict=False):
            if found.state == "bounded":
                chosen, bound = off, found.bound
        degrees = self._lengths(start)
        for effect, found in single.items():
            decisions.append(
                wording.judged(name, effect, found, effect in chosen, saved[effect], full, degrees, free)
            )
        if not chosen:
            return one, 0.0
        return replace(one, off=chosen, constants=constants), bound

    def _sets(self, free: Sequence[str], one: ModelMaterial, constants: Mapping[str, Any]) -> list[Off]:
        """All compatible sets of effects, the cheapest program first."""
        every = [frozenset(some) for n in range(1, len(free) + 1) for some in itertools.combinations(free, n)]
        cost = {
            off: operations.of_material(replace(one, off=off, constants=constants))
            for off in every if effects.compatible(off)
        }  # fmt: skip
        return sorted(cost, key=lambda off: (cost[off], sorted(off)))

    def _lengths(self, start: Boxes) -> float:
        """The largest angle from the normal, degrees, that light or viewer make where something is seen."""

        def cosines(angles: Angles) -> tuple[FloatArray, FloatArray]:
            return np.minimum(angles.lz.lo, angles.vz.lo), np.maximum(angles.lz.hi, angles.vz.hi)

        low, _ = hull(self.surfaces, start, cosines)
        return float(np.rad2deg(np.arccos(min(max(low, 0.0), 1.0))))

    # Lamps, shadows, bounces ------------------------------------------------------------------------

    def _dark(self, decisions: list[dict[str, Any]]) -> tuple[set[int], float]:
        """Lamps that add nothing visible: the cheapest set whose bounds together are within half the
        tolerance (the other half is for the materials)."""
        bounds: dict[int, Decision] = {}
        for k in self.lamps if len(self.lamps) > 1 else ():
            others = [j for j in self.lamps if j != k and self.clear[j] and self.scene.lamps[j].is_delta]
            found = self._lamp(k, others)
            if found is not None:
                bounds[k] = found
        best: tuple[int, ...] = ()
        usable = [k for k, found in bounds.items() if found.state == "bounded"]
        for n in range(len(usable), 0, -1):
            fit = [
                some for some in itertools.combinations(usable, n)
                if sum(bounds[k].bound for k in some) <= 0.5 * self.tolerance
            ]  # fmt: skip
            if fit:
                best = min(fit, key=lambda some: sum(bounds[k].bound for k in some))
                break
        if len(best) == len(self.lamps):
            best = best[1:]
        for k, found in bounds.items():
            kind = self.scene.lamps[k].kind
            gone = k in best
            sentence = (
                f"light {k} ({kind}) off where the camera looks: error <= {100 * found.bound:.2g} %"
                if gone else f"light {k} ({kind}) kept: " + wording.reason(found)
            )  # fmt: skip
            decisions.append(wording.decision("light", str(k), found, gone, sentence))
        return set(best), sum(bounds[k].bound for k in best)

    def _lamp(self, k: int, others: Sequence[int]) -> Decision | None:
        """How much light k adds, beside that of ``others``, which nothing shades, and over 0.01 F at
        least."""
        if self.scene.lamps[k].kind == "environment" or self.floor == 0:
            return None
        worst: Decision | None = None
        for m, one in enumerate(self.scene.materials):
            if not isinstance(one, ModelMaterial) or (effects.unbounded(one.model) is not None):
                return None
            found = self.criteria.dark(k, tuple(others), m, one, self.tolerance)
            if found.state != "bounded":
                return found
            if worst is None or found.bound > worst.bound:
                worst = found
        return worst

    def _shadow(self, k: int, decisions: list[dict[str, Any]]) -> bool:
        """Whether rays to lamp k have to be tried."""
        clear, boxes, witness = self.proofs[k]
        kind = self.scene.lamps[k].kind
        error = 0.0 if clear else self.criteria.hidden(k, witness, self.tolerance)
        if clear:
            found = Decision("bounded", 0.0, 0.0, boxes)
            sentence = (
                f"shadows of light {k} ({kind}) off: nothing can stand between it and any surface, error 0"
            )
        elif error <= self.tolerance and len(witness):
            sentence = f"shadows of light {k} ({kind}) kept: what they change is not bounded"
            told = {**wording.kept(str(k), "shadows", ""), "found": error, "boxes": boxes}
            decisions.append({**told, "sentence": sentence})
            return True
        else:
            found = Decision("needed" if error > self.tolerance else "open", float("inf"), error, boxes)
            sentence = f"shadows of light {k} ({kind}) kept: {wording.reason(found)}"
        decisions.append(wording.decision("shadows", str(k), found, clear, sentence))
        return not clear

    def _bounces(self, decisions: list[dict[str, Any]]) -> int:
        """Reflections between shapes: none where no surface sees another."""
        wanted = self.scene.spec.bounces
        if wanted == 0:
            return 0
        alone = not any(one.transmits for one in self.scene.materials) and occlusion.nothing_faces(
            self.surfaces
        )
        sentence = (
            "reflections between shapes off: no surface faces another, error 0"
            if alone else "reflections between shapes kept: surfaces face each other"
        )  # fmt: skip
        if not alone:
            decisions.append({**wording.kept("all", "bounces", ""), "sentence": sentence})
            return wanted
        decisions.append(wording.decision("bounces", "all", Decision("bounded", 0.0, 0.0, 0), True, sentence))
        return 0
