"""glTF 2.0: a metallic-roughness material, refitted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fitter.documents import write_document
from fitter.export.refit import Refit, Unknown, of_ours, refit
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject

MODEL = "glTF metallic-roughness"
_UNKNOWNS = (
    Unknown("base_color", 0.0, 1.0, (0.3,), per_channel=True),
    Unknown("metallic", 0.0, 1.0, (0.1, 0.9)),
    Unknown("roughness", 0.02, 1.0, (0.2, 0.6)),
)


def refitted(subject: Subject) -> Refit:
    """The nearest metallic-roughness material, as ``metallic_roughness`` has its formula."""
    return refit(subject, MODEL, _UNKNOWNS, of_ours("metallic_roughness", len(subject.channels)))


def write(subject: Subject, path: Path) -> Written:
    found = refitted(subject)
    colour = np.broadcast_to(found.values["base_color"], (3,))
    comments = [*subject.comments(), found.sentence(), f"{TARGET.convention}."]
    material: dict[str, Any] = {
        "name": subject.name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [*colour.tolist(), 1.0],
            "metallicFactor": float(found.values["metallic"]),
            "roughnessFactor": float(found.values["roughness"]),
        },
        "extras": {"comments": comments, "residuals": found.residuals()},
    }
    asset = {"version": "2.0", "generator": "brdf-fitter"}
    write_document({"asset": asset, "materials": [material]}, path)
    return Written((found.note(),), found.residuals())


TARGET = Target(
    "gltf", "glTF 2.0 with a metallic-roughness material, a refit", True, True, ".gltf",
    "linear factors of glTF's own model; perceived roughness, the root of alpha", write, "model/gltf+json",
    channels=(1, 3),
)  # fmt: skip
