"""What a fit is worth in a scene: the raw table, the fit and their difference side by side, and numbers."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.documents import write_bytes
from fitter.errors import SpecError
from fitter.models import ReflectanceModel
from fitter.progress import Progress, ignore
from fitter.scene import picture as files
from fitter.scene.assembly import Scene, made_of
from fitter.scene.materials import Material
from fitter.scene.rendering import Picture, render
from fitter.table import Table

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Pixels:
    """What of a picture is compared: radiance and standard_error (H, W, C), W/(m2 sr)."""

    radiance: FloatArray
    standard_error: FloatArray
    channels: tuple[str, ...]


def apart(table: Pixels, fit: Pixels, scale: float) -> list[dict[str, Any]]:
    """How far two pictures are apart. For each channel, over ``scale`` (F of the table's picture): root mean
    square difference, what of it noise explains (the standard errors of both), the rest, the mean difference,
    and PSNR against the table's brightest pixel below the 99.9th percentile."""
    found: list[dict[str, Any]] = []
    unit = scale if scale > 0 else 1.0
    for k, name in enumerate(table.channels):
        a, b = table.radiance[..., k], fit.radiance[..., k]
        squared = float(((a - b) ** 2).mean())
        both = table.standard_error[..., k], fit.standard_error[..., k]
        noise = float((both[0] ** 2 + both[1] ** 2).mean())
        peak = float(np.percentile(a, 99.9))
        found.append(
            {
                "channel": name, "error": float(np.sqrt(squared)) / unit,
                "noise": float(np.sqrt(noise)) / unit,
                "error_without_noise": float(np.sqrt(max(squared - noise, 0.0))) / unit,
                "bias": float((b - a).mean()) / unit,
                "psnr_db": float(10 * np.log10(peak**2 / squared)) if squared > 0 and peak > 0 else None,
            }
        )  # fmt: skip
    return found


def beside(table: Pixels, fit: Pixels, scale: float) -> bytes:
    """PNG: the table, the fit, and their difference around grey, fourfold, side by side, 2 pixels between."""
    sides = [files.displayed(one.radiance, one.channels, scale) for one in (table, fit)]
    difference = (fit.radiance - table.radiance) / (scale if scale > 0 else 1.0)
    difference = files.as_rgb(difference, table.channels)
    grey: NDArray[np.uint8] = np.round(255 * np.clip(0.5 + 2.0 * difference, 0.0, 1.0)).astype(np.uint8)
    gap = np.full((grey.shape[0], 2, 3), 255, np.uint8)
    return files.png_bytes(np.concatenate([sides[0], gap, sides[1], gap, grey], axis=1))


def _pixels(picture: Picture) -> Pixels:
    return Pixels(picture.radiance, picture.standard_error, picture.channels)


@dataclass(frozen=True)
class Comparison:
    """Pictures of one scene with the table and with the fit."""

    table: Picture
    fit: Picture
    material: str
    model: str

    def numbers(self) -> list[dict[str, Any]]:
        """See :func:`fitter.scene.comparison.apart`."""
        return apart(_pixels(self.table), _pixels(self.fit), self.table.reference)

    def rows(self) -> list[list[str]]:
        """The numbers for a person."""
        return [
            [
                one["channel"], f"{100 * one['error']:.2f} %", f"{100 * one['noise']:.2f} %",
                f"{100 * one['bias']:+.2f} %", "-" if one["psnr_db"] is None else f"{one['psnr_db']:.1f}",
            ]
            for one in self.numbers()
        ]  # fmt: skip

    def sentence(self) -> str:
        """What it comes to."""
        rest = max(one["error_without_noise"] for one in self.numbers())
        return (
            f"with {self.model} for the table of {self.material}, pixels are {100 * rest:.2g} % of F off "
            f"(root mean square, noise of {self.table.samples} samples taken off)"
        )

    def to_dict(self) -> dict[str, Any]:
        return {
            "kind": "brdf-fitter/scene-comparison", "material": self.material, "model": self.model,
            "numbers": self.numbers(), "sentence": self.sentence(), "table": self.table.to_dict(),
            "fit": self.fit.to_dict(),
        }  # fmt: skip

    def png(self) -> bytes:
        """See :func:`fitter.scene.comparison.beside`."""
        return beside(_pixels(self.table), _pixels(self.fit), self.table.reference)

    def save(self, folder: Path) -> list[Path]:
        """Write compare.png, compare.json, and the pictures table.exr and fit.exr."""
        found = {
            "compare.png": self.png(), "compare.json": json.dumps(self.to_dict(), indent=1).encode(),
            "table.exr": files.exr(self.table), "fit.exr": files.exr(self.fit),
        }  # fmt: skip
        for name, content in found.items():
            write_bytes(content, folder / name)
        return [folder / name for name in found]


def compare(
    scene: Scene, material: str, table: Table, model: ReflectanceModel, *, progress: Progress = ignore,
    **limits: Any,
) -> Comparison:  # fmt: skip
    """Render the scene with ``material`` made of the table and of the model, with the same seed.

    ``limits`` : as of :func:`fitter.scene.render`; the fit gets as many samples as the table took. Raises
    SpecError: no such material, other channels than the scene's.
    """
    if material not in scene.names:
        raise SpecError(
            f"the scene has no material {material!r}", code="unknown-material", parameter="material",
            remedy=f"its materials are {', '.join(scene.names)}",
        )  # fmt: skip
    pictures: list[Picture] = []
    for k, source in enumerate((table, model)):

        def step(share: float, what: str, k: int = k) -> None:
            progress(0.5 * (k + share), f"{('table', 'fit')[k]}: {what}")

        own: Material = made_of(source, scene.spec.channels, material)
        at = scene.names.index(material)
        changed = replace(scene, materials=(*scene.materials[:at], own, *scene.materials[at + 1 :]))
        pictures.append(render(changed, progress=step, **limits))
        limits = {**limits, "samples": pictures[0].samples, "seconds": None, "target_error": None}
    return Comparison(pictures[0], pictures[1], material, model.spec.name)
