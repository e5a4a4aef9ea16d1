"""A look-up texture: one OpenEXR picture of an isotropic BRDF over theta_h, theta_d and phi_d.

Texels are nodes. Rows are theta_h = (row/(HALF - 1))^2 90 deg. Columns are tiles side by side, one for each
phi_d = tile/(TILES - 1) 180 deg, whose columns are theta_d = column/(DIFFERENCE - 1) 90 deg. phi_d counts
from the plane of the normal and the half vector; f_r is even in it, and of period 180 deg where it is
reciprocal. Between tiles a shader blends two look-ups; within one the hardware interpolates.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.export import sampling
from fitter.export.fidelity import of_function
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject, plain
from fitter.formats.output import write_aside
from fitter.formats.registry import Loss
from fitter.grid import Grid

FloatArray = NDArray[np.float64]

HALF, DIFFERENCE, TILES = 128, 64, 33
#: Directions are held this far above the horizon, where f_r ends.
_LOWEST = 1e-3


def write(subject: Subject, path: Path) -> Written:
    sampling.isotropic(subject, "a look-up texture")
    sampling.hemisphere(subject, "a look-up texture")
    theta_h = np.linspace(0.0, 1.0, HALF) ** 2 * (np.pi / 2)
    theta_d, phi_d = np.linspace(0.0, np.pi / 2, DIFFERENCE), np.linspace(0.0, np.pi, TILES)
    wi, wo = Grid("half_difference", {"theta_h": theta_h, "theta_d": theta_d, "phi_d": phi_d}).directions()
    value, outside = subject.evaluate(_lifted(wi), _lifted(wo))
    outside = outside & (wi[:, 2] > _LOWEST) & (wo[:, 2] > _LOWEST)
    negative = (value < 0).any(axis=1)
    value = np.where(np.isfinite(value), np.maximum(value, 0.0), 0.0)
    cube = value.reshape(HALF, DIFFERENCE, TILES, -1)
    picture = cube.transpose(0, 2, 1, 3).reshape(HALF, TILES * DIFFERENCE, -1)
    write_aside(path, [_exr(subject, np.ascontiguousarray(picture, np.float32))])

    def there(i: FloatArray, o: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        return looked_up(cube, i, o), np.zeros(len(i), bool)

    notes = [of_function(subject, there, "by linear interpolation")]
    if outside.any():
        share = outside.sum() / ((wi[:, 2] > _LOWEST) & (wo[:, 2] > _LOWEST)).sum()
        said = f"{share:.1%} of the texels lie outside what was measured, where the nearest is taken."
        notes.append(Loss("not-covered", said))
    if negative.any():
        notes.append(Loss("negative", f"{negative.mean():.2%} of the texels were negative and are 0."))
    return Written(tuple(notes))


def looked_up(cube: FloatArray, wi: FloatArray, wo: FloatArray) -> FloatArray:
    """f_r (M, C) of the nodes (HALF, DIFFERENCE, TILES, C), as a shader interpolates them."""
    theta_h, _, theta_d, phi_d = directions.half_difference_from_vectors(wi, wo)
    at = (
        np.sqrt(theta_h * (2 / np.pi)) * (HALF - 1), theta_d * (2 / np.pi) * (DIFFERENCE - 1),
        np.abs(_wrapped(phi_d)) / np.pi * (TILES - 1),
    )  # fmt: skip
    low = [np.clip(a.astype(np.intp), 0, n - 2) for a, n in zip(at, cube.shape, strict=False)]
    share = [(a - k)[:, None] for a, k in zip(at, low, strict=True)]
    total = np.zeros((len(wi), cube.shape[-1]))
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod([s if c else 1 - s for s, c in zip(share, corner, strict=True)], axis=0)
        i, j, k = (a + c for a, c in zip(low, corner, strict=True))
        total += weight * cube[i, j, k]
    return total


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray(np.mod(angle + np.pi, 2 * np.pi) - np.pi)


def _lifted(w: FloatArray) -> FloatArray:
    raised = np.concatenate([w[:, :2], np.maximum(w[:, 2:], _LOWEST)], axis=1)
    return raised / np.linalg.norm(raised, axis=1)[:, None]


def _exr(subject: Subject, picture: NDArray[np.float32]) -> bytes:
    import OpenEXR

    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage,
        "comments": " ".join([*subject.comments(), f"{TARGET.convention}.", _LAYOUT]),
        "brdf.table": plain(f"theta_h {HALF}, theta_d {DIFFERENCE}, phi_d {TILES}"),
    }  # fmt: skip
    names = "RGB" if picture.shape[-1] == 3 else "Y"
    planes = {name: np.ascontiguousarray(picture[..., k]) for k, name in enumerate(names)}
    sink = BytesIO()
    OpenEXR.File([OpenEXR.Part(header, planes, "brdf")]).write(sink)
    return sink.getvalue()


_LAYOUT = (
    f"Rows: theta_h = (row/{HALF - 1})^2 90 deg. Columns: {TILES} tiles of {DIFFERENCE}, one for each "
    f"phi_d = tile/{TILES - 1} 180 deg, in it theta_d = column/{DIFFERENCE - 1} 90 deg. Texels are nodes."
)

TARGET = Target(
    "lut", "look-up texture for shaders, OpenEXR over theta_h, theta_d and phi_d", True, True, ".exr",
    "f_r in 1/sr, without the cosine, as float32", write, "image/x-exr", channels=(1, 3),
)  # fmt: skip
