"""Against Mitsuba 3: the same scenes, pixel by pixel, within the standard errors of both."""

from __future__ import annotations

import importlib.util
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fitter.scene import render, scene
from fitter.scene.picture import exr_bytes
from tests.scene.scenes import assert_standard_normal, z_scores

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None,
    reason="NOT CHECKED AGAINST MITSUBA: the package mitsuba is not here",
)

WIDTH, HEIGHT, SAMPLES = 32, 24, 64
EYE, AT, FOV = [0.5, -4.0, 1.8], [0.0, 0.0, 0.5], 38.0
ALPHA, ETA, KAPPA, KD = 0.3, 0.2, 3.0, 0.6


def sky() -> np.ndarray:
    """A smooth environment (256, 512), by angles of its pixels' centres: ours."""
    theta = (np.arange(256) + 0.5) * np.pi / 256
    return _sky(theta, (np.arange(512) + 0.5) * 2 * np.pi / 512)


def _sky(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    x = np.sin(theta)[:, None] * np.cos(phi - 2.0)
    return np.exp(2.0 * x) + 0.5 * (1 + np.cos(theta))[:, None]


LAMBERT: tuple[dict[str, Any], dict[str, Any]] = (
    {"model": "lambert", "values": {"kd": KD}},
    {"type": "diffuse", "reflectance": {"type": "spectrum", "value": KD}},
)
METAL: tuple[dict[str, Any], dict[str, Any]] = (
    {
        "model": {
            "family": "torrance_sparrow", "ndf": "ggx", "masking": "smith_separable", "fresnel": "conductor",
            "diffuse": "none",
        },
        "values": {"ks": 1.0, "alpha": ALPHA, "eta": ETA, "kappa": KAPPA},
    },
    {
        "type": "roughconductor", "distribution": "ggx", "alpha": ALPHA,
        "eta": {"type": "spectrum", "value": ETA}, "k": {"type": "spectrum", "value": KAPPA},
    },
)  # fmt: skip


def ours(
    kind: str, plane: dict[str, Any], ball: dict[str, Any], folder: Path
) -> tuple[np.ndarray, np.ndarray]:
    """Radiance and its standard error, per pixel, of our materials."""
    (folder / "sky.exr").write_bytes(exr_bytes({"Y": sky().astype(np.float32)}, {}))
    lights = {
        "directional": {"kind": "directional", "direction": [1, -1, 1.5], "irradiance": 2.0},
        "environment": {"kind": "environment", "file": "sky.exr"},
    }
    document = {
        "camera": {"position": EYE, "look_at": AT, "fov_deg": FOV, "width": WIDTH, "height": HEIGHT},
        "channels": ["value"], "bounces": 0, "light_samples": 1, "lights": [lights[kind]],
        "materials": {"a": plane, "b": ball},
        "shapes": [
            {"kind": "plane", "size": [6, 6], "material": "a"},
            {"kind": "sphere", "center": [0, 0, 0.7], "radius": 0.6, "material": "b"},
        ],
    }  # fmt: skip
    picture = render(scene(document, folder=folder), samples=SAMPLES, seed=11)
    return picture.radiance[..., 0], picture.standard_error[..., 0]


def theirs(kind: str, plane: dict[str, Any], ball: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """The same of Mitsuba's BSDFs."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import mitsuba

        mi: Any = mitsuba
        mi.set_variant("scalar_rgb")
        t = mi.ScalarTransform4f
        if kind == "directional":
            light: dict[str, Any] = {
                "type": "directional", "direction": [-1, 1, -1.5],
                "irradiance": {"type": "spectrum", "value": 2.0},
            }  # fmt: skip
        else:
            # Its rows lie on the poles, its columns from azimuth 0 of its own frame, y up, clockwise.
            theta = np.arange(257) * np.pi / 256
            phi = np.pi / 2 - (np.arange(512) + 0.5) * 2 * np.pi / 512
            pixels = np.repeat(_sky(theta, phi)[..., None], 3, axis=2).astype(np.float32)
            light = {"type": "envmap", "bitmap": mi.Bitmap(pixels), "to_world": t().rotate([1, 0, 0], 90)}
        loaded = mi.load_dict(
            {
                "type": "scene", "integrator": {"type": "direct"}, "light": light,
                "sensor": {
                    "type": "perspective", "fov": FOV, "fov_axis": "y",
                    "to_world": t().look_at(origin=EYE, target=AT, up=[0, 0, 1]),
                    "film": {
                        "type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"},
                        "pixel_format": "luminance", "component_format": "float32",
                    },
                    "sampler": {"type": "independent"},
                },
                "plane": {"type": "rectangle", "to_world": t().scale([3, 3, 1]), "bsdf": plane},
                "ball": {"type": "sphere", "center": [0, 0, 0.7], "radius": 0.6, "bsdf": ball},
            }
        )  # fmt: skip
        passes = np.stack(
            [np.asarray(mi.render(loaded, spp=1, seed=k), np.float64)[..., 0] for k in range(SAMPLES)]
        )
    return passes.mean(axis=0), passes.std(axis=0) / np.sqrt(SAMPLES - 1)


@pytest.mark.long
@pytest.mark.parametrize("swapped", [False, True], ids=["metal-ball", "metal-plane"])
@pytest.mark.parametrize("kind", ["directional", "environment"])
def test_pictures_agree(kind: str, swapped: bool, tmp_path: Path) -> None:
    plane, ball = (METAL, LAMBERT) if swapped else (LAMBERT, METAL)
    assert_same(ours(kind, plane[0], ball[0], tmp_path), theirs(kind, plane[1], ball[1]))


def assert_same(a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]) -> None:
    """Means within 3 standard errors, differences of pixels over theirs as standard normal numbers."""
    assert b[0].max() > 0
    spread = np.sqrt((a[1] ** 2).sum() + (b[1] ** 2).sum()) / a[0].size
    assert abs(a[0].mean() - b[0].mean()) < 3 * spread + 2e-5 * b[0].mean()
    assert_standard_normal(z_scores(a, b))
