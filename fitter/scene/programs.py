"""Programs: what a plan makes of a region of the picture, step by step within one tolerance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from fitter.progress import Progress, ignore
from fitter.scene import channels, estimates, lighting, occlusion, operations, wording
from fitter.scene.assembly import Scene
from fitter.scene.channels import Merged
from fitter.scene.criteria import Criteria
from fitter.scene.lighting import Proof
from fitter.scene.materials import Material
from fitter.scene.regions import Region
from fitter.scene.selection import select
from fitter.scene.settings import Settings
from fitter.scene.surfaces import Surfaces


@dataclass(frozen=True)
class Program:
    """What a region is rendered with, what decided that, and the error: what is bounded of it, and what is
    estimated. apart : the settings with all channels, of which ``merged`` are computed."""

    region: Region
    apart: Settings
    merged: Merged | None
    decisions: Sequence[dict[str, Any]]
    bound: float
    estimated: float

    @property
    def settings(self) -> Settings:
        """Those that it is rendered with."""
        return self.apart if self.merged is None else self.apart.merge(self.merged)

    def operations(self, scene: Scene) -> dict[str, float]:
        """Operations a sample of a pixel of the region, with everything on and by the program."""
        everything = Settings.everything(scene)
        counted = {
            name: operations.of_picture(scene, settings, self.region)
            for name, settings in (("all", everything), ("planned", self.settings))
        }
        return {**counted, "saved": counted["all"] / max(counted["planned"], 1.0)}


@dataclass(frozen=True)
class Task:
    """What programs of one plan have in common. floor : 0.01 F. rows : rays of a batch. estimated : what of
    the tolerance is spent already."""

    scene: Scene
    tolerance: float
    floor: float
    seed: int
    rows: int
    estimated: float
    proofs: tuple[Proof, ...]

    @staticmethod
    def of(
        scene: Scene, tolerance: float, floor: float, seed: int, rows: int, estimated: float = 0.0
    ) -> Task:  # fmt: skip
        surfaces = Surfaces(scene)
        proofs = tuple(occlusion.clear(surfaces, k) for k in range(len(scene.lamps)))
        return Task(scene, tolerance, floor, seed, rows, estimated, proofs)


class Planner:
    """Makes the program of one region."""

    def __init__(self, task: Task, region: Region) -> None:
        self.task, self.region = task, region
        #: Errors so far, together: those that are bounded, and those that are estimated.
        self.bounded, self.estimated = 0.0, task.estimated
        surfaces = Surfaces(task.scene, region)
        self.criteria = Criteria(task.scene, surfaces, task.floor, [clear for clear, *_ in task.proofs])
        #: Of the last run.
        self.probe: estimates.Probe | None = None
        self.materials: tuple[Material, ...] = task.scene.materials

    def run(self, progress: Progress = ignore) -> Program:
        """Lamps, shadows, reflections, channels, points of lamps, stand-ins for tables, materials."""
        task, scene, criteria = self.task, self.task.scene, self.criteria
        if task.floor == 0:
            # Nothing to be relative to: no proof could end.
            dark = wording.kept("all", "all", "all: the pre-pass met no light, nothing is judged")
            return Program(self.region, Settings.everything(scene), None, [dark], 0.0, self.estimated)
        # Lamps first: each costs a whole evaluation of every material.
        dark, error, decisions = lighting.dark(criteria, task.tolerance)
        self._spend(error)
        shadows: list[bool] = []
        for k, proof in enumerate(task.proofs):
            needed, decision = lighting.shadow(criteria, k, proof, task.tolerance)
            shadows.append(needed)
            decisions.append(decision)
        bounces, found = lighting.bounces(criteria)
        decisions += found
        merged: Merged | None = None
        if len(scene.spec.channels) > 1:
            # What few channels save is little beside what else the tolerance buys.
            merged, error = channels.merged(scene, bounces, 0.25 * self.left)
            decisions.append(channels.decision(scene, merged, error))
            self._spend(error)
        first = tuple(k not in dark for k in criteria.lamps)
        settings = replace(
            Settings.everything(scene), first=first, shadows=tuple(shadows), bounces=bounces
        )  # fmt: skip
        progress(0.3, "points of lamps")
        self.probe = self._probe(settings, task.seed)
        spent = self.bounded, self.estimated
        points, found, error = estimates.lamps(self.probe, self.left)
        self._spend(error, estimated=True)
        self.materials, more, error = estimates.stand_ins(self.probe, self.left)
        self._spend(error, estimated=True)
        progress(0.5, "materials")
        direct, bound, kept = self._direct()
        if any(points) or self.materials != scene.materials:
            # What was judged one after the other is judged once more as it will be, at other points.
            errors = estimates.together(self._probe(settings, task.seed + 1), direct, points)
            check = estimates.Estimate(float(errors.max(initial=0.0)), len(errors))
            more += [check.decision("together", "all", False, "all that is left out of direct light")]
            if check.found > task.tolerance:
                for one in (*found, *more):
                    one.update(off=False, state="needed")
                points, self.materials = (0,) * len(points), scene.materials
                self.bounded, self.estimated = spent
                direct, bound, kept = self._direct()
        self._spend(bound)
        settings = replace(settings, points=points, direct=direct)
        decisions += [*found, *more, *kept]
        return Program(self.region, settings, merged, decisions, self.bounded, self.estimated)

    def _probe(self, settings: Settings, seed: int) -> estimates.Probe:
        task = self.task
        return estimates.Probe(task.scene, settings, task.floor, seed, task.rows, self.region)

    def _direct(self) -> tuple[tuple[Material, ...], float, list[dict[str, Any]]]:
        """The materials without what what is left of the tolerance allows, the bound, decisions."""
        chosen, worst, decisions = list[Material](), 0.0, list[dict[str, Any]]()
        for m, one in enumerate(self.materials):
            less, bound, found = select(self.criteria, m, one, self.left)
            decisions += found
            chosen.append(less)
            worst = max(worst, bound)
        return tuple(chosen), worst, decisions

    @property
    def left(self) -> float:
        """What of the tolerance is not spent: errors of steps that follow one another, each relative to what
        the steps before it left, multiply up."""
        return (1.0 + self.task.tolerance) / ((1.0 + self.bounded) * (1.0 + self.estimated)) - 1.0

    def _spend(self, error: float, *, estimated: bool = False) -> None:
        if estimated:
            self.estimated += error * (1.0 + self.estimated)
        else:
            self.bounded += error * (1.0 + self.bounded)
