"""Pictures in files: linear OpenEXR with standard errors, layers and the plan, and a tone-mapped PNG."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.documents import write_bytes
from fitter.scene.rendering import Picture

#: Attributes of the OpenEXR file: the picture's document and the plan it was rendered by.
ATTRIBUTE, PLAN = "brdf.picture", "brdf.plan"


def save(picture: Picture, folder: Path, name: str = "picture") -> list[Path]:
    """Write name.exr, name.png, name.json and, where there is one, name.plan.json; the paths written."""
    document = picture.to_dict()
    found = {
        f"{name}.exr": exr(picture), f"{name}.png": png(picture),
        f"{name}.json": json.dumps(document, indent=1).encode(),
    }  # fmt: skip
    if picture.plan is not None:
        found[f"{name}.plan.json"] = json.dumps(picture.plan, indent=1).encode()
    for file, content in found.items():
        write_bytes(content, folder / file)
    return [folder / file for file in found]


def exr(picture: Picture) -> bytes:
    """OpenEXR: a channel for each of the picture's, ``se.<name>`` its standard error, ``<layer>.<name>``."""
    names = _names(picture.channels)
    planes: dict[str, NDArray[np.float32]] = {}
    for k, name in enumerate(names):
        planes[name] = picture.radiance[..., k].astype(np.float32)
        planes[f"se.{name}"] = picture.standard_error[..., k].astype(np.float32)
        for layer, pixels in picture.layers.items():
            planes[f"{layer}.{name}"] = pixels[..., k].astype(np.float32)
    said = {ATTRIBUTE: json.dumps(picture.to_dict())}
    if picture.plan is not None:
        said[PLAN] = json.dumps(picture.plan)
    return exr_bytes(planes, said)


def planes_of(content: bytes, channels: Sequence[str]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Radiance and standard error (H, W, C) of a file that :func:`exr` wrote of these channels."""
    import OpenEXR

    # Without this R, G and B would come as one array.
    found = OpenEXR.File(BytesIO(content), separate_channels=True).channels()
    names = _names(tuple(channels))
    radiance, error = (
        np.stack([np.asarray(found[prefix + name].pixels, np.float64) for name in names], axis=-1)
        for prefix in ("", "se.")
    )
    return radiance, error


def exr_bytes(planes: Mapping[str, NDArray[np.float32]], said: Mapping[str, str]) -> bytes:
    """An OpenEXR file of planes (H, W) and of attributes."""
    import OpenEXR

    header: dict[str, Any] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **said}
    out = BytesIO()
    OpenEXR.File(header, {name: np.ascontiguousarray(plane) for name, plane in planes.items()}).write(out)
    return out.getvalue()


def png(picture: Picture) -> bytes:
    """Tone-mapped: radiance over the reference F, x/(1 + x) (E. Reinhard et al. 2002), sRGB."""
    return png_bytes(displayed(picture.radiance, picture.channels, picture.reference))


def displayed(radiance: NDArray[np.float64], channels: tuple[str, ...], scale: float) -> NDArray[np.uint8]:
    """(H, W, 3) sRGB bytes."""
    x = np.maximum(as_rgb(radiance, channels), 0.0) / (scale if scale > 0 else 1.0)
    x = x / (1.0 + x)
    coded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055)
    return np.round(255 * coded).astype(np.uint8)


def as_rgb(values: NDArray[np.float64], channels: tuple[str, ...]) -> NDArray[np.float64]:
    """(H, W, 3) of values (H, W, C); channels that are not RGB as their mean in grey."""
    if {"R", "G", "B"} <= set(channels):
        return values[..., [channels.index(name) for name in "RGB"]]
    return np.repeat(values.mean(axis=2, keepdims=True), 3, axis=2)


def png_bytes(pixels: NDArray[np.uint8]) -> bytes:
    """A PNG of (H, W, 3) bytes."""
    from matplotlib.image import imsave

    out = BytesIO()
    imsave(out, pixels, format="png", metadata={"Software": "brdf-fitter"})
    return out.getvalue()


def _names(channels: tuple[str, ...]) -> list[str]:
    """Channels as viewers expect them: one alone is Y."""
    return ["Y"] if len(channels) == 1 else list(channels)
