"""MaterialX: the standard library's gltf_pbr surface, refitted."""

from __future__ import annotations

import re
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from fitter.export.registry import Target, Written
from fitter.export.subject import Subject
from fitter.export.to.gltf import refitted
from fitter.formats.output import write_aside


def write(subject: Subject, path: Path) -> Written:
    found = refitted(subject)
    colour = ", ".join(f"{c:.9g}" for c in np.broadcast_to(found.values["base_color"], (3,)).tolist())
    name = re.sub(r"\W+", "_", subject.name, flags=re.ASCII).strip("_")[:60] or "material"
    inputs = [
        ("base_color", "color3", colour),
        ("metallic", "float", f"{float(found.values['metallic']):.9g}"),
        ("roughness", "float", f"{float(found.values['roughness']):.9g}"),
    ]
    comments = [*subject.comments(), found.sentence(), f"{TARGET.convention}."]
    lines = ['<?xml version="1.0"?>', '<materialx version="1.38" colorspace="lin_rec709">']
    lines += [f"  <!-- {escape(line)} -->" for line in comments]
    lines += [f'  <gltf_pbr name="surface_{name}" type="surfaceshader">']
    lines += [f'    <input name="{key}" type="{kind}" value="{value}" />' for key, kind, value in inputs]
    lines += ["  </gltf_pbr>", f'  <surfacematerial name="material_{name}" type="material">']
    lines += [f'    <input name="surfaceshader" type="surfaceshader" nodename="surface_{name}" />']
    lines += ["  </surfacematerial>", "</materialx>", ""]
    write_aside(path, ["\n".join(lines).encode()])
    return Written((found.note(),), found.residuals())


TARGET = Target(
    "materialx", "MaterialX document with a gltf_pbr surface, a refit", True, True, ".mtlx",
    "linear Rec. 709 inputs of gltf_pbr; perceived roughness, the root of alpha", write, "application/xml",
    channels=(1, 3),
)  # fmt: skip
