"""Plan: which effects of a scene can be left out, proved or measured, and what that saves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from fitter.errors import SpecError
from fitter.fitting.clock import running
from fitter.progress import Progress, ignore
from fitter.scene import estimates, tiling
from fitter.scene.assembly import Scene
from fitter.scene.integrate import Integrator
from fitter.scene.programs import Planner, Program, Task
from fitter.scene.regions import Region, Tiles
from fitter.scene.rendering import BATCH, Precision, padded, reference
from fitter.scene.settings import Settings

KIND = "brdf-fitter/plan"
#: Share of F below which radiance counts as that much.
FLOOR = 0.01


@dataclass(frozen=True)
class Plan:
    """The programs that a picture is rendered with, one for each of its regions, and the document that
    explains them. whole : that which holds for all of it."""

    whole: Program
    programs: tuple[Program, ...]
    document: Mapping[str, Any]

    @property
    def settings(self) -> Settings:
        """Those that hold for the whole picture."""
        return self.whole.settings


def plan(
    scene: Scene,
    *,
    tolerance: float | None = None,
    seed: int = 0,
    precision: Precision | Literal["auto"] = "float32",
    tiles: tuple[int, int] = (1, 1),
    progress: Progress = ignore,
) -> Plan:
    """Which effects of the scene stay below ``tolerance`` (default: the scene's) together, everywhere.

    The error of a point of the picture is |L - L'| / max(L, 0.01 F), the largest of its channels. precision :
    "auto" tries whether float32 differs from float64 by more than what the effects leave of the tolerance,
    which takes the compilation of the scene's kernels in float64. tiles : columns and rows of tiles; those
    that need less may share up to two programs of their own, which are proved for themselves.
    """
    tolerance = scene.spec.tolerance if tolerance is None else tolerance
    _check(tolerance, tiles)
    with running() as clock:
        progress(0.0, "pre-pass")
        camera = scene.spec.camera
        rows = min(BATCH, padded(camera.width * camera.height))
        floor = prepass(scene, seed, rows)
        clock.lap("prepass")
        spent, decisions = 0.0, list[dict[str, Any]]()
        if precision == "auto":
            tried = estimates.precision(scene, floor * FLOOR, seed, rows)
            single = tried.found <= estimates.SHARE * tolerance
            decisions.append(estimates.of_precision(tried, single))
            precision, spent = ("float32", tried.found) if single else ("float64", 0.0)
            clock.lap("precision")
        task = Task.of(scene, tolerance, floor * FLOOR, seed, rows, spent)
        planner = Planner(task, Region.whole(Tiles.of(camera, *tiles)))
        whole = planner.run(lambda done, what: progress(0.1 + 0.5 * done, what))
        decisions += whole.decisions
        progress(0.7, "tiles")
        programs = tiling.programs(planner, whole)
        rest = whole.region.rest([one.region for one in programs])
        programs = [replace(whole, region=rest, decisions=decisions), *programs]
        programs = tuple(one for one in programs if one.region.chosen)
        clock.lap("planning")
        progress(0.9, "counting operations")
        counted = [one.operations(scene) for one in programs]
        clock.lap("counting")
    pixels = [len(one.region.pixels) for one in programs]
    means = {
        name: float(np.average([each[name] for each in counted], weights=pixels))
        for name in ("all", "planned")
    }
    worst = max(programs, key=lambda one: (1.0 + one.bound) * (1.0 + one.estimated))
    document = {
        "kind": KIND, "tolerance": tolerance, "bound": worst.bound, "estimated": worst.estimated,
        "reference": floor, "floor": FLOOR, "seed": seed, "precision": precision, "decisions": decisions,
        "operations": {**means, "saved": means["all"] / max(means["planned"], 1.0)},
        "programs": [
            {
                **one.region.to_dict(), "bound": one.bound, "estimated": one.estimated, "operations": each,
                "decisions": one.decisions,
            }
            for one, each in zip(programs, counted, strict=True)
        ] if len(programs) > 1 else [],
        "seconds": {**clock.phases, "compile": sum(clock.compiled.values())},
    }  # fmt: skip
    return Plan(whole, programs, document)


def _check(tolerance: float, tiles: tuple[int, int]) -> None:
    if not 0 < tolerance < 1:
        raise SpecError(
            f"the tolerance is {tolerance:g}", code="bad-limit", parameter="tolerance",
            remedy="give a share between 0 and 1, as 0.01 or 1%",
        )  # fmt: skip
    if min(tiles) < 1:
        raise SpecError(
            f"there are {tiles[0]} x {tiles[1]} tiles", code="bad-limit", parameter="tiles",
            remedy="give at least one column and one row",
        )  # fmt: skip


def prepass(scene: Scene, seed: int, rows: int) -> float:
    """F: the mean over pixels that show a shape of the radiance, of one sample each, clipped at its 99th
    percentile."""
    total = scene.spec.camera.width * scene.spec.camera.height
    pixel = np.linspace(0, total - 1, rows).astype(np.intp)
    found, met = Integrator(scene, Settings.everything(scene), np.dtype(np.float32)).batch(
        pixel, (seed, 2**31)
    )
    return reference(found[None].astype(np.float64), met[None].astype(np.float64))
