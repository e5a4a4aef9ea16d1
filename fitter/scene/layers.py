"""Layers: what each effect adds to a picture, as the difference of two with the same random numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fitter.progress import Progress, ignore
from fitter.scene import effects
from fitter.scene.assembly import Scene
from fitter.scene.constants import constants_of
from fitter.scene.materials import ModelMaterial
from fitter.scene.rendering import Picture, Precision, render
from fitter.scene.settings import Settings


def settings_without(scene: Scene) -> Mapping[str, Settings]:
    """The settings that leave out one effect each: of a material for direct light, a light, shadows,
    reflections between shapes."""
    full = Settings.everything(scene)
    found: dict[str, Settings] = {}
    for m, (name, one) in enumerate(zip(scene.names, scene.materials, strict=True)):
        if not isinstance(one, ModelMaterial):
            continue
        for effect in effects.effects(one.model):
            less = replace(one, off=frozenset({effect}), constants=constants_of(scene, m, one))
            direct = (*full.direct[:m], less, *full.direct[m + 1 :])
            found[f"{name}.{effect}"] = replace(full, direct=direct)
    for k in range(len(scene.lamps)):
        first = tuple(j != k for j in range(len(scene.lamps)))
        found[f"light{k}"] = replace(full, first=first)
    found["shadows"] = replace(full, shadows=(False,) * len(scene.lamps))
    if full.bounces:
        found["bounces"] = replace(full, bounces=0)
    return found


def layers(scene: Scene, picture: Picture, progress: Progress = ignore) -> dict[str, NDArray[np.float64]]:
    """Radiance (H, W, C) that each effect adds to a picture: it, less the same without the effect.

    Rendered with the picture's seed, samples and precision, and all effects but one.
    """
    precision: Precision = picture.precision
    wanted = settings_without(scene)
    whole = render(scene, samples=picture.samples, seed=picture.seed, precision=precision)
    found: dict[str, NDArray[np.float64]] = {}
    for k, (name, settings) in enumerate(wanted.items()):

        def step(share: float, what: str, k: int = k, name: str = name) -> None:
            progress((k + share) / len(wanted), f"layer {name}: {what}")

        less = render(
            scene, samples=picture.samples, seed=picture.seed, precision=precision, settings=settings,
            progress=step,
        )  # fmt: skip
        found[name] = whole.radiance - less.radiance
    return found
