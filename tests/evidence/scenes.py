"""Scenes: plans' bounds against true errors, by common random numbers, on a suite and on random scenes.

A true error is the largest |L - L'| / max(L, 0.01 F) met in float64: at random points of every pixel, direct
light and reflections included, in pictures that differ by the plan alone, and zoomed into
(tests/evidence/zoom.py), for the plan and for each effect and light that it leaves out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fitter.scene import plan, scene
from fitter.scene.assembly import Scene
from fitter.scene.integrate import Integrator, Settings
from fitter.scene.materials import ModelMaterial
from fitter.scene.planning import Plan
from tests.evidence.study import Outcome, Study
from tests.evidence.zoom import Zoom

TOLERANCES = (0.001, 0.01, 0.1)
#: Random scenes of a full run, and in each of the subjects they are shared out to.
RANDOM, PARTS = 1_000, 10

SUN: dict[str, Any] = {"kind": "directional", "direction": [1, -1, 2], "irradiance": 2.0}
LOW: dict[str, Any] = {**SUN, "direction": [1, 2, 0.15]}
BULB: dict[str, Any] = {"kind": "point", "position": [1, -1, 3], "intensity": 9.0}
LAMP: dict[str, Any] = {
    "kind": "area", "center": [-1, -1, 3], "normal": [0.3, 0.3, -1], "size": [1, 1], "radiance": 3.0
}  # fmt: skip
SKY: dict[str, Any] = {"kind": "environment", "radiance": 0.5}
DIM: dict[str, Any] = {"kind": "point", "position": [0, 0, 4], "intensity": 1e-4}

_GGX = {"family": "torrance_sparrow", "ndf": "ggx", "masking": "smith"}
MATTE = {"model": "lambert", "values": {"kd": 0.5}}
ROUGH = {"model": "oren_nayar", "values": {"rho": 0.5, "sigma": 0.4}}
GLOSSY = {"model": _GGX, "values": {"kd": 0.3, "ks": 1.0, "f0": 0.04, "alpha": 0.3}}
SHINY = {"model": _GGX, "values": {"kd": 0.1, "ks": 1.0, "f0": 0.2, "alpha": 0.05}}
METAL = {
    "model": {**_GGX, "fresnel": "conductor", "diffuse": "none"},
    "values": {"ks": 1.0, "alpha": 0.25, "eta": 0.2, "kappa": 3.0},
}
BRUSHED = {
    "model": {**_GGX, "anisotropic": True},
    "values": {"kd": 0.05, "ks": 1.0, "f0": 0.6, "alpha_x": 0.2, "alpha_y": 0.24},
}
MIRROR = {"model": "specular", "values": {"ks": 0.9}}
WARD = {"model": "ward:bounded", "values": {"kd": 0.3, "ks": 0.1, "alpha": 0.2}}
CLASSIC = {"model": "torrance_sparrow", "values": {"kd": 0.3, "ks": 0.5, "f0": 0.05, "alpha": 0.3}}

PLANE = {"kind": "plane", "size": [3, 3]}
SMALL = {"kind": "plane", "size": [0.5, 0.5]}
BALL = {"kind": "sphere", "radius": 0.7}
NEAR = {"kind": "sphere", "radius": 0.5, "center": [0, 0, 0.55]}


def document(
    shapes: Sequence[tuple[dict[str, Any], dict[str, Any]]], lights: list[dict[str, Any]], **more: Any
) -> dict[str, Any]:
    """A scene of (shape, material) pairs."""
    return {
        "camera": {
            "position": [0, -4, 2.5], "look_at": [0, 0, 0.2], "width": 32, "height": 24, "fov_deg": 32,
        },
        "channels": ["value"], "bounces": 1, "light_samples": 4, "lights": lights,
        "shapes": [{**shape, "material": f"m{k}"} for k, (shape, _) in enumerate(shapes)],
        "materials": {f"m{k}": material for k, (_, material) in enumerate(shapes)}, **more,
    }  # fmt: skip


SUITE: dict[str, dict[str, Any]] = {
    "matte plate, sun": document([(PLANE, MATTE)], [SUN]),
    "matte ball, lamp": document([(BALL, MATTE)], [LAMP]),
    "rough plate, sun": document([(PLANE, ROUGH)], [SUN]),
    "rough ball, bulb": document([(BALL, ROUGH)], [BULB]),
    "rough ball, low sun (retro)": document([(BALL, ROUGH)], [{**SUN, "direction": [0, -4, 2.6]}]),
    "glossy plate, sun": document([(PLANE, GLOSSY)], [SUN]),
    "glossy tile, sun": document([(SMALL, GLOSSY)], [{**SUN, "direction": [0, -0.2, 2]}]),
    "glossy ball, sun": document([(BALL, GLOSSY)], [SUN]),
    "glossy ball, bulb": document([(BALL, GLOSSY)], [BULB]),
    "glossy ball, lamp": document([(BALL, GLOSSY)], [LAMP]),
    "glossy ball, two lights, one dim": document([(BALL, GLOSSY)], [SUN, DIM]),
    "shiny plate, bulb": document([(PLANE, SHINY)], [BULB]),
    "shiny ball, lamp": document([(BALL, SHINY)], [LAMP]),
    "metal ball, sun": document([(BALL, METAL)], [SUN]),
    "metal plate, low sun (grazing)": document([(PLANE, METAL)], [LOW]),
    "glossy ball, low sun (rim)": document([(BALL, GLOSSY)], [LOW]),
    "brushed plate, sun": document([(PLANE, BRUSHED)], [SUN]),
    "brushed tile, lamp": document([(SMALL, BRUSHED)], [LAMP]),
    "mirror ball, sky": document([(BALL, MIRROR)], [SKY]),
    "ward plate, bulb": document([(PLANE, WARD)], [BULB]),
    "classic ball, sun": document([(BALL, CLASSIC)], [SUN]),
    "glossy ball, sky": document([(BALL, GLOSSY)], [SKY]),
    "ball on plate, sun and lamp (needs everything)": document(
        [(PLANE, GLOSSY), (NEAR, GLOSSY)], [SUN, LAMP]
    ),
    "far plates, sun": document([(SMALL, GLOSSY), ({**SMALL, "center": [1, 1, 0]}, MATTE)], [SUN]),
}


def random_scene(rng: np.random.Generator) -> dict[str, Any]:
    """One or two shapes, one or two lights, parameters over their range."""

    def material() -> dict[str, Any]:
        kd, ks, f0 = rng.uniform(0, 0.8), rng.uniform(0.05, 1), rng.uniform(0, 1) ** 2
        alpha = float(np.exp(rng.uniform(np.log(0.03), np.log(0.9))))
        kinds: list[dict[str, Any]] = [
            {"model": _GGX, "values": {"kd": kd, "ks": ks, "f0": f0, "alpha": alpha}},
            {"model": "torrance_sparrow", "values": {"kd": kd, "ks": ks, "f0": f0, "alpha": alpha}},
            {"model": "oren_nayar", "values": {"rho": kd + 0.05, "sigma": rng.uniform(0, 0.8)}},
            {"model": "ward:bounded", "values": {"kd": kd, "ks": ks, "alpha": alpha}},
            {**METAL, "values": {**METAL["values"], "alpha": alpha}},
            {**BRUSHED, "values": {**BRUSHED["values"], "kd": kd, "alpha_x": alpha, "alpha_y": alpha * 1.1}},
            MATTE,
        ]
        return kinds[rng.integers(len(kinds))]

    def direction() -> list[float]:
        theta, phi = np.arccos(rng.uniform(0.05, 1)), rng.uniform(0, 2 * np.pi)
        return [float(np.sin(theta) * np.cos(phi)), float(np.sin(theta) * np.sin(phi)), float(np.cos(theta))]

    def light() -> dict[str, Any]:
        away = 3.0 * np.array(direction())
        kinds: list[dict[str, Any]] = [
            {**SUN, "direction": away.tolist(), "irradiance": float(np.exp(rng.uniform(-3, 1)))},
            {"kind": "point", "position": away.tolist(), "intensity": float(np.exp(rng.uniform(-5, 2)))},
            {
                "kind": "area", "center": away.tolist(), "normal": (-away).tolist(), "size": [0.5, 0.5],
                "radiance": float(np.exp(rng.uniform(-2, 2))),
            },
        ]  # fmt: skip
        return kinds[rng.integers(3)]

    shapes = [({**(PLANE, SMALL, BALL)[rng.integers(3)]}, material())]
    if rng.random() < 0.3:
        shapes.append(({**BALL, "radius": 0.3, "center": [1.2, 0.3, 0.5]}, material()))
    eye = 4.0 * np.array(direction())
    camera = {"position": eye.tolist(), "look_at": [0, 0, 0], "up": [0.3, 1, 0.1]}
    lights = [light() for _ in range(1 + int(rng.random() < 0.3))]
    found = document(shapes, lights)
    return {**found, "camera": {**found["camera"], **camera, "width": 24, "height": 18}}


def true_error(found: Scene, settings: Settings, floor: float, passes: int) -> float:
    """The largest error met."""
    full, less = (Integrator(found, s, np.dtype(np.float64)) for s in (Settings.everything(found), settings))
    pixel = np.arange(found.spec.camera.width * found.spec.camera.height)
    worst = 0.0
    for k in range(passes):
        a, b = (np.asarray(one.batch(pixel, (91, k))[0]) for one in (full, less))
        if not (np.isfinite(a).all() and np.isfinite(b).all() and (a >= 0).all() and (b >= 0).all()):
            return float("inf")
        worst = max(worst, float((np.abs(a - b) / np.maximum(a, 0.01 * floor)).max()))
    return worst


def left_out(found: Scene, planned: Plan) -> list[tuple[float, Settings]]:
    """What a plan leaves out, one effect or light at a time: its bound, and the settings without it alone."""
    everything = Settings.everything(found)
    one: list[tuple[float, Settings]] = []
    for told in planned.document["decisions"]:
        if not told["off"]:
            continue
        if told["effect"] == "light":
            first = tuple(k != int(told["subject"]) for k in range(len(found.lamps)))
            one.append((told["bound"], replace(everything, first=first)))
        elif told["subject"] in found.names:
            m = found.names.index(told["subject"])
            direct, chosen = list(everything.direct), planned.settings.direct[m]
            assert isinstance(chosen, ModelMaterial)
            direct[m] = replace(chosen, off=frozenset({told["effect"]}))
            one.append((told["bound"], replace(everything, direct=tuple(direct))))
    return one


def judge(name: str, share: float, seed: int) -> Outcome:
    """One scene of the suite, or a part of the random ones, at all tolerances."""
    if name in SUITE:
        documents = [SUITE[name]]
    else:
        rng = np.random.default_rng([seed, int(name.split()[-1])])
        documents = [random_scene(rng) for _ in range(max(1, round(share * RANDOM / PARTS)))]
    violations: list[dict[str, Any]] = []
    ratios: list[float] = []
    seconds: list[float] = []
    saved: list[float] = []
    bound = worst = 0.0
    decisions = open_ = off = 0
    for k, one in enumerate(documents):
        found = scene(one)
        plans = [plan(found, tolerance=tolerance) for tolerance in TOLERANCES]
        at: int | None = None
        whole: list[tuple[float, Settings]] = []
        alone: list[tuple[float, Settings]] = []
        for tolerance, planned in zip(TOLERANCES, plans, strict=True):
            told = planned.document
            seconds.append(told["seconds"]["planning"])
            decisions += len(told["decisions"])
            open_ += sum(d["state"] == "open" for d in told["decisions"])
            off += sum(d["off"] for d in told["decisions"])
            if tolerance == 0.01:
                saved.append(told["operations"]["saved"])
            true = true_error(found, planned.settings, told["reference"], passes=4)
            whole.append((told["bound"], planned.settings))
            alone += left_out(found, planned)
            if told["bound"] > tolerance:
                violations.append({"what": "a bound above its tolerance", "scene": k, "bound": told["bound"]})
            if true > told["bound"] * (1 + 1e-9) + 1e-9:
                violations.append(
                    {
                        "what": "an error above its bound", "scene": k, "tolerance": tolerance, "true": true,
                        "bound": told["bound"],
                    }
                )  # fmt: skip
            if told["bound"] >= bound:
                bound, at = told["bound"], len(whole) - 1
        if any(lamp.kind == "environment" for lamp in found.lamps):
            continue
        zoom = Zoom(found, 0.01 * plans[0].document["reference"])
        met = zoom.largest([settings for _, settings in (*whole, *alone)], seed).tolist()
        for (least, _), true in zip((*whole, *alone), met, strict=True):
            if true > least * (1 + 1e-9) + 1e-9:
                violations.append(
                    {"what": "an error zoomed into above its bound", "scene": k, "true": true, "bound": least}
                )
        worst = met[at] if at is not None else worst
        ratios += [
            least / true for (least, _), true in zip(alone, met[len(whole) :], strict=True) if true > 1e-5
        ]
    figures = {
        "scenes": len(documents), "decisions": decisions, "off": off, "open": open_, "largest bound": bound,
        "its true error": worst, "bound / true, median": float(np.median(ratios)) if ratios else None,
        "bound / true, 90 %": float(np.quantile(ratios, 0.9)) if ratios else None,
        "operations saved at 1 %": float(np.median(saved)), "planning s, median": float(np.median(seconds)),
        "planning s, largest": max(seconds),
    }  # fmt: skip
    return Outcome(figures, violations)


STUDY = Study(
    name="scenes",
    title="Scenes: effects left out, and what that changes",
    claim="Of effects that a plan leaves out of a scene, the error at every point stays below the plan's "
    "bound, and the bound below the tolerance, at 0.1 %, 1 % and 10 %",
    columns=(
        "scenes", "decisions", "off", "open", "largest bound", "its true error", "bound / true, median",
        "bound / true, 90 %", "operations saved at 1 %", "planning s, median", "planning s, largest",
    ),
    models=lambda: [*SUITE, *(f"random scenes {k}" for k in range(PARTS))],
    judge=judge,
    subject="scene",
)  # fmt: skip
