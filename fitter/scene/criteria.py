"""Criteria: bounds of the error over cells, and the error at points, for :mod:`fitter.scene.search`.

At a point of a surface light adds up from pieces of lamps, each in full, in part or not at all: things stand
between. Leaving effects out changes what piece k sends back, l_k (over 0.01 F), by at most d_k and by at most
e_k l_k. The error, sum x d / max(sum x l, 1) with 0 <= x <= 1, is a knapsack's that takes fractions. Its
dual, m + max(0, sum max(0, d (1 - m/e))), is a bound for any m >= 0. Where nothing stands between, l_k >= s_k
is sure, and pieces with e < m take (m - e) s off that sum. With one lamp without extent it is min(e, d).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.scene import cells as cells_of
from fitter.scene import effects, occlusion, search
from fitter.scene.assembly import Scene
from fitter.scene.boxes import Angles, Boxes, taken
from fitter.scene.cells import Cells, Pieces
from fitter.scene.effects import Off
from fitter.scene.intervals import Interval
from fitter.scene.materials import ModelMaterial
from fitter.scene.search import Decision
from fitter.scene.surfaces import Surfaces

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
Groups = Sequence[tuple[int, list[int]]]

#: n.v at the rims of spheres, which stands for the limit there.
_RIM = 1e-290
#: Boxes of no size that points are tried with at once.
_TRIED, _POINTS, _FEW = 16_000, 256, 64
#: Primitives whose shadows on single cells are asked for, at most.
_SHADES = 8
#: Halvings of the interval that m is sought in, and where it ends.
_HALVINGS, _LARGEST = 10, 1e3


class Criteria:
    """Of one scene; ``floor`` is the radiance that errors are relative to at least, 0.01 F, and ``clear``
    says of each lamp whether nothing can stand before it."""

    def __init__(self, scene: Scene, surfaces: Surfaces, floor: float, clear: Sequence[bool]) -> None:
        self.scene, self.surfaces, self.floor = scene, surfaces, floor
        self.lamps = tuple(range(len(scene.lamps)))
        self.clear = np.array(clear)
        skies = [one for one in scene.lamps if one.kind == "environment"]
        self.budget = 2_000 if skies else search.BUDGET
        #: Whether errors at points are not known: under a sky of many colours, or one that things hide.
        self.blind = any(one.picture is not None and one.picture.size > one.picture.shape[2] for one in skies)
        self.blind |= bool(skies) and len(surfaces.radius) > 1
        #: Points of lamps and the share of the light that each stands for.
        self.points = [(k, *one) for k in self.lamps for one in occlusion.spread(scene.lamps[k])]

    def decide(
        self, m: int, one: ModelMaterial, sets: Sequence[Off], constants: Mapping[str, Any], tolerance: float
    ) -> list[Decision]:  # fmt: skip
        """The joint errors of sets of effects of material m."""
        start, found = self._probed(m, one, sets, constants, tolerance, _POINTS)
        return self._decide(start, one, sets, constants, tolerance, found)

    def first(
        self, m: int, one: ModelMaterial, sets: Sequence[Off], constants: Mapping[str, Any], tolerance: float,
        known: Mapping[Off, Decision],
    ) -> Iterator[Decision]:  # fmt: skip
        """The same one by one, up to the first that is bounded; some are ``known``."""
        failed: list[Off] = []
        met: dict[Off, float] = {}
        start = cells_of.start(self.surfaces, m)
        for off in sets:
            decision = known.get(off)
            if decision is None and any(bad <= off for bad in failed):
                decision = Decision("open", np.inf, 0.0, 0)
            if decision is None:
                if not met:
                    rest = [other for other in sets if other not in known]
                    start, found = self._probed(m, one, rest, constants, tolerance, _FEW)
                    met = dict(zip(rest, found.tolist(), strict=True))
                (decision,) = self._decide(start, one, [off], constants, tolerance, np.array([met[off]]))
            yield decision
            if decision.state == "bounded":
                return
            failed.append(off)

    def _probed(
        self, m: int, one: ModelMaterial, sets: Sequence[Off], constants: Mapping[str, Any], tolerance: float,
        most: int,
    ) -> tuple[Cells, FloatArray]:  # fmt: skip
        start = cells_of.start(self.surfaces, m)
        groups = self.channels(one.model)
        most = max(16, min(_TRIED // len(self.points), most))
        found = search.probe(
            self.surfaces, start, lambda p, x: self.sampled(p, x, one.model, sets, constants, groups),
            tolerance, most,
        )  # fmt: skip
        return start, found

    def _decide(
        self, start: Cells, one: ModelMaterial, sets: Sequence[Off], constants: Mapping[str, Any],
        tolerance: float, found: FloatArray,
    ) -> list[Decision]:  # fmt: skip
        groups = self.channels(one.model)
        return search.decide(
            self.surfaces, start,
            lambda cells, which: self.bounds(cells, one.model, [sets[i] for i in which], constants, groups),
            lambda p, x: self.sampled(p, x, one.model, sets, constants, groups),
            tolerance, found, self.budget,
        )  # fmt: skip

    def hidden(self, k: int, witness: Boxes, tolerance: float) -> float:
        """The largest error met of leaving out what hides lamp k: at points where something does, and
        elsewhere."""
        found = 0.0
        for m, one in enumerate(self.scene.materials):
            if not isinstance(one, ModelMaterial) or effects.unbounded(one.model) is not None:
                continue
            groups = self.channels(one.model)

            def errors(
                primitive: IntArray, at: FloatArray, model: Any = one.model, groups: Groups = groups
            ) -> FloatArray:
                return self.sampled(primitive, at, model, [frozenset()], {}, groups, unshaded=k)

            mine = witness.take(self.surfaces.material[witness.primitive] == m)
            found = max(found, float(errors(mine.primitive, mine.low[:, :2]).max(initial=0.0)))
            if found <= tolerance:
                start = cells_of.start(self.surfaces, m)
                found = max(found, float(search.probe(self.surfaces, start, errors, tolerance, 200)[0]))
        return found

    def bounds(
        self, cells: Cells, model: Any, sets: Sequence[Off], constants: Mapping[str, Any], groups: Groups
    ) -> tuple[FloatArray, int]:
        """(N, B) of the joint errors of sets of effects over cells; boxes it took."""
        found, angles, taken = self._seen(cells, self.lamps)
        shape = len(cells), int(found.piece.max(initial=0)) + 1
        worst = np.zeros((len(sets), len(cells)))
        open_ = self._open(found, angles)
        for channel, members in groups:
            sure = np.zeros(len(open_))
            if shape[1] > 1:
                parts = effects.terms(model, frozenset(), constants, angles, channel)
                sure = np.where(open_, self.certain(parts, angles, found.boxes, members), 0.0) * found.share
            for k, off in enumerate(sets):
                e, absolute, _ = effects.relative(effects.terms(model, off, constants, angles, channel))
                d = self.over_floor(absolute, found.boxes, angles, members) * found.share
                worst[k] = np.maximum(worst[k], joint(e, d, sure, found, shape))
        return worst, taken

    def _seen(self, cells: Cells, lamps: tuple[int, ...]) -> tuple[Pieces, Angles, int]:
        """The pieces of lamps that may light what the picture may show of cells."""
        every = cells_of.pieces(self.surfaces, cells, lamps)
        angles = self.surfaces.angles(every.boxes, (every.cells, every.cell))
        use = angles.seen
        found = replace(
            every, boxes=every.boxes.take(use), cell=every.cell[use], piece=every.piece[use],
            share=every.share[use],
        )  # fmt: skip
        return found, angles.take(use), len(every.boxes)

    def _open(self, found: Pieces, angles: Angles) -> NDArray[np.bool_]:
        """Of each piece whether nothing stands before it, proved."""
        clear = self.clear[found.boxes.lamp]
        for k in self.lamps if len(self.lamps) > 1 and len(self.surfaces.radius) <= _SHADES else ():
            if self.scene.lamps[k].is_delta and not self.clear[k]:
                mine = np.flatnonzero(found.boxes.lamp == k)
                boxes, point = found.boxes.take(mine), taken(angles.point, mine)
                clear[mine] = ~occlusion.doubtful(self.surfaces, boxes, point, k)
        return clear

    def dark(
        self, k: int, others: tuple[int, ...], m: int, one: ModelMaterial, tolerance: float
    ) -> Decision:
        """How much lamp k adds to material m, beside that of ``others``, lamps without extent that nothing
        shades, and over 0.01 F at least."""
        groups = self.channels(one.model)

        def bounds(cells: Cells, which: Sequence[int]) -> tuple[FloatArray, int]:
            worst = np.zeros((len(which), len(cells)))
            found, angles, taken = self._seen(cells, (k,))
            for channel, members in groups:
                parts = effects.terms(one.model, frozenset(), {}, angles, channel)
                total = self.over_floor(effects.relative(parts)[2], found.boxes, angles, members)
                mine = np.bincount(found.cell, total * found.share, len(cells)) * (1 + 1e-12)
                rest = np.zeros(len(cells))
                if others:
                    beside = cells_of.pieces(self.surfaces, cells, others)
                    there = self.surfaces.angles(beside.boxes)
                    parts = effects.terms(one.model, frozenset(), {}, there, channel)
                    sure = self.certain(parts, there, beside.boxes, members) * beside.share
                    rest = np.bincount(beside.cell, sure, len(cells)) * (1 - 1e-12)
                with np.errstate(invalid="ignore", divide="ignore"):
                    most = np.where(mine > 0, 1.0 / (1.0 + rest / mine), 0.0)
                worst = np.maximum(worst, np.fmin(mine, most * (1 + 1e-14)))
            return worst, taken

        def errors(primitive: IntArray, at: FloatArray) -> FloatArray:
            return self.sampled(primitive, at, one.model, [frozenset()], {}, groups, dark=k)

        start = cells_of.start(self.surfaces, m)
        found = search.probe(self.surfaces, start, errors, tolerance, 100)
        return search.decide(self.surfaces, start, bounds, errors, tolerance, found, 2_000)[0]

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
        self, primitive: IntArray, at: FloatArray, model: Any, sets: Sequence[Off],
        constants: Mapping[str, Any], groups: Groups, dark: int | None = None, unshaded: int | None = None,
    ) -> FloatArray:  # fmt: skip
        """The errors (N, P) under all lamps, direct light only, at points of the picture; 0 elsewhere: of
        leaving out sets of effects, the lamp ``dark``, or what hides the lamp ``unshaded``."""
        count, channels = len(at), len(self.scene.spec.channels)
        if self.blind:
            return np.zeros((len(sets), count))
        many = len(self.points)
        where = np.repeat(np.concatenate([at, np.zeros((count, 2))], axis=1), many, axis=0)
        where[:, 2:] = np.tile([[s, t] for _, s, t, _ in self.points], (count, 1))
        lamp = np.tile([k for k, *_ in self.points], count)
        boxes = Boxes(np.repeat(primitive, many), lamp, where, where)
        once = boxes.take(np.arange(0, len(lamp), many))
        angles = self.surfaces.angles(boxes, (once, np.repeat(np.arange(count), many)))
        ball = boxes.primitive < self.surfaces.spheres
        rim = ball & (where[:, 0] <= self.surfaces.low[boxes.primitive, 0])
        angles = replace(angles, vz=Interval.of(np.where(rim, _RIM, angles.vz.mid)))
        hidden = occlusion.shaded(self.surfaces, boxes, angles) & angles.seen
        share = np.tile([share for *_, share in self.points], count)
        bright = np.where(angles.seen, angles.lz.mid * angles.arriving.mid * share, 0.0)
        arriving = np.where(hidden, 0.0, bright)
        change, whole = np.zeros((len(sets), count, channels)), np.zeros((count, channels))
        for channel, members in groups:
            level = np.stack([one.level[members] for one in self.scene.lamps])[lamp]

            def summed(x: FloatArray, level: FloatArray = level) -> FloatArray:
                x = np.nan_to_num(x, nan=0.0, posinf=1e300, neginf=-1e300)
                return (x[:, None] * level).reshape(count, many, level.shape[1]).sum(axis=1)

            for k, off in enumerate(sets):
                parts = effects.terms(model, off, constants, angles, channel)
                with np.errstate(invalid="ignore", over="ignore"):
                    total = sum((p.value.mid for p in parts), np.zeros(len(lamp)))
                    wrong = sum(((p.ratio.mid - 1) * p.value.mid for p in parts), np.zeros(len(lamp)))
                    if dark is not None:
                        wrong = np.where(lamp == dark, total, 0.0)
                    light = arriving
                    if unshaded is not None:
                        wrong, light = total, np.where(hidden & (lamp == unshaded), bright, 0.0)
                    whole[:, members] = summed(np.where(arriving > 0, total * arriving, 0.0))
                    change[k][:, members] = summed(np.where(light > 0, wrong * light, 0.0))
        against = np.maximum(whole, self.floor)
        # Where there is no light at all there is no error.
        error = np.where(against > 0, np.abs(change) / np.where(against > 0, against, 1.0), 0.0)
        shown = occlusion.shown(self.surfaces, once, angles.take(np.arange(0, len(lamp), many)))
        shown &= self.surfaces.inside(once)
        return np.where(shown, error.max(axis=2), 0.0)

    def certain(
        self, parts: Sequence[effects.Term], angles: Angles, boxes: Boxes, members: Sequence[int]
    ) -> FloatArray:
        """A lower bound of the radiance over 0.01 F that lamps send back which nothing hides."""
        low = sum((part.value.lo for part in parts), np.zeros(len(boxes)))
        level = np.array([one.level[list(members)].min() for one in self.scene.lamps])[boxes.lamp]
        with np.errstate(invalid="ignore", divide="ignore"):
            radiance = low * angles.lz.lo * angles.arriving.lo * level * (1 - 1e-12) / self.floor
        return np.nan_to_num(radiance, nan=0.0, posinf=0.0)


def joint(
    e: FloatArray, d: FloatArray, sure: FloatArray, found: Pieces, shape: tuple[int, int]
) -> FloatArray:
    """The bound (B,) of pieces' e, d and s (see the module)."""
    if shape[1] == 1:
        bound = np.zeros(shape[0])
        bound[found.cell] = np.fmin(e, d)
        return bound
    each, change, least = np.zeros((3, *shape))
    for whole, part in ((each, e), (change, d), (least, sure)):
        whole[found.cell, found.piece] = part
    largest = each.max(axis=1)
    low, high = np.zeros(shape[0]), np.minimum(largest, _LARGEST)
    bound = np.minimum(largest, change.sum(axis=1))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        size = np.where(change > 0, change / each, 0.0)
        for _ in range(_HALVINGS):
            m = 0.5 * (low + high)
            over = each > m[:, None]
            more = np.where(over, change - m[:, None] * size, 0.0)
            less = np.where(over, 0.0, m[:, None] - each) * least
            surplus = more.sum(axis=1) - less.sum(axis=1)
            # What the roundings of all terms come to at most.
            slack = 1e-12 * (np.where(over, change, 0.0).sum(axis=1) + m * least.sum(axis=1))
            bound = np.fmin(bound, m + np.maximum(surplus + slack, 0.0))
            # Convex in m: its slope says where the least is.
            steep = np.where(over, size, least).sum(axis=1) > 1.0
            up = steep & ~(surplus <= 0)
            low, high = np.where(up, m, low), np.where(up, high, m)
    return bound * (1 + 1e-12)
