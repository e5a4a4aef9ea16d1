"""Rendering: white furnace, brute force, no NaN, and when it stops."""

from __future__ import annotations

import itertools
from typing import Any

import jax.numpy as jnp
import numpy as np
import OpenEXR
import pytest

from fitter import datasets
from fitter.errors import SpecError
from fitter.formats import load
from fitter.scene import kernels as k
from fitter.scene import render, scene
from fitter.scene.assembly import Scene
from fitter.scene.kernels import Shapes
from fitter.scene.materials import ModelMaterial, TableMaterial
from fitter.scene.picture import exr, png
from fitter.table import Table
from tests.scene.scenes import assert_standard_normal, document, flat, z_scores

WHITE = [{"kind": "environment", "radiance": 1.0}]
FURNACE: dict[str, dict[str, float]] = {
    "torrance_sparrow:ggx": {"kd": 0.1, "ks": 0.8, "f0": 0.4, "alpha": 0.3}, "specular": {"ks": 0.7},
}  # fmt: skip


@pytest.mark.parametrize("name", FURNACE)
def test_white_furnace_leaves_one_minus_albedo_dark(name: str) -> None:
    material = {"model": name, "values": FURNACE[name]}
    for theta in (20.0, 80.0):
        found = scene(flat(material, theta, WHITE))
        picture = render(found, samples=32, seed=3)
        model = found.materials[0]
        assert isinstance(model, ModelMaterial)
        v = [float(np.sin(np.deg2rad(theta))), 0.0, float(np.cos(np.deg2rad(theta)))]
        albedo = float(model.model.albedo(v)[0])
        standard_error = float(np.sqrt((picture.standard_error**2).sum())) / picture.radiance.size
        assert abs(picture.radiance.mean() - albedo) < 4 * standard_error + 2e-4, (name, theta)


def test_glass_in_a_white_furnace_is_invisible() -> None:
    shapes = [{"kind": "sphere", "radius": 1.0, "material": "glass"}]
    glass = {"glass": {"model": "smooth_dielectric", "values": {"eta": 1.5}}}
    camera = {"position": [0, -4, 0], "look_at": [0, 0, 0], "width": 24, "height": 24}
    found = scene(document(shapes=shapes, materials=glass, lights=WHITE, bounces=6, camera=camera))
    picture = render(found, samples=2)
    assert 0.2 < (picture.hit > 0).mean() < 0.9
    assert np.abs(picture.radiance - 1).max() < 0.02


@pytest.fixture(scope="module")
def measured() -> Table:
    return load(datasets.sample("glossy_paint"))


def _with_table(doc: dict[str, Any], table: Table) -> Scene:
    doc = {**doc, "channels": [table.channels[0].name], "materials": {"m": {"table": "x"}}}
    return scene(doc, find=lambda _: table)


def test_a_raw_table_renders_as_its_interpolant_by_brute_force(measured: Table) -> None:
    sun = {"kind": "area", "center": [3, 0, 4], "normal": [-3, 0, -4], "size": [2, 2], "radiance": 2.0}
    found = _with_table(flat({}, 40.0, [*WHITE, sun], width=16, height=16, fov_deg=20), measured)
    picture = render(found, samples=24, seed=5)

    # Uniform directions of the hemisphere, each looked up; nothing of the renderer's light or material code.
    rng, n = np.random.default_rng(7), 256 * 128
    o, d = k.camera_rays(
        jnp.asarray(k.camera_basis(found.spec.camera)), jnp.asarray(found.spec.camera.position),
        jnp.asarray([16, 16]), jnp.tile(jnp.arange(256), 128), jnp.asarray(rng.random((n, 2))),
    )  # fmt: skip
    o, d = np.asarray(o), np.asarray(d)
    point = o - (o[:, 2] / d[:, 2])[:, None] * d
    z, phi = rng.random(n), 2 * np.pi * rng.random(n)
    l = np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z], axis=1)
    f, _ = measured.evaluate(l, -d)
    centre, normal = np.array([3.0, 0.0, 4.0]), np.array([-0.6, 0.0, -0.8])
    down = -(l @ normal)
    t = ((point - centre) @ normal) / np.where(down > 0, down, 1)
    at = point + t[:, None] * l - centre
    lit = (down > 0) & (t > 0) & (np.abs(at[:, 1]) <= 1) & (np.abs(at @ np.array([0.8, 0, -0.6])) <= 1)
    brute = np.maximum(np.nan_to_num(f[:, 0]), 0) * z * 2 * np.pi * (1.0 + 2.0 * lit)
    brute = brute.reshape(128, 256)
    ours = picture.radiance.reshape(-1), picture.standard_error.reshape(-1)
    theirs = brute.mean(axis=0), brute.std(axis=0) / np.sqrt(len(brute) - 1)
    assert_standard_normal(z_scores(ours, theirs))
    spread = float(np.hypot(np.sqrt((ours[1] ** 2).sum()), np.sqrt((theirs[1] ** 2).sum()))) / 256
    assert abs(ours[0].mean() - theirs[0].mean()) < 3 * spread


def test_what_a_table_can_t_say_is_said(measured: Table) -> None:
    found = _with_table(flat({}, 89.5, WHITE), measured)
    picture = render(found, samples=2)
    material = found.materials[0]
    assert isinstance(material, TableMaterial)
    assert 0 < material.extrapolation.outside <= material.extrapolation.asked
    assert any("outside what was measured" in note and "viewer at 89" in note for note in picture.notes)
    assert picture.tables["m"]["extrapolated_share"] > 0


def test_the_same_seed_gives_the_same_picture() -> None:
    found = scene(document())
    a, b, c = (render(found, samples=2, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(a.radiance, b.radiance)
    assert not np.array_equal(a.radiance, c.radiance)


def test_float32_is_float64_to_its_rounding() -> None:
    found = scene(document())
    a, b = (render(found, samples=4, precision=p) for p in ("float32", "float64"))  # pyright: ignore[reportArgumentType]
    for one in (a, b):
        assert np.isfinite(one.radiance).all()
        assert (one.radiance >= 0).all()
    apart = np.abs(a.radiance - b.radiance) / b.reference
    # Rays at rims and shadows' edges end elsewhere; all others differ by rounding.
    assert np.quantile(apart, 0.95) < 1e-4
    assert abs(a.radiance.mean() - b.radiance.mean()) < 1e-3 * b.reference


def test_shapes_hide_and_shade_each_other() -> None:
    lights = [{"kind": "point", "position": [0, 0, 3], "intensity": 9.0}]
    camera = {"position": [0, -6, 3], "look_at": [0, 0, 0], "width": 32, "height": 32}
    alone = document()["shapes"][:1]
    floor = {"floor": document()["materials"]["floor"]}
    bright = render(
        scene(document(lights=lights, camera=camera, shapes=alone, materials=floor, bounces=0)), samples=2
    )
    both = render(scene(document(lights=lights, camera=camera, bounces=0)), samples=2)
    more = render(scene(document(lights=lights, camera=camera, bounces=1)), samples=16)
    dark = (both.radiance == 0) & (bright.radiance > 0) & (both.hit[..., None] == 1)
    assert 5 < dark.sum() < 100
    assert more.radiance[dark].max() > 0


def test_ways_to_stop() -> None:
    found = scene(document(camera={**document()["camera"], "width": 16, "height": 16}))
    assert render(found, samples=3).stopped == "samples"
    assert render(found, seconds=1e-3).stopped == "seconds"
    exact = render(found, target_error=0.2)
    assert exact.stopped == "target_error"
    assert exact.error <= 0.2
    assert [s for s, _, _ in exact.history] == sorted({s for s, _, _ in exact.history})
    for name, limit in itertools.product(("samples", "seconds", "target_error"), (0, -1)):
        with pytest.raises(SpecError, match=name):
            render(found, **{name: limit})


def test_pictures_hold_radiance_and_standard_errors(tmp_path: Any) -> None:
    picture = render(scene(document()), samples=2)
    (tmp_path / "p.exr").write_bytes(exr(picture))
    file = OpenEXR.File(str(tmp_path / "p.exr"), True)
    found = file.parts[0].channels
    assert set(found) == {"Y", "se.Y"}
    assert np.array_equal(found["Y"].pixels, picture.radiance[..., 0].astype(np.float32))
    assert png(picture).startswith(b"\x89PNG")


def test_rays_find_what_arithmetic_finds() -> None:
    vertices = [[0.0, 0.0, 2.0], [1.0, 0.0, 2.0], [0.0, 1.0, 2.0]]
    shapes = [
        {"kind": "sphere", "center": [0, 0, 0], "radius": 1.0, "material": "floor"},
        {"kind": "plane", "center": [0, 0, -2], "size": [4, 2], "material": "floor"},
        {"kind": "mesh", "vertices": vertices, "triangles": [[0, 1, 2]] * 100, "material": "ball"},
    ]
    found = scene(document(shapes=shapes))
    arrays = Shapes.of(found.geometry, np.dtype(np.float64))
    o = jnp.asarray([[0.2, 0.2, 5.0], [0.9, 0.0, 5.0], [1.9, 0.9, 5.0], [1.9, 1.1, 5.0], [0.7, 0.7, 5.0]])
    d = jnp.broadcast_to(jnp.asarray([0.0, 0.0, -1.0]), o.shape)
    hit = k.nearest(arrays, o, d, jnp.full(5, -1))
    assert hit.primitive.tolist() == [2, 2, 1, -1, 0]
    assert np.allclose(hit.t, [3, 3, 7, np.inf, 5 - np.sqrt(1 - 0.98)])
    assert np.allclose(np.asarray(hit.frame) @ np.swapaxes(np.asarray(hit.frame), 1, 2), np.eye(3))
