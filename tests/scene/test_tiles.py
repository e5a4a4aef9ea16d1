"""Plans by tile: tiles share the picture out, blank ones show nothing, and each program keeps its bound."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fitter.scene import plan, render, scene
from fitter.scene.assembly import Scene
from fitter.scene.integrate import Integrator
from fitter.scene.regions import Region, Tiles
from fitter.scene.settings import Settings
from fitter.scene.surfaces import Surfaces
from tests.scene.scenes import document

SUN = {"kind": "directional", "direction": [1, 2, 0.15], "irradiance": 2.0}
LAMP = {"kind": "area", "center": [-1, -1, 3], "normal": [0.3, 0.3, -1], "size": [1, 1], "radiance": 3}
GLOSSY = {
    "model": {"family": "torrance_sparrow", "ndf": "ggx", "masking": "smith"},
    "values": {"kd": 0.3, "ks": 1.0, "f0": 0.04, "alpha": 0.3},
}
BALL = {"kind": "sphere", "radius": 0.8, "material": "m"}


def ball(lights: list[dict[str, Any]], **more: Any) -> Scene:
    return scene(document(shapes=[BALL], lights=lights, materials={"m": GLOSSY}, **more))


@given(st.integers(1, 40), st.integers(1, 40), st.integers(1, 50), st.integers(1, 50))
def test_tiles_share_a_picture_out(width: int, height: int, columns: int, rows: int) -> None:
    camera = scene(document()).spec.camera.model_copy(update={"width": width, "height": height})
    tiles = Tiles.of(camera, columns, rows)
    parts = [Region(tiles, frozenset({t})).pixels for t in range(len(tiles))]
    assert all(len(part) for part in parts)
    assert sorted(np.concatenate(parts).tolist()) == list(range(width * height))
    some = Region(tiles, frozenset({0}))
    assert len(Region.whole(tiles).rest([some]).pixels) == width * height - len(some.pixels)


def test_boxes_reach_the_tiles_that_points_are_in() -> None:
    """Points of surfaces lie in the tile that the camera sees them in, and nothing reaches a blank tile."""
    found = scene(document())
    camera = found.spec.camera
    tiles = Tiles.of(camera, 6, 5)
    one = Integrator(found, Settings.everything(found), np.dtype(np.float64))
    from fitter.scene import kernels

    pixel = np.arange(camera.width * camera.height)
    rng = np.random.default_rng(3)
    o, d = kernels.camera_rays(one.basis, one.eye, one.size, pixel, rng.random((len(pixel), 2)))  # type: ignore[arg-type]
    hit = kernels.nearest(one.shapes, o, d, np.full(len(pixel), -1))  # type: ignore[arg-type]
    shown = np.flatnonzero(np.asarray(hit.primitive) >= 0)
    point, tile = np.asarray(hit.point)[shown], tiles.of_pixel(shown)
    for t in range(len(tiles)):
        inside = Surfaces(found, Region(tiles, frozenset({t}))).view.shows(point)
        assert (inside == (tile == t)).mean() > 0.999
    reached = Surfaces(found).reached(tiles).reshape(-1)
    assert reached[np.unique(tile)].all()
    assert not reached.all()
    # Coordinates on primitives are those of the points.
    surfaces = Surfaces(found)
    primitive = np.asarray(hit.primitive)[shown]
    at = surfaces.coordinates(primitive, point)
    from fitter.scene.boxes import Boxes

    at = np.concatenate([at, np.zeros_like(at)], axis=1)
    angles = surfaces.angles(Boxes(primitive, np.zeros(len(at), np.intp), at, at))
    assert np.allclose(np.stack([x.mid for x in angles.point], axis=1), point, atol=1e-6)


@pytest.mark.parametrize("light", ["sun", "lamp"])
def test_programs_of_tiles_keep_the_bound(light: str) -> None:
    found = ball([SUN if light == "sun" else LAMP])
    planned = plan(found, tolerance=0.02, tiles=(6, 4))
    told = planned.document
    assert 2 <= len(planned.programs) <= 3
    pixels = np.concatenate([one.region.pixels for one in planned.programs])
    assert sorted(pixels.tolist()) == list(range(48 * 32))
    assert [p["pixels"] for p in told["programs"]] == [len(one.region.pixels) for one in planned.programs]
    # Fewer operations than by the one program for all.
    assert told["operations"]["planned"] < told["programs"][0]["operations"]["planned"]
    assert told["bound"] + told["estimated"] <= 0.02 * (1 + 1e-9)
    floor = 0.01 * told["reference"]
    full = Integrator(found, Settings.everything(found), np.dtype(np.float64))
    kinds = set()
    for one in planned.programs:
        less = Integrator(found, one.settings, np.dtype(np.float64))
        kinds.add(one.settings.blank)
        for seed in range(3):
            a, met = full.batch(one.region.pixels, (seed,))
            b, _ = less.batch(one.region.pixels, (seed,))
            if one.settings.blank:
                assert not met.any()
            # Where a lamp is points, its samples are what differs.
            if not any(one.settings.points):
                assert (np.abs(a - b) <= (one.bound + 1e-9) * np.maximum(a, floor)).all()
    assert kinds == {True, False}
    whole, less = render(found, samples=64, seed=1), render(found, samples=64, seed=2, by=planned)
    off = np.abs(whole.radiance - less.radiance)
    noise = np.hypot(whole.standard_error, less.standard_error)
    assert (off <= 0.02 * np.maximum(whole.radiance, floor) + 6 * noise + 1e-6).mean() > 0.999
    assert (less.hit > 0).mean() == pytest.approx((whole.hit > 0).mean(), abs=0.02)


def test_one_tile_is_one_program() -> None:
    planned = plan(ball([SUN]), tolerance=0.02)
    assert len(planned.programs) == 1
    assert planned.document["programs"] == []
