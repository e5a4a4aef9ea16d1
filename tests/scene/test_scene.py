"""Scene files: what they may hold, and what is said of those that make no sense."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fitter.errors import FitterError, SpecError
from fitter.scene import load_scene, scene
from fitter.scene.environment import read
from fitter.scene.picture import exr_bytes
from fitter.scene.spec import schema
from tests.scene.scenes import document

ROOT = Path(__file__).resolve().parents[2]
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


def test_the_published_schema_is_that_of_the_program() -> None:
    assert json.loads((ROOT / "docs" / "scene.schema.json").read_text()) == schema()


def test_toml_and_json_hold_the_same_scene(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps(document()))
    (tmp_path / "a.toml").write_text(
        """
        channels = ["value"]
        camera = { position = [0, -4, 2], look_at = [0, 0, 0.4], width = 48, height = 32, fov_deg = 35 }
        shapes = [
            { kind = "plane", size = [6, 6], material = "floor" },
            { kind = "sphere", center = [0, 0, 0.7], radius = 0.6, material = "ball" },
        ]
        lights = [
            { kind = "directional", direction = [1, -1, 2], irradiance = 2.0 },
            { kind = "area", center = [-1, -1, 3], normal = [0.3, 0.3, -1], size = [1, 1], radiance = 3 },
            { kind = "environment", radiance = 0.2 },
        ]
        [materials.floor]
        model = "lambert"
        values = { kd = 0.5 }
        [materials.ball]
        model = "torrance_sparrow:ggx"
        values = { kd = 0.2, ks = 1.0, f0 = 0.3, alpha = 0.2 }
        """
    )
    a, b = (load_scene(tmp_path / name) for name in ("a.json", "a.toml"))
    assert a.spec.model_dump() == b.spec.model_dump()


def without(name: str) -> dict[str, Any]:
    found = document()
    del found[name]
    return found


def with_light(light: dict[str, Any]) -> dict[str, Any]:
    return document(lights=[light])


def with_shape(shape: dict[str, Any]) -> dict[str, Any]:
    ball = document()["materials"]["ball"]
    return document(shapes=[{"material": "ball", **shape}], materials={"ball": ball})


AREA = {"kind": "area", "center": [0, 0, 3], "normal": [0, 0, -1], "radiance": 1}
SPHERE = {"kind": "sphere", "radius": 1.0}


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (document(colour="red"), "colour"),
        (without("camera"), "camera"),
        (document(camera={"position": [0, 0, 1], "look_at": [0, 0, 1]}), "looks at where it stands"),
        (document(camera={"position": [0, 0, 5], "look_at": [0, 0, 0]}), "up points along"),
        (
            document(camera={"position": [0, 0.1, 0.8], "look_at": [0, 0, 9], "up": [0, 1, 0]}),
            "inside shape 1, a sphere",
        ),
        (document(camera={"position": [1, 0, 0], "look_at": [0, 0, 9]}), "inside shape 0, a plane"),
        (with_light({**AREA, "size": [0, 1]}), "zero size"),
        (with_light({**AREA, "size": [-1, 1]}), "lights.0.area.size"),
        (with_light({"kind": "point", "position": [0, 0, 3], "intensity": [1, 2]}), "2 values of intensity"),
        (with_light({"kind": "point", "position": [0, 0, 3], "intensity": -1}), "intensity"),
        (with_light({"kind": "sun"}), "sun"),
        (with_light({"kind": "environment"}), "file or radiance"),
        (with_shape({**SPHERE, "radius": 0}), "radius"),
        (with_shape({**SPHERE, "material": "bal"}), "'bal'"),
        (document(materials={**document()["materials"], "gold": {"model": "lambert"}}), "'gold'"),
        (document(materials={**document()["materials"], "ball": {}}), "exactly one"),
        (
            document(
                materials={**document()["materials"], "ball": {"model": "ward", "values": {"alpha": 9}}}
            ),
            "alpha",
        ),
        (document(materials={**document()["materials"], "ball": {"table": "x.csv"}}), "can't name a file"),
        (with_shape({"kind": "mesh", "obj": "x.obj"}), "can't be a file"),
        (with_shape({"kind": "plate", "size": [1, 1], "heights": [[0, 0], [0, 0, 0]]}), "differ in length"),
        (
            with_shape(
                {"kind": "mesh", "vertices": [[0, 0, 0], [1, 0, 0], [2, 0, 0]], "triangles": [[0, 1, 2]]}
            ),
            "1 of 1 triangles are degenerate",
        ),
        (
            with_shape(
                {"kind": "mesh", "vertices": [[0, 0, 0], [1, 0, 0], [0, 2, 0]], "triangles": [[0, 1, 3]]}
            ),
            "not among the 3",
        ),
        (
            document(
                channels=["R", "G", "B"],
                lights=document()["lights"][:1],
                materials={
                    **document()["materials"],
                    "floor": {"model": "lambert", "values": {"kd": [0.1, 0.2]}},
                },
            ),
            "c0, c1",
        ),
    ],
)
def test_scenes_that_make_no_sense_are_refused(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(SpecError) as caught:
        scene(wrong)
    assert said in str(caught.value)
    assert caught.value.remedy or caught.value.parameter


@pytest.mark.parametrize(
    ("text", "said", "row"),
    [
        (TRIANGLE + "f 1 2 3\nf 1 2 2\n", "degenerate", 5),
        (TRIANGLE + "f 1 2 7\n", "no vertex 7", 4),
        ("v 0 0 x\n", "'v 0 0 x'", 1),
        ("v 0 0 nan\nf 1 1 1\n", "finite", 1),
        (TRIANGLE, "no face", None),
    ],
)
def test_meshes_that_are_none_are_refused(tmp_path: Path, text: str, said: str, row: int | None) -> None:
    (tmp_path / "mesh.obj").write_text(text)
    with pytest.raises(SpecError) as caught:
        scene(with_shape({"kind": "mesh", "obj": "mesh.obj"}), folder=tmp_path)
    assert said in str(caught.value)
    assert caught.value.row == row


def test_obj_files_with_polygons_and_counts_from_the_end(tmp_path: Path) -> None:
    (tmp_path / "mesh.obj").write_text(
        "# a quad\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0 0 1\nf -4//1 2/3/1 3 4\n"
    )
    found = scene(with_shape({"kind": "mesh", "obj": "mesh.obj"}), folder=tmp_path).geometry
    assert found.counts == (0, 0, 2)
    assert np.allclose(found.triangle_frame[:, 2], [0, 0, 1])


def test_a_camera_inside_a_closed_mesh_is_refused() -> None:
    cube = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ([a, b, c], [a, c, d])]
    shape = {"kind": "mesh", "vertices": cube, "triangles": triangles}
    inside = {"position": [0.4, 0.5, 0.6], "look_at": [5, 0, 0]}
    with pytest.raises(SpecError, match="inside shape 0, a mesh"):
        scene({**with_shape(shape), "camera": inside})
    scene({**with_shape(shape), "camera": {**inside, "position": [0.4, 0.5, 1.6]}})


def _sky(path: Path, pixels: np.ndarray, names: str = "RGB") -> Path:
    path.write_bytes(exr_bytes({name: pixels[..., k].astype(np.float32) for k, name in enumerate(names)}, {}))
    return path


def test_environments_are_read_and_checked(tmp_path: Path) -> None:
    pixels = np.random.default_rng(1).random((4, 8, 3)).astype(np.float32)
    found = read(_sky(tmp_path / "sky.exr", pixels), ("B", "R"))
    assert np.array_equal(found, pixels[..., [2, 0]])
    pixels[2, 5, 1] = np.nan
    with pytest.raises(SpecError, match=r"1 of 32 pixels are NaN.*row 2, column 5"):
        read(_sky(tmp_path / "nan.exr", pixels), ("R", "G", "B"))
    pixels[2, 5, 1] = -1
    with pytest.raises(SpecError, match="negative"):
        read(_sky(tmp_path / "negative.exr", pixels), ("R", "G", "B"))
    with pytest.raises(SpecError, match="channels B, G, R"):
        read(_sky(tmp_path / "sky.exr", np.ones((2, 4, 3))), ("550",))
    (tmp_path / "none.exr").write_bytes(b"nothing")
    for name in ("none.exr", "missing.exr"):
        with pytest.raises(SpecError, match="can't be read"):
            read(tmp_path / name, ("R",))


@pytest.mark.parametrize("text", ['{"camera": ', "camera = ", "\x00"])
def test_files_that_are_no_scene_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(FitterError, match=r"scene\.toml"):
        load_scene(tmp_path / "scene.toml")
