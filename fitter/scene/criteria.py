"""Criteria: bounds of the error over boxes, and the error at points, for :mod:`fitter.scene.search`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.scene import effects, occlusion
from fitter.scene.assembly import Scene
from fitter.scene.effects import Off
from fitter.scene.materials import ModelMaterial
from fitter.scene.search import Decision
from fitter.scene.search import decide as branch_and_bound
from fitter.scene.surfaces import Angles, Boxes, Surfaces

FloatArray = NDArray[np.float64]


class Criteria:
    """Of one scene; ``floor`` is the radiance that errors are relative to at least, 0.01 F."""

    def __init__(self, scene: Scene, surfaces: Surfaces, floor: float) -> None:
        self.scene, self.surfaces, self.floor = scene, surfaces, floor
        self.lamps = tuple(range(len(scene.lamps)))
        several = len(self.lamps) > 1 or not scene.lamps[0].is_delta
        #: w of :mod:`fitter.scene.search`, and what it costs.
        self.weight = 16.0 * len(self.lamps) if several else 1.0
        self.stretch = 1.0 + len(self.lamps) / self.weight if several else 1.0
        self.skies = any(one.kind == "environment" for one in scene.lamps)

    def decide(
        self, one: ModelMaterial, off: Off, constants: Mapping[str, Any], start: Boxes, tolerance: float,
        *, tighten: bool = False,
    ) -> Decision:  # fmt: skip
        """The joint error of a set of effects of one material."""
        model = one.model
        groups = self.channels(model)

        def criterion(boxes: Boxes, angles: Angles) -> FloatArray:
            worst = np.zeros(len(boxes))
            for channel, members in groups:
                e, absolute, _ = effects.relative(effects.terms(model, off, constants, angles, channel))
                g = self.over_floor(absolute, boxes, angles, members)
                worst = np.maximum(worst, np.fmin(e, self.weight * g))
            return worst * self.stretch

        def sampler(boxes: Boxes) -> FloatArray:
            return self.sampled(boxes, model, off, constants, groups)

        budget = {"budget": 2_000} if self.skies else {}
        return branch_and_bound(
            self.surfaces, start, criterion, sampler, tolerance, tighten=tighten, **budget
        )

    def channels(self, model: Any) -> list[tuple[int, list[int]]]:
        """Channels of the scene that share a material's values: the model's channel, and which they are."""
        groups: dict[tuple[float, ...], tuple[int, list[int]]] = {}
        for c in range(len(self.scene.spec.channels)):
            own = c if len(model.channels) > 1 else 0
            key = tuple(
                float(np.asarray(v).reshape(-1)[own if np.size(v) > 1 else 0]) for v in model.values.values()
            )
            groups.setdefault(key, (own, []))[1].append(c)
        return list(groups.values())

    def over_floor(
        self, value: FloatArray, boxes: Boxes, angles: Angles, members: Sequence[int]
    ) -> FloatArray:
        """An upper bound of radiance over 0.01 F, of values f n.l."""
        level = np.array([one.level[list(members)].max() for one in self.scene.lamps])[boxes.lamp]
        with np.errstate(invalid="ignore", over="ignore"):
            found = value * angles.arriving.hi * level
        # 0 times infinity: no light arrives there.
        return (
            np.nan_to_num(found, nan=0.0, posinf=np.inf) * (1 + 1e-14) / self.floor
            if self.floor > 0
            else np.full(len(boxes), np.inf)
        )

    def sampled(
        self, boxes: Boxes, model: Any, off: Off, constants: Mapping[str, Any],
        groups: Sequence[tuple[int, list[int]]], dark: int | None = None, unshaded: int | None = None,
    ) -> FloatArray:  # fmt: skip
        """The error under all lamps, direct light only, at points of the picture; 0 elsewhere: of leaving out
        effects, the lamp ``dark``, or what hides the lamp ``unshaded``."""
        if self.skies:
            return np.zeros(len(boxes))
        count, channels = len(boxes), len(self.scene.spec.channels)
        points = [(k, *one) for k in self.lamps for one in occlusion.spread(self.scene.lamps[k])]
        many = len(points)
        at = np.repeat(boxes.low, many, axis=0)
        at[:, 2:] = np.tile([[s, t] for _, s, t, _ in points], (count, 1))
        lamp = np.tile([k for k, *_ in points], count)
        one = Boxes(np.repeat(boxes.primitive, many), lamp, at, at)
        angles = self.surfaces.angles(one)
        hidden = occlusion.shaded(self.surfaces, one, angles)
        lit = angles.seen & ~hidden
        share = np.tile([share for *_, share in points], count)
        arriving = np.where(lit, angles.lz.mid * angles.arriving.mid * share, 0.0)
        change, whole = np.zeros((count, channels)), np.zeros((count, channels))
        for channel, members in groups:
            parts = effects.terms(model, off, constants, angles, channel)
            with np.errstate(invalid="ignore"):
                total = sum((p.value.mid for p in parts), np.zeros(len(lamp)))
                wrong = sum(((p.ratio.mid - 1) * p.value.mid for p in parts), np.zeros(len(lamp)))
                radiance = np.where(arriving > 0, np.stack([total, wrong]) * arriving, 0.0)
            radiance = np.nan_to_num(radiance, nan=0.0, posinf=0.0, neginf=0.0)
            if dark is not None:
                radiance[1] = np.where(lamp == dark, radiance[0], 0.0)
            if unshaded is not None:
                bright = np.where(angles.seen, angles.lz.mid * angles.arriving.mid * share, 0.0)
                added = (lamp == unshaded) & hidden
                radiance[1] = np.where(added, np.nan_to_num(total * bright, nan=0.0, posinf=0.0), 0.0)
            for c in members:
                level = np.array([one.level[c] for one in self.scene.lamps])[lamp]
                sums = (radiance * level).reshape(2, count, many).sum(axis=2)
                whole[:, c], change[:, c] = sums
        against = np.maximum(whole, self.floor)
        # Where there is no light at all there is no error.
        error = np.where(against > 0, np.abs(change) / np.where(against > 0, against, 1.0), 0.0)
        first = angles.take(np.arange(0, len(lamp), many))
        shown = self.surfaces.inside(boxes) & occlusion.shown(self.surfaces, boxes, first)
        return np.where(shown, error.max(axis=1), 0.0)

    def certain(
        self, model: Any, channel: int, boxes: Boxes, others: Sequence[int], members: Sequence[int]
    ) -> FloatArray:
        """A lower bound of the radiance over 0.01 F that lamps without extent, never shaded, give everywhere
        in boxes."""
        found = np.zeros(len(boxes))
        for j in others:
            beside = replace(boxes, lamp=np.full(len(boxes), j))
            angles = self.surfaces.angles(beside)
            parts = effects.terms(model, frozenset(), {}, angles, channel)
            low = sum((part.value.lo for part in parts), np.zeros(len(boxes)))
            level = self.scene.lamps[j].level[list(members)].min()
            with np.errstate(invalid="ignore"):
                radiance = low * angles.lz.lo * angles.arriving.lo * level
            found += np.nan_to_num(radiance, nan=0.0, posinf=0.0)
        return found * (1 - 1e-14) / self.floor
