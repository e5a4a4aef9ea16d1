"""Scene documents that the tests of this room start from."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def document(**changes: Any) -> dict[str, Any]:
    """A sphere on a plane under three lights, one channel."""
    found: dict[str, Any] = {
        "camera": {"position": [0, -4, 2], "look_at": [0, 0, 0.4], "width": 48, "height": 32, "fov_deg": 35},
        "channels": ["value"],
        "shapes": [
            {"kind": "plane", "size": [6, 6], "material": "floor"},
            {"kind": "sphere", "center": [0, 0, 0.7], "radius": 0.6, "material": "ball"},
        ],
        "lights": [
            {"kind": "directional", "direction": [1, -1, 2], "irradiance": 2.0},
            {"kind": "area", "center": [-1, -1, 3], "normal": [0.3, 0.3, -1], "size": [1, 1], "radiance": 3},
            {"kind": "environment", "radiance": 0.2},
        ],
        "materials": {
            "floor": {"model": "lambert", "values": {"kd": 0.5}},
            "ball": {
                "model": "torrance_sparrow:ggx",
                "values": {"kd": 0.2, "ks": 1.0, "f0": 0.3, "alpha": 0.2},
            },
        },
    }
    return {**found, **changes}


def flat(
    material: dict[str, Any], theta_deg: float, lights: list[dict[str, Any]], **camera: Any
) -> dict[str, Any]:
    """A plane that fills the picture, seen from one angle."""
    theta = np.deg2rad(theta_deg)
    eye = [10 * float(np.sin(theta)), 0.0, 10 * float(np.cos(theta))]
    seen = {
        "position": eye,
        "look_at": [0, 0, 0],
        "up": [0, 1, 0],
        "fov_deg": 0.05,
        "width": 16,
        "height": 16,
    }
    return {
        "camera": {**seen, **camera}, "channels": ["value"], "bounces": 0, "lights": lights,
        "shapes": [{"kind": "plane", "size": [50, 50], "material": "m"}], "materials": {"m": material},
    }  # fmt: skip


def z_scores(a: Any, b: Any) -> NDArray[np.float64]:
    """Differences of two pictures over their standard errors, of pixels that have any."""
    spread = np.hypot(a[1], b[1])
    some = spread > 0
    return ((a[0] - b[0])[some] / spread[some]).reshape(-1)


def assert_standard_normal(z: NDArray[np.float64], blocks: int = 1) -> None:
    """Mean and spread of z-scores; thresholds that a right pair fails once in 10,000 runs."""
    n = len(z) / blocks
    assert n > 50
    assert abs(z.mean()) < 3.9 / np.sqrt(n), z.mean()
    # Standard errors from few samples of skewed distributions make the spread a little wider than 1.
    assert 1 - 3.9 / np.sqrt(2 * n) < z.std() < 1.08 + 3.9 / np.sqrt(2 * n), z.std()
