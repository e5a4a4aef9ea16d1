"""Scenes: plans' bounds against true errors, by common random numbers, on a suite and on random scenes.

A true error is the largest |L - L'| / max(L, 0.01 F) met in float64: at random points of every pixel, direct
light and reflections included, in pictures that differ by the plan's bounded decisions alone, and zoomed into
(tests/evidence/zoom.py), for the plan and for each effect and light that it leaves out. Plans are by tile,
and each program is compared in its own tiles. Estimates (points for lamps) are tried again elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fitter.scene import estimates, plan, scene
from fitter.scene.assembly import Scene
from fitter.scene.estimates import Probe
from fitter.scene.integrate import Integrator
from fitter.scene.materials import ModelMaterial
from fitter.scene.planning import Plan
from fitter.scene.programs import Program
from fitter.scene.rendering import padded
from fitter.scene.settings import Settings
from tests.evidence.study import Outcome, Study
from tests.evidence.zoom import Zoom

TOLERANCES = (0.001, 0.01, 0.1)
#: Random scenes of a full run, and in each of the subjects they are shared out to.
RANDOM, PARTS = 1_000, 10
#: Columns and rows of tiles.
TILES = (6, 4)

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
COUPLED = {"model": {**_GGX, "diffuse": "coupled"}, "values": GLOSSY["values"]}
LAFORTUNE = {
    "model": "lafortune:2",
    "values": {
        "kd": 0.2, "ks_1": 0.3, "gamma_1": 0.85, "n_1": 40, "ks_2": 0.01, "gamma_2": -0.6, "n_2": 2.5,
    },
}  # fmt: skip
STREAKED: dict[str, Any] = {
    "model": "lafortune:anisotropic",
    "values": {"kd": 0.2, "ks": 0.2, "gamma": 0.9, "delta": 0.6, "n": 12, "psi": 0.4},
}
PHONG = {"model": "phong", "values": {"kd": 0.3, "ks": 0.1, "n": 60}}
BLINN = {"model": "blinn_phong", "values": {"kd": 0.3, "ks": 0.1, "n": 60}}
VARNISHED = {
    "model": "layered(lambert)", "values": {"base_kd": 0.5, "tau": 0.1, "eta": 1.5, "alpha": 0.15},
}  # fmt: skip
ENGINE = {
    "model": "metallic_roughness", "values": {"base_color": 0.6, "metallic": 0.2, "roughness": 0.5},
}  # fmt: skip
AGAIN = {"model": "kulla_conty", "values": {"ks": 1.0, "f0": 0.6, "alpha": 0.25}}
SUM = {"model": "sum(lambert, ward:no_diffuse)", "values": {"a_kd": 0.4, "b_ks": 0.05, "b_alpha": 0.15}}

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
        "channels": ["R", "G", "B"], "bounces": 1, "light_samples": 4, "lights": lights,
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
    "lafortune ball, sun": document([(BALL, LAFORTUNE)], [SUN]),
    "lafortune plate, lamp": document([(PLANE, LAFORTUNE)], [LAMP]),
    "streaked tile, bulb": document([(SMALL, STREAKED)], [BULB]),
    "phong plate, bulb": document([(PLANE, PHONG)], [BULB]),
    "coupled ball, lamp": document([(BALL, COUPLED)], [LAMP]),
    "varnished plate, sun": document([(PLANE, VARNISHED)], [SUN]),
    "engine's material on a ball, bulb": document([(BALL, ENGINE)], [BULB]),
    "kulla-conty tile, lamp": document([(SMALL, AGAIN)], [LAMP]),
    "sum on a tile, lamp": document([(SMALL, SUM)], [LAMP]),
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
        n, n2 = 2 / alpha**2, rng.uniform(0, 5)
        gamma = rng.uniform(-np.pi, np.pi)
        kinds: list[dict[str, Any]] = [
            {"model": _GGX, "values": {"kd": kd, "ks": ks, "f0": f0, "alpha": alpha}},
            {"model": "torrance_sparrow", "values": {"kd": kd, "ks": ks, "f0": f0, "alpha": alpha}},
            {"model": "oren_nayar", "values": {"rho": kd + 0.05, "sigma": rng.uniform(0, 0.8)}},
            {"model": "ward:bounded", "values": {"kd": kd, "ks": ks, "alpha": alpha}},
            {**METAL, "values": {**METAL["values"], "alpha": alpha}},
            {**BRUSHED, "values": {**BRUSHED["values"], "kd": kd, "alpha_x": alpha, "alpha_y": alpha * 1.1}},
            MATTE,
            {
                "model": "lafortune:2",
                "values": {
                    "kd": kd, "ks_1": ks, "gamma_1": 0.8, "n_1": n, "ks_2": f0, "gamma_2": gamma, "n_2": n2,
                },
            },
            {**STREAKED, "values": {**STREAKED["values"], "kd": kd, "ks": ks, "gamma": gamma, "n": n}},
            {"model": "phong", "values": {"kd": kd, "ks": ks, "n": n}},
            {"model": "blinn_phong", "values": {"kd": kd, "ks": ks, "n": n}},
            {**COUPLED, "values": {"kd": kd, "ks": ks, "f0": f0, "alpha": alpha}},
            {**VARNISHED, "values": {"base_kd": kd, "tau": ks, "eta": 1 + f0, "alpha": alpha}},
            {**ENGINE, "values": {"base_color": kd, "metallic": f0, "roughness": alpha**0.5}},
            {**AGAIN, "values": {"ks": ks, "f0": f0, "alpha": alpha}},
            {**SUM, "values": {"a_kd": kd, "b_ks": ks, "b_alpha": alpha}},
        ]  # fmt: skip
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


def true_error(found: Scene, program: Program, floor: float, passes: int) -> float:
    """The largest error met in a program's tiles; lamps that it has points for are sampled."""
    sampled = replace(program.apart, points=(0,) * len(found.lamps))
    full, less = (Integrator(found, s, np.dtype(np.float64)) for s in (Settings.everything(found), sampled))
    camera = found.spec.camera
    # Of as many rays whatever the tiles, so that programs are compiled once.
    pixel = np.resize(program.region.pixels, camera.width * camera.height)
    worst, merged = 0.0, program.merged
    for k in range(passes):
        a, b = (np.asarray(one.batch(pixel, (91, k))[0]) for one in (full, less))
        b = b if merged is None else merged.apart(b[:, list(merged.columns)])
        if not (np.isfinite(a).all() and np.isfinite(b).all() and (a >= 0).all() and (b >= 0).all()):
            return float("inf")
        worst = max(worst, float((np.abs(a - b) / np.maximum(a, floor)).max()))
    return worst


def beyond(found: Scene, program: Program, floor: float, seed: int) -> tuple[int, int]:
    """Other random points of a program's tiles, and at how many of them direct light is further off than is
    estimated and proved together."""
    rows = padded(found.spec.camera.width * found.spec.camera.height)
    exact = replace(program.apart, points=(0,) * len(found.lamps), direct=found.materials)
    probe = Probe(found, exact, floor, seed, rows, program.region)
    errors = estimates.together(probe, program.apart.direct, program.apart.points)
    claim = (1.0 + program.bound) * (1.0 + program.estimated) - 1.0
    return len(errors), int((errors > claim * (1 + 1e-6)).sum())


def left_out(found: Scene, planned: Plan) -> list[tuple[float, Settings]]:
    """What a plan leaves out, one effect or light at a time: its bound, and the settings without it alone."""
    everything = Settings.everything(found)
    one: list[tuple[float, Settings]] = []
    for told in planned.whole.decisions:
        if not told["off"]:
            continue
        if told["effect"] == "light":
            first = tuple(k != int(told["subject"]) for k in range(len(found.lamps)))
            one.append((told["bound"], replace(everything, first=first)))
        elif told["subject"] in found.names:
            m = found.names.index(told["subject"])
            direct, chosen = list(everything.direct), planned.whole.apart.direct[m]
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
    decisions = open_ = off = tried = further = 0
    for k, one in enumerate(documents):
        found = scene(one)
        plans = [plan(found, tolerance=tolerance, tiles=TILES) for tolerance in TOLERANCES]
        at: int | None = None
        whole: list[tuple[float, Settings]] = []
        alone: list[tuple[float, Settings]] = []
        for tolerance, planned in zip(TOLERANCES, plans, strict=True):
            told = planned.document
            seconds.append(told["seconds"]["planning"])
            for program in planned.programs:
                decisions += len(program.decisions)
                open_ += sum(d["state"] == "open" for d in program.decisions)
                off += sum(d["off"] for d in program.decisions)
            if tolerance == 0.01:
                saved.append(told["operations"]["saved"])
            floor = 0.01 * told["reference"]
            whole.append((planned.whole.bound, planned.whole.apart))
            alone += left_out(found, planned)
            if (1 + told["bound"]) * (1 + told["estimated"]) > (1 + tolerance) * (1 + 1e-12):
                violations.append({"what": "a bound above its tolerance", "scene": k, "bound": told["bound"]})
            for program in planned.programs:
                true = true_error(found, program, floor, passes=4)
                if true > program.bound * (1 + 1e-9) + 1e-9:
                    violations.append(
                        {
                            "what": "an error above its bound", "scene": k, "tolerance": tolerance,
                            "true": true, "bound": program.bound,
                        }
                    )  # fmt: skip
                if any(program.apart.points):
                    points, more = beyond(found, program, floor, seed + 1)
                    tried, further = tried + points, further + more
            if planned.whole.bound >= bound:
                bound, at = planned.whole.bound, len(whole) - 1
        if any(lamp.kind == "environment" for lamp in found.lamps):
            continue
        whole = [(least, replace(one, points=(0,) * len(found.lamps))) for least, one in whole]
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
    # Of all points at most 0.45 % are further off, with 99 % confidence for each estimate: in the mean less.
    if further > 0.0045 * tried + 4 * np.sqrt(0.0045 * tried):
        violations.append({"what": "more points beyond their estimates", "points": tried, "beyond": further})
    figures = {
        "scenes": len(documents), "decisions": decisions, "off": off, "open": open_, "largest bound": bound,
        "its true error": worst, "bound / true, median": float(np.median(ratios)) if ratios else None,
        "bound / true, 90 %": float(np.quantile(ratios, 0.9)) if ratios else None,
        "operations saved at 1 %": float(np.median(saved)), "planning s, median": float(np.median(seconds)),
        "planning s, largest": max(seconds),
        "points tried": tried, "beyond their estimate": further,
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
        "points tried", "beyond their estimate",
    ),
    models=lambda: [*SUITE, *(f"random scenes {k}" for k in range(PARTS))],
    judge=judge,
    subject="scene",
    least=8,
)  # fmt: skip
