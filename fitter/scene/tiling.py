"""Tiles that need less than the whole picture does: which of them to give programs of their own.

What each tile may leave out is guessed from errors at the probe's points; of the sets that come up, the two
that save most are planned for the tiles that may use them, and what comes out of that is proved there.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fitter.scene import effects, estimates, operations, wording
from fitter.scene.constants import constants_of
from fitter.scene.estimates import Probe
from fitter.scene.materials import ModelMaterial
from fitter.scene.programs import Planner, Program
from fitter.scene.regions import Region
from fitter.scene.search import Decision
from fitter.scene.settings import Settings

FloatArray = NDArray[np.float64]

#: Programs beside the one of the whole picture, guesses that pairs of are tried, and of the operations what
#: they must save.
_PROGRAMS, _GUESSES, _WORTH = 2, 8, 0.05
#: Errors up to this share of the tolerance are guessed to be provable.
_SHARE = 0.5


@dataclass(frozen=True)
class Guess:
    """What may be left out: of lamps those that add nothing, and the points each way that do for them (0:
    none), of materials effects. blank : that no shape is seen, which is proved."""

    dark: frozenset[int]
    points: tuple[int, ...]
    off: tuple[frozenset[str], ...]
    blank: bool = False

    def covers(self, other: Guess) -> bool:
        """Whether all that ``other`` leaves out may be left out here."""
        if self.blank or other.blank:
            return self.blank
        points = all(b == 0 or 0 < a <= b for a, b in zip(self.points, other.points, strict=True))
        off = all(b <= a for a, b in zip(self.off, other.off, strict=True))
        return points and off and other.dark <= self.dark


def programs(planner: Planner, whole: Program) -> list[Program]:
    """Those of regions that need less than the whole picture, proved; none where that saves little."""
    probe, tiles = planner.probe, whole.region.tiles
    if probe is None or probe.at is None or len(tiles) == 1:
        return []
    guesses = _guesses(planner, probe, whole)
    found: list[Program] = []
    for region, blank in _regions(planner, whole, guesses):
        one = _blank(whole, region) if blank else Planner(planner.task, region).run()
        cost = [operations.of_picture(planner.task.scene, p.settings, region) for p in (one, whole)]
        if cost[0] < cost[1]:
            found.append(one)
    return found


def _guesses(planner: Planner, probe: Probe, whole: Program) -> dict[int, Guess]:
    """By tile, of those that show something."""
    scene, tolerance = planner.task.scene, _SHARE * planner.task.tolerance
    tile = whole.region.tiles.of_pixel(probe.pixel)
    lamps = range(len(scene.lamps))
    materials = [
        (m, one) for m, one in enumerate(planner.materials)
        if isinstance(one, ModelMaterial) and effects.unbounded(one.model) is None
    ]  # fmt: skip
    errors = {m: _of_effects(planner, probe, m, one) for m, one in materials}
    blank = Guess(frozenset(), (0,) * len(lamps), (), blank=True)
    reached = planner.criteria.surfaces.reached(whole.region.tiles).reshape(-1)
    found: dict[int, Guess] = dict.fromkeys(np.flatnonzero(~reached).tolist(), blank)
    for t in np.unique(tile).tolist():
        here = tile == t

        def small(error: FloatArray, here: NDArray[np.bool_] = here) -> bool:
            return float(error[..., here].max(initial=0.0)) <= tolerance

        dark = frozenset(k for k in lamps if k in probe.alone and small(probe.alone[k]))
        points = tuple(
            next((n for n in estimates.LADDER if (k, n) in probe.tried and small(probe.tried[k, n])), 0)
            for k in lamps
        )
        off = [frozenset[str]()] * len(scene.materials)
        for m, names in errors.items():
            off[m] = frozenset(name for name, error in names.items() if small(error))
        found[t] = Guess(dark if len(dark) < len(lamps) else frozenset(), points, tuple(off))
    return found


def _of_effects(planner: Planner, probe: Probe, m: int, one: ModelMaterial) -> dict[str, FloatArray]:
    """(P,) the error of leaving out each effect of a material, 0 at points of others."""
    names = effects.effects(one.model)
    constants = constants_of(planner.task.scene, m, one, planner.criteria.surfaces)
    primitive, point = probe.places
    at = planner.criteria.surfaces.coordinates(primitive, point)
    mine = np.flatnonzero(planner.criteria.surfaces.material[primitive] == m)
    errors = planner.criteria.sampled(
        primitive[mine], at[mine], one.model, [frozenset({name}) for name in names], constants,
        planner.criteria.channels(one.model),
    )  # fmt: skip
    found = np.zeros((len(names), len(primitive)))
    found[:, mine] = errors
    return dict(zip(names, found, strict=True))


def _blank(whole: Program, region: Region) -> Program:
    """The program of a region that shows no shape."""
    sentence = f"no shape is seen in {len(region.chosen)} of {len(region.tiles)} tiles: nothing to compute"
    decisions = [wording.decision("shapes", "all", Decision("bounded", 0.0, 0.0, 0), True, sentence)]
    return Program(region, replace(whole.apart, blank=True), whole.merged, decisions, 0.0, 0.0)


def _regions(
    planner: Planner, whole: Program, guesses: dict[int, Guess]
) -> list[tuple[Region, bool]]:  # fmt: skip
    """At most two, of the tiles that may use one guess each, and save most by it, and whether that is that
    nothing is seen."""
    scene, region = planner.task.scene, whole.region
    kinds = [guess for guess, _ in Counter(guesses.values()).most_common(_GUESSES)]
    cost = {guess: operations.of_picture(scene, _settings(whole.settings, guess), region) for guess in kinds}
    usual = operations.of_picture(scene, whole.settings, region)

    def used(some: Sequence[Guess]) -> tuple[float, dict[int, Guess]]:
        """What all tiles cost, and which of some guesses each uses."""
        total, uses = 0.0, dict[int, Guess]()
        for t, guess in guesses.items():
            able = [one for one in some if guess.covers(one) and cost[one] < usual]
            best = min(able, key=lambda one: cost[one], default=None)
            total += usual if best is None else cost[best]
            if best is not None:
                uses[t] = best
        return total, uses

    tried = [used(some) for n in range(1, _PROGRAMS + 1) for some in itertools.combinations(kinds, n)]
    least, uses = min(tried, key=lambda one: one[0], default=(np.inf, dict[int, Guess]()))
    if least > (1.0 - _WORTH) * usual * len(guesses):
        return []
    return [
        (Region(region.tiles, frozenset(t for t, one in uses.items() if one == guess)), guess.blank)
        for guess in kinds if guess in uses.values()
    ]  # fmt: skip


def _settings(whole: Settings, guess: Guess) -> Settings:
    """Roughly those that planning by a guess will come to."""
    if guess.blank:
        return replace(whole, blank=True)
    direct = list(whole.direct)
    for m, off in enumerate(guess.off):
        one = direct[m]
        if not isinstance(one, ModelMaterial) or not off:
            continue
        sets = [
            frozenset(some) for n in range(len(off) + 1) for some in itertools.combinations(sorted(off), n)
        ]
        constants = {name: np.zeros(len(one.model.channels)) for name in ("fresnel", "passage")}
        able = [replace(one, off=some, constants=constants) for some in sets if effects.compatible(some)]
        direct[m] = min(able, key=operations.of_material)
    first = tuple(on and k not in guess.dark for k, on in enumerate(whole.first))
    points = tuple(b or a for a, b in zip(whole.points, guess.points, strict=True))
    return replace(whole, first=first, points=points, direct=tuple(direct))
