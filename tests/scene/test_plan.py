"""Plans: enclosures hold what they say, bounds are kept, and what is off costs nothing."""

from __future__ import annotations

import dataclasses
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fitter.models import create
from fitter.models.pair import Pair
from fitter.scene import effects, operations, plan, render, scene
from fitter.scene.assembly import Scene
from fitter.scene.boxes import Boxes
from fitter.scene.integrate import Integrator
from fitter.scene.layers import layers
from fitter.scene.materials import ModelMaterial
from fitter.scene.picture import exr_bytes
from fitter.scene.settings import Settings
from fitter.scene.shading import value
from fitter.scene.surfaces import Surfaces
from fitter.spec import model_spec
from tests.scene.scenes import document

GGX = {
    "model": {"family": "torrance_sparrow", "ndf": "ggx", "masking": "smith"},
    "values": {"kd": 0.3, "ks": 1.0, "f0": 0.05, "alpha": 0.3},
}
MATERIALS: dict[str, dict[str, Any]] = {
    "ggx": GGX,
    "separable": {"model": {**GGX["model"], "masking": "smith_separable"}, "values": GGX["values"]},
    "beckmann": {"model": "torrance_sparrow", "values": GGX["values"]},
    "beckmann smith": {
        "model": {"family": "torrance_sparrow", "ndf": "beckmann", "masking": "smith"},
        "values": GGX["values"],
    },
    "metal": {
        "model": {**GGX["model"], "fresnel": "conductor"},
        "values": {"kd": 0.1, "ks": 1.0, "alpha": 0.2, "eta": 0.2, "kappa": 3.0},
    },
    "glazed": {
        "model": {**GGX["model"], "fresnel": "dielectric"},
        "values": {"kd": 0.4, "ks": 1.0, "alpha": 0.6, "eta": 1.5}
    },
    "brushed": {
        "model": {**GGX["model"], "anisotropic": True},
        "values": {"kd": 0.1, "ks": 1.0, "f0": 0.5, "alpha_x": 0.2, "alpha_y": 0.25, "psi": 0.3},
    },
    "ward": {
        "model": "ward:anisotropic",
        "values": {"kd": 0.2, "ks": 0.2, "alpha_x": 0.2, "alpha_y": 0.3, "psi": 1},
    },
    "bounded": {"model": "ward:bounded", "values": {"kd": 0.2, "ks": 0.2, "alpha": 0.3}},
    "rough": {"model": "oren_nayar", "values": {"rho": 0.6, "sigma": 0.3}},
    "fujii": {"model": "oren_nayar:fujii", "values": {"rho": 0.6, "sigma": 0.5}},
    "lafortune": {
        "model": "lafortune:2",
        "values": {
            "kd": 0.2, "ks_1": 0.3, "gamma_1": 0.9, "n_1": 15, "ks_2": 0.1, "gamma_2": -0.6, "n_2": 2.5,
        },
    },
    "streaked": {
        "model": "lafortune:anisotropic",
        "values": {"kd": 0.2, "ks": 0.3, "gamma": 0.9, "delta": 0.5, "n": 12, "psi": 0.4},
    },
    "grazing": {
        "model": "lafortune:3:no_diffuse",
        "values": {
            "ks_1": 0.3, "gamma_1": 2.0, "n_1": 0, "ks_2": 0.1, "gamma_2": 0.2, "n_2": 400, "ks_3": 0.3,
            "gamma_3": 0.7, "n_3": 1,
        },
    },
    "phong": {"model": "phong", "values": {"kd": 0.2, "ks": 0.4, "n": 30}},
    "blinn": {"model": "blinn_phong", "values": {"kd": 0.2, "ks": 0.4, "n": 30}},
    "coupled": {"model": {**GGX["model"], "diffuse": "coupled"}, "values": GGX["values"]},
    "engine": {
        "model": "metallic_roughness", "values": {"base_color": 0.6, "metallic": 0.3, "roughness": 0.5},
    },
    "again": {"model": "kulla_conty", "values": {"ks": 1.0, "f0": 0.7, "alpha": 0.4}},
    "again beckmann": {"model": "kulla_conty:beckmann:none", "values": {"ks": 0.9, "alpha": 0.3}},
    "varnished": {
        "model": "layered(lambert)", "values": {"base_kd": 0.6, "tau": 0.1, "eta": 1.5, "alpha": 0.15},
    },
    "lacquered": {
        "model": "layered:beckmann(torrance_sparrow:ggx:smith)",
        "values": {
            "base_kd": 0.2, "base_ks": 1.0, "base_f0": 0.6, "base_alpha": 0.3, "tau": 0.0, "eta": 1.4,
            "alpha": 0.1,
        },
    },
    "sum": {
        "model": "sum(oren_nayar, ward:no_diffuse, layered(lambert))",
        "values": {
            "a_rho": 0.3, "a_sigma": 0.2, "b_ks": 0.2, "b_alpha": 0.2, "c_base_kd": 0.2, "c_tau": 0.1,
            "c_eta": 1.5, "c_alpha": 0.1,
        },
    },
    "matte": {"model": "lambert", "values": {"kd": 0.5}},
}  # fmt: skip
#: Effects that are replaced by something else than nothing.
FACTORS = {"fresnel", "masking", "hammon", "anisotropy", "retro", "passage"}
SUN = {"kind": "directional", "direction": [1, -1, 2], "irradiance": 2.0}
BULB = {"kind": "point", "position": [1, 1, 3], "intensity": 9.0}
LAMP = {"kind": "area", "center": [-1, -1, 3], "normal": [0.3, 0.3, -1], "size": [1, 1], "radiance": 3}
SKY = {"kind": "environment", "radiance": 0.5}
PLANE = {"kind": "plane", "size": [3, 3], "material": "m"}
BALL = {"kind": "sphere", "radius": 0.8, "material": "m"}
ROOF = {
    "kind": "mesh", "material": "m", "vertices": [[-1, -1, 0], [1, -1, 0.2], [1, 1, 0.5], [-1, 1, 0.1]],
    "triangles": [[0, 1, 2], [0, 2, 3]],
}  # fmt: skip


def one(material: dict[str, Any], shape: dict[str, Any], lights: list[dict[str, Any]], **more: Any) -> Scene:
    return scene(document(shapes=[shape], lights=lights, materials={"m": material}, **more))


@pytest.mark.parametrize("name", MATERIALS)
def test_boxes_enclose_points(name: str) -> None:
    """Angles, terms and ratios of random points lie within those of random boxes that hold them."""
    rng = np.random.default_rng(5)
    given = MATERIALS[name]
    count = 300
    for shape in (PLANE, BALL, ROOF):
        found = one(given, shape, [SUN, BULB, LAMP, SKY])
        surfaces = Surfaces(found)
        material = found.materials[0]
        assert isinstance(material, ModelMaterial)
        start = surfaces.start(0, (0, 1, 2, 3))
        start = start.take(rng.integers(0, len(start), count))
        size = rng.random((count, 1)) ** 3
        ends = np.sort(rng.random((2, count, 4)), axis=0)
        low = start.low + (start.high - start.low) * ends[0]
        high = low + (start.high - start.low) * (ends[1] - ends[0]) * size
        boxes = Boxes(start.primitive, start.lamp, low, high)
        at = low + rng.random((count, 4)) * (high - low)
        at = np.minimum(np.maximum(at, low), high)
        l, v, l_world, v_world, normal = _directions(surfaces, Boxes(start.primitive, start.lamp, at, at))
        angles = surfaces.angles(boxes)
        use = (l[:, 2] > 1e-6) & (v[:, 2] > 1e-6) & angles.seen
        assert use.sum() > 20
        # Above its horizon and within the picture means seen.
        for interval, exact in (
            (angles.lz, np.sum(l_world * normal, axis=1)), (angles.vz, np.sum(v_world * normal, axis=1)),
            (angles.dot, np.sum(l_world * v_world, axis=1)),
        ):  # fmt: skip
            assert (interval.lo[use] <= exact[use] + 1e-12).all()
            assert (exact[use] <= interval.hi[use] + 1e-12).all()
        constants = {"fresnel": np.array([0.123]), "passage": np.array([0.8])}
        exact = np.asarray(material.model.value(Pair.split(l, v)))[:, 0]
        sets = [
            frozenset(s)
            for n in (0, 1, 2)
            for s in itertools.combinations(effects.effects(material.model), n)
        ]
        for off in filter(effects.compatible, sets):
            parts = effects.terms(material.model, off, constants, angles, 0)
            low_f, high_f = (sum(getattr(p.value, end) for p in parts) for end in ("lo", "hi"))
            less = np.asarray(value(material.model, off, constants, Pair.split(l, v)))[:, 0]
            e, absolute, _ = effects.relative(parts)
            wide = 1e-9 * (1 + exact)
            assert (low_f[use] <= exact[use] + wide[use]).all()
            assert (exact[use] <= high_f[use] + wide[use]).all(), off
            assert ((np.abs(less - exact) * l[:, 2])[use] <= absolute[use] + wide[use]).all(), off
            assert (np.abs(less - exact)[use] <= e[use] * exact[use] + wide[use]).all(), off
            # And of boxes of no size they are what there is, not more.
            points = surfaces.angles(Boxes(start.primitive, start.lamp, at, at))
            tight = effects.relative(effects.terms(material.model, off, constants, points, 0))[0]
            # Under a sky azimuths on spheres are any.
            turned = material.model.spec.anisotropic and shape is BALL
            some = use & (exact > 0) & ~(turned & (start.lamp == 3))
            true = np.abs(less - exact)[some] / exact[some]
            # Errors of several factors may cancel; what is absent only adds up.
            simple = off.isdisjoint(FACTORS) or len(parts) * len(off) == 1
            assert not simple or (tight[some] <= 2.1 * true + 1e-6).all(), off


def _directions(surfaces: Surfaces, boxes: Boxes) -> tuple[np.ndarray, ...]:
    """Light and viewer at boxes of no size, in the sample's frame, and in the world."""
    frame, origin = surfaces.frame[boxes.primitive], surfaces.origin[boxes.primitive]
    a, b, s, t = boxes.low.T
    ball = boxes.primitive < surfaces.spheres
    across = np.sqrt(np.maximum(1 - a * a, 0))
    n = np.where(
        ball[:, None], np.stack([across * np.cos(b), across * np.sin(b), a], axis=1), [0.0, 0.0, 1.0]
    )
    x = np.where(
        ball[:, None], surfaces.radius[boxes.primitive][:, None] * n, np.stack([a, b, 0 * a], axis=1)
    )
    point = origin + np.einsum("bji,bj->bi", frame, x)
    normal = np.einsum("bji,bj->bi", frame, n)
    towards = np.empty_like(point)
    away = surfaces.eye - point
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    # Directions of the sky are about the normal: from the x axis of flat shapes, the viewer on spheres.
    aside = np.where(ball[:, None], away - np.sum(away * normal, axis=1)[:, None] * normal, frame[:, 0])
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    sky = np.stack([np.cos(t), np.sin(t), s / np.sqrt(np.maximum(1 - s * s, 1e-300))], axis=1)
    sky = np.einsum("bi,bij->bj", sky, np.stack([aside, np.cross(normal, aside), normal], axis=1))
    for k, lamp in enumerate(surfaces.lamps):
        place = np.broadcast_to(lamp.place, point.shape)
        if lamp.kind == "area":
            place = (
                place
                + (s * lamp.half[0])[:, None] * lamp.frame[0]
                + (t * lamp.half[1])[:, None] * lamp.frame[1]
            )  # type: ignore[index]
        mine = boxes.lamp == k
        towards[mine] = {"directional": place, "environment": sky}.get(lamp.kind, place - point)[mine]
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    # On spheres along circles of latitude.
    tangent = np.where(ball[:, None], np.cross([0.0, 0.0, 1.0], normal), frame[:, 0])
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    own = np.stack([tangent, np.cross(normal, tangent), normal], axis=1)
    l, v = (np.einsum("bij,bj->bi", own, w) for w in (towards, away))
    return l, v, towards, away, normal


def true_error(found: Scene, settings: Settings, floor: float, passes: int = 4) -> float:
    """The largest pointwise error met with common random numbers, in float64."""
    all_, few = (Integrator(found, s, np.dtype(np.float64)) for s in (Settings.everything(found), settings))
    camera = found.spec.camera
    pixel = np.arange(camera.width * camera.height)
    worst = 0.0
    for k in range(passes):
        a, b = (np.asarray(integrator.batch(pixel, (k,))[0]) for integrator in (all_, few))
        worst = max(worst, float((np.abs(a - b) / np.maximum(a, 0.01 * floor)).max()))
    return worst


@pytest.mark.long
@pytest.mark.parametrize("name", ["ggx", "brushed"])
def test_bounds_are_kept(name: str) -> None:
    shape, light = (BALL, LAMP) if name == "ggx" else (PLANE, SUN)
    found = one(MATERIALS[name], shape, [light], bounces=1, light_samples=1)
    planned = plan(found, tolerance=0.2)
    bound = planned.document["bound"]
    assert bound <= 0.2
    worst = true_error(found, planned.settings, planned.document["reference"])
    assert worst <= bound + 1e-9, planned.document["decisions"]
    assert any(d["off"] for d in planned.document["decisions"] if d["subject"] == "m")


@pytest.mark.parametrize("name", ["lafortune", "ggx", "again"])
def test_parameters_per_channel(name: str) -> None:
    own = {"lafortune": "n_1", "ggx": "alpha", "again": "alpha"}[name]
    values = MATERIALS[name]["values"]
    spread = [values[own] * share for share in (0.5, 1.0, 1.5)]
    model = model_spec(MATERIALS[name]["model"]).model_copy(update={"per_channel": (own,)})
    material = {"model": model.model_dump(), "values": {**values, own: spread}}
    found = one(material, {**PLANE, "size": [0.5, 0.5]}, [BULB], channels=["R", "G", "B"])
    planned = plan(found, tolerance=0.5)
    assert any(d["off"] for d in planned.document["decisions"] if d["subject"] == "m")
    assert (
        true_error(found, planned.settings, planned.document["reference"], passes=1)
        <= planned.document["bound"] + 1e-9
    )


def test_a_dim_light_is_left_out_and_bounds_are_kept() -> None:
    dim = {"kind": "point", "position": [0, 0, 4], "intensity": 1e-3}
    found = one(GGX, BALL, [SUN, dim])
    planned = plan(found, tolerance=0.05)
    assert planned.settings.first == (True, False)
    assert (
        true_error(found, planned.settings, planned.document["reference"]) <= planned.document["bound"] + 1e-9
    )


def test_layers_are_what_a_picture_loses() -> None:
    lights = [{**SUN, "direction": [2, 0, 1]}]
    found = scene(document(lights=lights, bounces=0, materials={"floor": MATERIALS["matte"], "ball": GGX}))
    picture = render(found, samples=2)
    added = layers(found, picture)
    assert set(added) == {
        "light0",
        "shadows",
        *(f"ball.{e}" for e in effects.effects(found.materials[1].model)),
    }  # type: ignore[attr-defined]
    assert np.allclose(added["light0"], picture.radiance)
    # Shadows take light away, the diffuse base adds some.
    assert added["shadows"].min() < 0 < added["ball.diffuse"].max()
    assert added["shadows"].max() == 0 == added["ball.diffuse"].min()


def test_the_plan_is_a_document_with_reasons() -> None:
    planned = plan(
        one(GGX, {**PLANE, "size": [0.5, 0.5]}, [{**SUN, "direction": [0, -0.2, 2]}]), tolerance=0.1
    )
    told = json.loads(json.dumps(planned.document))
    assert told["kind"] == "brdf-fitter/plan"
    by = {(d["effect"], d["subject"]): d for d in told["decisions"]}
    assert by["shadows", "0"]["off"]
    assert by["bounces", "all"]["off"]
    assert by["specular", "m"]["off"]
    assert "degrees of the normal, error <=" in by["specular", "m"]["sentence"]
    assert not by["diffuse", "m"]["off"]
    assert by["diffuse", "m"]["state"] == "needed"
    assert all(d["sentence"] for d in told["decisions"])
    # Less is computed, in the whole program, too.
    assert told["operations"]["planned"] < 0.6 * told["operations"]["all"]


def test_what_is_off_is_not_compiled_and_zeroed_parameters_are_no_substitute() -> None:
    full = create("torrance_sparrow:ggx", kd=0.3, ks=1.0, f0=0.04, alpha=0.3)
    zeroed = create("torrance_sparrow:ggx", kd=0.3, ks=0.0, f0=0.0, alpha=0.3)
    of = operations.of_material
    everything = of(ModelMaterial(full))
    without = of(ModelMaterial(full, frozenset({"specular"})))
    assert without < 0.3 * everything
    assert of(ModelMaterial(zeroed)) == everything
    # The count is that of the program for these very parameters.
    w = np.ones((1024, 3), np.float32)
    kernel, given = ModelMaterial(zeroed).value_call(w, w)  # type: ignore[arg-type]
    assert operations.cost(kernel, *given) / 1024 == everything


def test_materials_without_light_or_beyond_a_substitute() -> None:
    black = one({**GGX, "values": {"kd": 0.0, "ks": 0.0, "f0": 0.1, "alpha": 0.3}}, PLANE, [SUN])
    planned = plan(black)
    assert planned.document["bound"] == 0
    rough = create(model_spec(GGX["model"]), kd=0.1, ks=1.0, f0=0.1, alpha=1.5)
    assert "hammon" not in effects.effects(rough)
    unknown = one({"model": "he_torrance"}, PLANE, [SUN])
    kept = [d for d in plan(unknown).document["decisions"] if d["subject"] == "m"]
    assert [d["state"] for d in kept] == ["not-bounded"]


def test_what_stands_far_away_casts_shadows() -> None:
    """A long board whose middle is near, and that passes far above the floor."""
    board = {
        "kind": "plane", "size": [2000, 1], "center": [-10, 0, 0], "normal": [-10, 0, 1],
        "tangent": [1, 0, 10], "material": "m",
    }  # fmt: skip
    found = scene(
        document(
            shapes=[PLANE, board], materials={"m": MATERIALS["matte"]}, bounces=0,
            lights=[{**SUN, "direction": [0, 0, 1]}],
        )
    )  # fmt: skip
    planned = plan(found, tolerance=0.01)
    assert planned.settings.shadows == (True,)


def test_a_sky_that_is_dark_somewhere_is_sure_of_nothing(tmp_path: Path) -> None:
    pixels = np.zeros((8, 16), np.float32)
    pixels[2, 3] = 50.0
    (tmp_path / "sky.exr").write_bytes(exr_bytes({"Y": pixels}, {}))
    sky = [{"kind": "environment", "file": "sky.exr"}]
    shown = document(shapes=[PLANE], materials={"m": GGX}, lights=sky)
    surfaces = Surfaces(scene(shown, folder=tmp_path))
    angles = surfaces.angles(surfaces.start(0, (0,)))
    assert (angles.arriving.lo <= 0).all()
    assert (angles.arriving.hi >= 50.0).all()


def test_many_faint_lamps_are_judged_at_once() -> None:
    """Which of them are left out is no matter of trying all sets."""
    lamps = [{**BULB, "position": [0.1 * k, 1, 3], "intensity": 1e-3} for k in range(40)]
    planned = plan(one(MATERIALS["matte"], PLANE, [SUN, *lamps], bounces=0), tolerance=0.5)
    assert sum(planned.settings.first) < 41
    assert planned.settings.first[0]


def test_what_is_bounded_when_the_boxes_run_out_is_bounded() -> None:
    """Under a sky there are few boxes, too few to come near what points show."""
    faint = {**GGX, "values": {**GGX["values"], "ks": 0.002}}
    planned = plan(one(faint, {**PLANE, "size": [0.5, 0.5]}, [SKY]), tolerance=0.2)
    told = {d["effect"]: d["state"] for d in planned.document["decisions"] if d["subject"] == "m"}
    assert told["specular"] == "bounded"


def test_without_light_nothing_is_judged() -> None:
    planned = plan(one(GGX, PLANE, [{**SUN, "irradiance": 0.0}]))
    assert [d["subject"] for d in planned.document["decisions"]] == ["all"]
    assert planned.document["operations"]["saved"] == 1


def test_a_scene_that_needs_everything_costs_everything() -> None:
    shapes = document()["shapes"]
    glossy = {**GGX, "values": {**GGX["values"], "f0": 0.02}}
    found = scene(document(materials={"floor": glossy, "ball": glossy}, lights=[SUN, LAMP], shapes=shapes))
    planned = plan(found, tolerance=0.001)
    assert planned.document["operations"]["planned"] == planned.document["operations"]["all"]
    assert planned.settings == dataclasses.replace(planned.settings, direct=found.materials)
    shadows = [d for d in planned.document["decisions"] if d["effect"] == "shadows"]
    assert [(d["off"], d["state"]) for d in shadows] == [(False, "needed"), (False, "needed")]
    assert planned.settings.bounces == 1
