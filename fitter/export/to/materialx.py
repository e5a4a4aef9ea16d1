"""MaterialX: the standard library's gltf_pbr surface, refitted."""

from __future__ import annotations

from pathlib import Path

from fitter.export.materialx import write_surface
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject
from fitter.export.to.gltf import refitted


def write(subject: Subject, path: Path) -> Written:
    found = refitted(subject)
    given = [(name, found.values[name]) for name in ("base_color", "metallic", "roughness")]
    write_surface(path, subject, found, "gltf_pbr", given, f"{TARGET.convention}.")
    return Written((found.note(),), found.residuals())


TARGET = Target(
    "materialx", "MaterialX document with a gltf_pbr surface, a refit", True, True, ".mtlx",
    "linear Rec. 709 inputs of gltf_pbr; perceived roughness, the root of alpha", write, "application/xml",
    channels=(1, 3),
)  # fmt: skip
