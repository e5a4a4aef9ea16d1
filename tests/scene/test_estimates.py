"""What is judged at random points of the picture: points for lamps, fits for tables, float32 for float64."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fitter.errors import SpecError
from fitter.fitting import fit
from fitter.models import ReflectanceModel, create
from fitter.scene import estimates, plan, render, scene
from fitter.scene.assembly import Scene
from fitter.scene.lights import points
from fitter.scene.materials import ModelMaterial
from fitter.scene.settings import Settings
from fitter.scene.spec import Material
from fitter.table import Table
from tests.scene.scenes import assert_standard_normal, document, z_scores

LAMP = {"kind": "area", "center": [-1, -1, 3], "normal": [0.3, 0.3, -1], "size": [1, 1], "radiance": 3}
SUN = {"kind": "directional", "direction": [1, -1, 2], "irradiance": 2.0}
PLANE = {"kind": "plane", "size": [3, 3], "material": "m"}
GLOSSY = {"model": "torrance_sparrow:ggx", "values": {"kd": 0.3, "ks": 1.0, "f0": 0.04, "alpha": 0.4}}


def one(material: dict[str, Any], lights: list[dict[str, Any]], shape: dict[str, Any] = PLANE) -> Scene:
    return scene(document(shapes=[shape], lights=lights, materials={"m": material}, bounces=0))


def of(document: Any, effect: str) -> dict[str, Any]:
    return next(d for d in document["decisions"] if d["effect"] == effect)


def test_points_are_a_rule_of_integration() -> None:
    for each_way, panels in ((1, 1), (2, 1), (2, 8)):
        u, share = zip(*points(each_way, panels), strict=True)
        x, y = np.concatenate(u).T
        assert np.isclose(np.sum(share), 1)
        # Exact for polynomials of degree 2 n - 1 each way.
        degree = 2 * each_way - 1
        assert np.isclose(np.dot(share, x**degree * y**degree), (degree + 1.0) ** -2)


def test_a_lamp_is_points_where_the_picture_can_t_tell() -> None:
    """The planned picture agrees with one that samples the lamp, but for the estimate and noise."""
    found = one(GLOSSY, [LAMP])
    planned = plan(found, tolerance=0.1)
    told = of(planned.document, "area light")
    assert (told["off"], told["state"], told["points_each_way"]) == (True, "estimated", 1)
    assert told["bound"] is None
    assert 0 < told["found"] == pytest.approx(planned.document["estimated"])
    assert told["share"] == pytest.approx(1 - 0.01 ** (1 / told["points"]))
    assert "99% confidence" in told["sentence"]
    assert planned.document["bound"] + planned.document["estimated"] <= 0.1
    assert planned.document["operations"]["saved"] > 3
    # What the program does is judged once more as a whole.
    assert of(planned.document, "together")["found"] <= 0.1
    whole, less = render(found, samples=128, seed=1), render(found, samples=128, seed=2, by=planned)
    off = np.abs(less.radiance - whole.radiance)
    noise = np.hypot(less.standard_error, whole.standard_error)
    assert (off <= 0.1 * np.maximum(whole.radiance, 0.01 * whole.reference) + 6 * noise).all()
    assert off.max() > 0
    # With less to spend four points stand for it, and of them no difference is left to see.
    planned = plan(found, tolerance=0.004)
    assert planned.settings.points == (2,)
    alone = replace(Settings.everything(found), points=(2,))
    fine = render(found, samples=128, seed=2, settings=alone)
    assert_standard_normal(z_scores(*([p.radiance, p.standard_error] for p in (fine, whole))))


def test_a_lamp_is_sampled_where_shadows_mirrors_or_horizons_show_its_shape() -> None:
    ball = {"kind": "sphere", "radius": 0.8, "material": "m"}
    told = of(plan(one(GLOSSY, [LAMP], ball), tolerance=0.1).document, "area light")
    assert (told["off"], told["state"]) == (False, "needed")
    mirror = {"model": "specular", "values": {"ks": 0.9}}
    both = document(
        shapes=[PLANE, {**ball, "material": "ball", "center": [0, 0, 1]}], lights=[LAMP],
        materials={"m": mirror, "ball": GLOSSY},
    )  # fmt: skip
    told = of(plan(scene(both)).document, "area light")
    assert (told["off"], told["state"]) == (False, "not-bounded")
    away = {**document()["camera"], "position": [0, 0, 50], "look_at": [0, 1, 90]}
    nothing = scene(document(shapes=[PLANE], lights=[LAMP], materials={"m": GLOSSY}, camera=away))
    assert not [d for d in plan(nothing).document["decisions"] if d["effect"] == "area light"]


def test_lobes_that_fall_between_the_points_of_a_rule_are_seen() -> None:
    """Every rule misses them at every point alike: only directions that the material draws meet them."""
    mirror = {
        "model": {"family": "torrance_sparrow", "ndf": "beckmann", "masking": "smith"},
        "values": {"kd": 0.3, "ks": 1.0, "f0": 0.3, "alpha": 1e-4},
    }
    far = {"kind": "area", "center": [0, -8, 5], "normal": [0, 8, -5], "size": [2.5, 2.5], "radiance": 1.0}
    ball = {"kind": "sphere", "radius": 1.0, "material": "m"}
    planned = plan(one(mirror, [far], ball), tolerance=0.2)
    told = of(planned.document, "area light")
    assert (told["off"], told["state"]) == (False, "not-bounded")
    assert "narrower" in told["sentence"]


def test_estimates_that_fail_together_are_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    def further_off(*_: Any) -> np.ndarray:
        return np.full(300, 0.2)

    monkeypatch.setattr(estimates, "together", further_off)
    planned = plan(one(GLOSSY, [LAMP]), tolerance=0.1)
    told = of(planned.document, "together")
    assert (told["state"], told["found"], told["off"]) == ("needed", 0.2, False)
    assert not of(planned.document, "area light")["off"]
    assert planned.settings.points == (0,)
    assert planned.document["estimated"] == 0


@pytest.fixture(scope="module")
def measured() -> tuple[Table, dict[str, ReflectanceModel]]:
    """A table of a glossy surface, a fit to it, and a model of something else."""
    rng = np.random.default_rng(4)

    def directions(count: int) -> np.ndarray:
        theta, phi = np.deg2rad(rng.uniform(0, 85, count)), rng.uniform(0, 2 * np.pi, count)
        return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)

    wi = np.repeat(directions(12), 400, axis=0)
    wo = directions(len(wi))
    model = create("ward:bounded", kd=0.3, ks=0.1, alpha=0.5)
    table = Table(wi=wi, wo=wo, value=np.asarray(model.evaluate(wi, wo)), channels=["value"])
    other = create("lambert", kd=0.1)
    return table, {"close": fit(table, "ward:bounded").model, "other": other}


@pytest.mark.parametrize(("source", "used"), [("close", True), ("other", False)])
def test_a_fit_stands_in_for_a_table_where_it_is_as_good(
    measured: tuple[Table, dict[str, ReflectanceModel]], source: str, used: bool
) -> None:
    table, fits = measured

    def find(asked: Material) -> Any:
        return table if asked.table else fits[str(asked.fit)]

    doc = document(
        shapes=[PLANE], lights=[SUN, LAMP], materials={"m": {"table": "t", "fit": source}}, bounces=0
    )
    found = scene(doc, find=find)
    # What is rendered without a plan is the table.
    assert not isinstance(found.materials[0], ModelMaterial)
    planned = plan(found, tolerance=0.4)
    told = of(planned.document, "raw table")
    assert (told["off"], told["state"]) == (used, "estimated" if used else "needed")
    assert isinstance(planned.settings.direct[0], ModelMaterial) == used
    # It is drawn from as it is.
    assert planned.settings.materials == found.materials
    assert f"{source} {'in' if used else 'not in'} place of the table of m" in told["sentence"]
    if used:
        assert told["found"] <= 0.2
        # The fit's own effects are planned in its place.
        assert any(d["effect"] == "specular" for d in planned.document["decisions"])
        picture = render(found, samples=16, by=planned)
        whole = render(found, samples=16)
        off = np.abs(picture.radiance - whole.radiance)
        noise = np.hypot(picture.standard_error, whole.standard_error)
        assert (off <= 0.4 * np.maximum(whole.radiance, 0.01 * whole.reference) + 6 * noise).all()
        json.dumps(picture.to_dict())


def test_precision_is_a_decision_where_asked() -> None:
    found = one(GLOSSY, [SUN])
    for tolerance, precision, gone in ((0.01, "float32", True), (1e-9, "float64", False)):
        planned = plan(found, tolerance=tolerance, precision="auto")
        told = of(planned.document, "float64")
        assert (planned.document["precision"], told["off"]) == (precision, gone)
        assert render(found, samples=1, by=planned, precision="auto").precision == precision
        assert planned.document["estimated"] <= tolerance
    with pytest.raises(SpecError) as error:
        render(found, samples=1, precision="auto")
    assert error.value.code == "no-plan"


def test_what_may_stand_beside_a_table() -> None:
    every = Material(table="t", options={"quantity": "brdf"}, compressed="c", fit="f")
    assert every.rendered == Material(table="t", options={"quantity": "brdf"})
    assert every.stand_ins == (Material(fit="f"), Material(compressed="c"))
    assert Material(compressed="c", fit="f").rendered == Material(compressed="c")
    assert Material(compressed="c", fit="f").stand_ins == (Material(fit="f"),)
    assert Material(fit="f").stand_ins == ()
    with pytest.raises(ValueError, match="exactly one of"):
        Material(fit="f", model="lambert")
