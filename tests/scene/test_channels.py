"""Channels that need not be told apart: their ratios are enclosed, and what is merged is computed once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fitter.scene import plan, render, scene
from fitter.scene.assembly import Scene
from fitter.scene.channels import merged
from fitter.scene.integrate import Integrator
from fitter.scene.settings import Settings
from fitter.table import Table
from tests.scene.scenes import document

RGB = {"channels": ["R", "G", "B"]}
SUN = {"kind": "directional", "direction": [1, -1, 2], "irradiance": [2.0, 1.0, 0.5]}
LAMP = {
    "kind": "area", "center": [-1, -1, 3], "normal": [0.3, 0.3, -1], "size": [1, 1],
    "radiance": [3, 1.5, 0.75],
}  # fmt: skip
PLANE = {"kind": "plane", "size": [6, 6], "material": "floor"}


def ggx(kd: Any, f0: Any = 0.04, ks: Any = 1.0) -> dict[str, Any]:
    return {"model": "torrance_sparrow:ggx", "values": {"kd": kd, "ks": ks, "f0": f0, "alpha": 0.3}}


def plate(material: dict[str, Any], lights: list[dict[str, Any]], **more: Any) -> Scene:
    given = {**RGB, "bounces": 0, **more}
    return scene(document(shapes=[PLANE], materials={"floor": material}, lights=lights, **given))


def pictures(found: Scene, seed: int = 1) -> np.ndarray:
    """Of all channels, (N, 3) in float64."""
    pixel = np.arange(found.spec.camera.width * found.spec.camera.height)
    return Integrator(found, Settings.everything(found), np.dtype(np.float64)).batch(pixel, (seed,))[0]


LEVEL = st.floats(0.05, 0.9)


@settings(max_examples=25)
@given(kd=st.tuples(LEVEL, LEVEL, LEVEL), f0=st.tuples(LEVEL, LEVEL, LEVEL), light=st.tuples(*[LEVEL] * 3))
def test_bounds_hold_for_any_colours(
    kd: tuple[float, ...], f0: tuple[float, ...], light: tuple[float, ...]
) -> None:
    """Of the very same paths, reflections between shapes and lamps that are seen included."""
    floor = {"model": "lambert", "values": {"kd": kd}}
    lights = [{**SUN, "irradiance": light}, LAMP]
    found = scene(document(materials={"floor": floor, "ball": ggx(0.3, f0)}, lights=lights, **RGB))
    few, bound = merged(found, found.spec.bounces, 0.8)
    if few is None:
        assert bound == 0
        return
    assert max(few.scale) <= 1.0
    assert bound <= 0.8
    every = pictures(found)
    error = np.abs(few.apart(every[:, list(few.columns)]) - every)
    assert (error <= bound * every * (1 + 1e-9) + 1e-15).all()


def test_grey_under_any_light_is_computed_once() -> None:
    grey = plate(ggx(0.3), [SUN])
    few, bound = merged(grey, 0, 1e-6)
    assert few is not None
    assert (few.columns, few.scale, bound) == ((0,), (1.0, 0.5, 0.25), 0.0)
    planned = plan(grey, tolerance=1e-4)
    whole, less = render(grey, samples=2), render(grey, samples=2, by=planned)
    assert np.allclose(less.radiance, whole.radiance, rtol=1.1e-4)
    told = next(d for d in planned.document["decisions"] if d["effect"] == "channels")
    assert (told["state"], told["off"], told["computed"]) == ("bounded", True, ["R"])
    assert planned.document["operations"]["saved"] > 1.1


@pytest.mark.parametrize(
    ("material", "lights"),
    [
        # One scattering of a matte colour is a factor; of two terms of other colours it is not.
        (ggx((0.2, 0.4, 0.6), (0.6, 0.4, 0.2)), [SUN]),
        # Two lamps of other colours.
        (ggx(0.3), [SUN, {**LAMP, "radiance": [1, 2, 3]}]),
    ],
)
def test_what_lights_or_materials_tell_apart_is_kept(
    material: dict[str, Any], lights: list[dict[str, Any]]
) -> None:
    assert merged(plate(material, lights), 0, 0.01) == (None, 0.0)


def test_one_scattering_of_a_matte_colour_is_a_factor_and_two_are_not() -> None:
    matte = {"model": "lambert", "values": {"kd": [0.2, 0.4, 0.8]}}
    few, bound = merged(plate(matte, [{**SUN, "irradiance": 1.0}]), 0, 1e-6)
    assert few is not None
    assert np.allclose(few.scale, [0.25, 0.5, 1.0])
    # Rounding of float32 parameters apart.
    assert bound < 1e-6
    assert merged(plate(matte, [{**SUN, "irradiance": 1.0}], bounces=1), 1, 0.1) == (None, 0.0)
    # A lamp that is seen does not know of the surface.
    assert merged(plate(matte, [{**LAMP, "radiance": 1.0}]), 0, 0.1) == (None, 0.0)


def test_a_channel_without_light_is_not_computed() -> None:
    red = plate(ggx(0.3), [{**SUN, "irradiance": [1.0, 0.0, 0.0]}])
    few, _ = merged(red, 0, 1e-6)
    assert few is not None
    assert (few.columns, few.scale) == ((0,), (1.0, 0.0, 0.0))
    assert (render(red, samples=2, by=plan(red)).radiance[..., 1:] == 0).all()


def test_a_raw_table_of_one_channel_serves_all_and_of_three_tells_them_apart() -> None:
    w = np.array([[0.6, 0, 0.8], [0, 0, 1.0]])
    for count in (1, 3):
        names = ["R", "G", "B"][:count]
        table = Table(wi=w, wo=w, value=np.ones((2, count)), channels=names)
        doc = document(
            shapes=[PLANE], materials={"floor": {"table": "t"}}, lights=[SUN], bounces=0, **RGB
        )
        few, _ = merged(scene(doc, find=lambda _, table=table: table), 0, 1e-6)
        assert (few is None) == (count == 3)
